# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Interrupts programs at random times after their first instruction: one signal must end each.

    python -m tests.faults.interrupts --count 60 --seed 7

Each is struck by Ctrl-C in a terminal, by INT in the background of a script, where a shell starts
it with INT ignored, and by TERM as a service. It must end with its code, in time, print no
traceback and leave nothing behind.
"""

import argparse
import os
import pty
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random

from rich.console import Console
from rich.table import Table

from tests.nodes.conftest import DOMAINS

ROOT = Path(__file__).parents[2]
EXECUTABLES = ROOT / "install" / "vgps_ros" / "lib" / "vgps_ros"
_STARTERS = {
    "terminal": ("env", "--default-signal=INT", "setsid", "--ctty"),
    "background": ("env", "--ignore-signal=INT"),
    "service": ("env", "--default-signal=TERM"),
}
MODES = tuple(_STARTERS)
FIRST, LAST = 0.02, 4.0  # of the times after the start at which the signal comes [s]
SOON = 5.0  # in which a program must have ended, unless no processor was free so long [s]
PATIENCE = 60.0  # after which it is killed, and counts as one that does not end [s]
_MARK = "VGPS_INTERRUPTED"


@dataclass(frozen=True)
class Kind:
    """A program: its words, in which FOLDER stands for an empty folder, and its codes.

    Attributes:
        words: the command.
        code: the exit code after INT.
        term_code: the exit code after TERM; None if it is the same.
    """

    words: tuple[str, ...]
    code: int
    term_code: int | None = None

    def code_after(self, number: signal.Signals) -> int:
        """Returns the exit code after a signal."""
        return self.code if number == signal.SIGINT or self.term_code is None else self.term_code


KINDS = {
    "demo": Kind((str(ROOT / "scripts" / "run_demo.bash"),), 130, 143),
    "node": Kind((str(EXECUTABLES / "simulation"), "--ros-args", "-p", "task:=rotor"), 0),
    "train": Kind(
        (
            str(EXECUTABLES / "train"),
            *("--task", "rotor", "--iterations", "9999", "--output", "FOLDER/run"),
        ),
        1,
    ),
    "recorder": Kind((str(EXECUTABLES / "recorder"), "--ros-args", "-p", "output:=FOLDER/bag"), 0),
    "learner": Kind((str(EXECUTABLES / "policy_learner"),), 0),
    "execution": Kind((str(EXECUTABLES / "execute_policy"), "--task", "rotor"), 1),
    "client": Kind((str(EXECUTABLES / "train_through_graph"), "--output", "FOLDER/run"), 1),
}


@dataclass(frozen=True)
class Outcome:
    """How a program ended: what was wrong, in words, how long it took [s], and if too long."""

    wrong: str
    seconds: float
    is_late: bool


def strike(kind: str, mode: str, delay: float, folder: Path, domain_id: int) -> Outcome:
    """Starts a program, interrupts it after a time [s], and tells how it ended."""
    number = signal.SIGTERM if mode == "service" else signal.SIGINT
    mark = f"{os.getpid()}.{time.monotonic_ns()}"
    command = [word.replace("FOLDER", str(folder)) for word in KINDS[kind].words]
    variables = {_MARK: mark, "TASK": "rotor", "OUTPUT": str(folder / "demo")}
    output, master = folder / "output", -1
    with output.open("w") as file:
        streams = {"stdin": subprocess.DEVNULL, "stdout": file, "stderr": subprocess.STDOUT}
        if mode == "terminal":
            master, terminal = pty.openpty()
            streams["stdin"] = terminal
        program = subprocess.Popen(
            [*_STARTERS[mode], *command],
            env={**os.environ, **variables, "ROS_DOMAIN_ID": str(domain_id)},
            **streams,
        )
    while program.poll() is None and not has_begun(program.pid, number):
        time.sleep(0.001)
    time.sleep(delay)
    struck, idle = time.monotonic(), _idle_seconds()
    if mode == "terminal":
        os.write(master, b"\x03")
    else:
        program.send_signal(number)
    try:
        code: int | str = program.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        code = "it does not end"
    seconds = time.monotonic() - struck
    is_late = min(seconds, _idle_seconds() - idle) > SOON
    if mode == "terminal":
        os.close(master)
        os.close(terminal)
    if isinstance(code, int) and code < 0:
        code = 128 - code  # as a shell shows a death by a signal
    words = output.read_text(errors="replace")
    is_right = code == KINDS[kind].code_after(number)
    if code == 1:  # which it also ends with by itself, for example if it finds no robot
        is_right &= "interrupted" in words
    wrong = [] if is_right else [f"code {code}, and it says {words[-300:]!r}"]
    wrong += [f"it says {words}"] if "Traceback" in words else []
    for pid in _marked(mark):
        wrong.append(f"left {Path(f'/proc/{pid}/cmdline').read_bytes()!r:.60}")
        os.kill(pid, signal.SIGKILL)
    program.wait()
    return Outcome(", ".join(wrong), seconds, is_late)


def has_begun(pid: int, number: signal.Signals) -> bool:
    """Returns whether a program has done its first instruction, which holds the signal back.

    Before it, nothing of the program's has a say: on a busy machine that may take .3 s.
    """
    folder = Path(f"/proc/{pid}")
    if (folder / "cmdline").read_bytes().startswith((b"env\0", b"setsid\0")):
        return False
    status = dict(line.split(":\t", 1) for line in (folder / "status").read_text().splitlines())
    return any(int(status[mask], 16) >> (number - 1) & 1 for mask in ("SigBlk", "SigCgt"))


def _idle_seconds() -> float:
    """Returns how long the machine's processors have had nothing to do, all together [s]."""
    ticks = Path("/proc/stat").read_text().split(maxsplit=5)[4]
    return int(ticks) / os.sysconf("SC_CLK_TCK")


