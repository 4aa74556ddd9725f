# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Every command on every page runs, from the top of the page to its end, in a folder of its own.

`commands.py` says what is shortened and what is left out.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from tests.docs.commands import (
    LASTING,
    NOT_RUN,
    PAGES,
    ROOT,
    SLOW,
    blocks,
    is_slow,
    matching,
    shortened,
)
from tests.nodes.conftest import domain_id  # noqa: F401
from vgps_ros.programs.__main__ import main as vgps

PATIENCE = 1500.0  # for one command, which pytest may end earlier [s]
ENDING = 20.0  # for a command that is ended to end what it started [s]
WITH_COMMANDS = [page for page in PAGES if any(blocks(page))]
COMMANDS = [command for page in PAGES for block in blocks(page) for command in block]


class Reader:
    """A reader of a page who types its commands into one shell after another.

    DIR stands for the folder that the command before wrote, at first that of a short training, BAG
    for a copy of the sample.
    """

    def __init__(self, folder, run, domain):
        self.folder, self.written, self.count = folder, "run", 0
        (folder / "recordings").mkdir()
        (folder / "recordings" / "sample").symlink_to(ROOT / "recordings" / "sample")
        for name in ("config", "scripts", "requirements", "examples", "env.bash"):
            (folder / name).symlink_to(ROOT / name)
        shutil.copytree(run, folder / "run")
        shutil.copytree(ROOT / "recordings" / "sample", folder / "bag")
        (folder / "policy.onnx").symlink_to(run / "policy.onnx")
        environment = {
            **{k: v for k, v in os.environ.items() if "DISPLAY" not in k},
            "ROS_DOMAIN_ID": str(domain),
            "ROS_LOG_DIR": str(folder / "log"),
        }
        # Each command runs here, in a session of its own, and without a person before it.
        self.place = {
            "cwd": folder,
            "env": environment,
            "stdin": subprocess.DEVNULL,
            "start_new_session": True,
            "text": True,
        }
        self.shells = []

    def type(self, block):
        """Runs the commands of one block; what lasts is ended with INT, and must end well."""
        lasting, said_before = [], ""
        try:
            for command in map(self.real, block):
                if re.match(r"\w+\+?=|source ", command):
                    said_before += f"{command}\n"
                elif re.match(LASTING, command):
                    lasting.append(self.start(f"{said_before}exec {command}"))
                else:
                    self.run(f"{said_before}{command}")
        finally:
            for process, _ in lasting:
                process.send_signal(signal.SIGINT)
            codes = [process.wait(PATIENCE) for process, _ in lasting]
        for code, (process, log) in zip(codes, lasting, strict=True):
            assert code == 0, f"{process.args}\n{log.read_text()}"

    def real(self, command):
        """Returns a command of a page with what its placeholders stand for."""
        command = re.sub(r"\bBAG\b(\.\.\.)?", "bag", command)
        command = command.replace("make ", f"make -C {ROOT} ").replace(
            "OUTPUT=", f"OUTPUT={self.folder}/"
        )
        if re.match(r"make .* demo", command) and "OUTPUT=" not in command:
            self.count += 1
            command += f" OUTPUT={self.folder}/demo-{self.count}"
        command = re.sub(r"TASK=\$PWD", f"TASK={self.folder}", command)
        if "--output DIR" in command:
            self.count += 1
            self.written = f"written-{self.count}"
        elif "--output policy.onnx" in command:
            (self.folder / "policy.onnx").unlink()
        return re.sub(r"\bDIR\b", self.written, command)

    def run(self, command):
        shell = self.open(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        output, errors = shell.communicate(timeout=PATIENCE)
        assert shell.returncode == 0, f"{command}\n{output[-3000:]}\n{errors[-3000:]}"

    def start(self, command):
        """Starts a command in the background, and returns it once it has said something."""
        self.count += 1
        log = self.folder / f"lasting-{self.count}.log"
        with log.open("w") as file:
            process = self.open(command, stdout=file, stderr=subprocess.STDOUT)
        end = time.monotonic() + PATIENCE
        while process.poll() is None and not log.read_text() and time.monotonic() < end:
            time.sleep(0.1)
        assert process.poll() in (None, 0), f"{command}\n{log.read_text()}"
        return process, log

    def open(self, command, **streams):
        shell = subprocess.Popen(["bash", "-c", command], **self.place, **streams)
        self.shells.append(shell)
        return shell

    def close(self):
        """Ends the shells that have not ended in time, with all that they started."""
        for shell in self.shells:
            if shell.poll() is None:
                os.killpg(shell.pid, signal.SIGTERM)
                with suppress(subprocess.TimeoutExpired):
                    shell.wait(ENDING)
                while left := processes(session=shell.pid):
                    for process in left:
                        with suppress(ProcessLookupError):
                            os.kill(process, signal.SIGKILL)
                    shell.poll()
                    time.sleep(0.1)


def processes(session):
    """Returns the processes of a session; a shell's jobs may be in several groups of it."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(FileNotFoundError, ProcessLookupError):
            state, _, _, its_session = stat.read_text().rpartition(")")[2].split()[:4]
            if int(its_session) == session and state != "Z":
                found.append(int(stat.parent.name))
    return found


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    run = tmp_path_factory.mktemp("trained") / "run"
    quick = ["--iterations", "1", "--initial-ddp-iterations", "2", "--evaluation-rollouts", "2"]
    vgps(["train", "--task", "swimmer", "--hidden-units", "5", *quick, "--output", str(run)])
    vgps(["export", str(run), "--output", str(run / "policy.onnx")])
    return run


@pytest.fixture
def reader(tmp_path, trained, domain_id):  # noqa: F811
    reader = Reader(tmp_path, trained, domain_id)
    yield reader
    reader.close()


def chosen(block, *, slow):
    """Returns the commands of a block that a test runs, as it runs them."""
    run = [c for c in block if not matching(NOT_RUN, c) and (slow or not is_slow(c))]
    return [shortened(command) for command in run]


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.name)
def test_the_commands_of_a_page_run(reader, page):
    for block in blocks(page):
        reader.type(chosen(block, slow=False))


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    "page",
    [p for p in WITH_COMMANDS if any(is_slow(c) for block in blocks(p) for c in block)],
    ids=lambda page: page.name,
)
def test_all_commands_of_a_page_run_the_long_ones_too(reader, page):
    for block in blocks(page):
        reader.type(chosen(block, slow=True))


@pytest.mark.parametrize("pattern", [*NOT_RUN, *SLOW])
def test_what_is_said_of_commands_is_about_commands_that_are_there(pattern):
    assert any(re.search(pattern, command) for command in COMMANDS)


def test_a_command_that_takes_too_long_is_ended_with_all_that_it_started(reader, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "PATIENCE", 2.0)
    with pytest.raises(subprocess.TimeoutExpired):
        reader.run("set -m; trap '' TERM; (trap '' TERM; sleep 600) & wait; wait")
    monkeypatch.setattr(sys.modules[__name__], "ENDING", 0.1)
    (shell,) = reader.shells
    assert len(processes(session=shell.pid)) > 1
    reader.close()
    assert processes(session=shell.pid) == []