def _marked(mark: str) -> list[int]:
    """Returns the processes that were started with this mark, but for those that have ended."""
    found: list[int] = []
    entry = f"{_MARK}={mark}\0".encode()
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended, or is somebody else's
            if entry in (folder / "environ").read_bytes() + b"\0":
                found.append(int(folder.name))
    return found


def main() -> int:
    """Runs the campaign; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.interrupts", description=__doc__)
    parser.add_argument("--count", type=int, default=60, help="of each program and mode")
    parser.add_argument("--seed", type=int, default=random.randrange(10**6), help="of all times")
    parser.add_argument("--only", choices=KINDS, help="one program")
    parser.add_argument("--between", type=float, nargs=2, metavar="SECONDS", help="of these times")
    arguments = parser.parse_args()
    print(f"interrupts: seed {arguments.seed}", flush=True)
    rng, bad, late = Random(arguments.seed), Counter[str](), Counter[str]()
    table = Table("program", "where", "struck", "ended well", "in time", "slowest [s]")
    for kind in [arguments.only] if arguments.only else KINDS:
        for mode in MODES:
            name, slowest = f"{kind} {mode}", 0.0
            for _ in range(arguments.count):
                delay = rng.uniform(*arguments.between or (FIRST, rng.choice((0.5, LAST))))
                with tempfile.TemporaryDirectory(prefix="vgps_ros_") as folder:
                    outcome = strike(kind, mode, delay, Path(folder), rng.choice(DOMAINS))
                slowest = max(slowest, outcome.seconds)
                late[name] += outcome.is_late
                if outcome.wrong:
                    bad[name] += 1
                    print(f"{name} after {delay:.3f} s: {outcome.wrong}", flush=True)
            struck, well = arguments.count, arguments.count - bad[name]
            cells = (struck, well, struck - late[name], f"{slowest:.1f}")
            table.add_row(kind, mode, *map(str, cells))
            print(f"{name}: {well} of {struck} ended well, slowest {slowest:.1f} s", flush=True)
    Console().print(table)
    return 1 if bad.total() or late.total() else 0


if __name__ == "__main__":
    sys.exit(main())
