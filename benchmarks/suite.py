# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The benchmarks by name, and the program that runs them."""

import argparse
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console

from benchmarks import (
    graph,
    learning,
    m_step,
    optimizers,
    real_time,
    reinforcement,
    sampling_peers,
    solver,
    task_files,
    trajectory_peers,
)
from benchmarks.network_loop import network_loop
from benchmarks.report import growth_figure, markdown, terminal_table
from benchmarks.timing import Comparison
from vgps_ros.core.checks import nearest
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.storage.files import write_json
from vgps_ros.views.console import table_console
from vgps_ros.views.plots import save

Benchmark = Callable[[], Iterator[Comparison]]

BENCHMARKS: dict[str, Benchmark] = {
    "compilation": solver.compilation,
    "backward_pass": solver.backward_passes,
    "ddp_iteration": solver.ddp_iteration,
    "derivatives": solver.derivatives,
    "derivatives_by_robot": solver.derivatives_by_robot,
    "convergence": solver.convergence,
    "plans": solver.plans,
    "task_files": task_files.task_files,
    "trajectory_peers": trajectory_peers.trajectory_peers,
    "sampling_peers": sampling_peers.sampling_peers,
    "lock_step": graph.lock_step,
    "network_loop": network_loop,
    "real_time": real_time.real_time,
    "start": real_time.start,
    "service": graph.service,
    "nodes": graph.nodes,
    "shares": learning.shares,
    "workers": learning.workers,
    "growth": learning.growth,
    "m_step": m_step.m_step,
    "optimizers": optimizers.optimizers,
    "reinforcement_learning": reinforcement.reinforcement_learning,
}
LONG = ("reinforcement_learning",)  # run only by name
PEERS = {
    **dict.fromkeys(("backward_pass", "trajectory_peers"), "crocoddyl"),
    "reinforcement_learning": "stable_baselines3",
}
RESULT, TABLE = "benchmarks.json", "benchmarks.md"


def run(names: Sequence[str], output: Path, console: Console) -> bool:
    """Runs benchmarks one after another; returns whether none of them failed.

    Each row is shown and written as soon as it is measured. One that fails is told, and the others
    run.
    """
    rows: list[Comparison] = []
    sound = True
    output.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names, start=1):
        console.print(f"[{number}/{len(names)}] {name}: {BENCHMARKS[name].__doc__}", markup=False)
        try:
            for row in BENCHMARKS[name]():
                rows.append(row)
                write_json(output / RESULT, [r.entry() for r in rows])
                console.print(f"  {row.name}: {_verdict(row)}", markup=False)
        except Exception:
            sound = False
            console.print(f"  {name} failed:\n{traceback.format_exc()}", markup=False)
    console.print(terminal_table(rows))
    (output / TABLE).write_text(markdown(rows))
    if any(row.curve for row in rows):
        save(growth_figure(rows), output / "growth.png")
    console.print(f"Wrote {RESULT} and {TABLE} to {output}.")
    return sound


def _verdict(row: Comparison) -> str:
    spread = "" if row.spread is None else f" ± {row.spread:.3f}"
    met = {None: "", True: ", met", False: ", missed"}[row.met]
    return f"{row.ratio:.3f}{spread}{met}" + (f" ({row.remark})" if row.remark else "")


def _known(name: str) -> str:
    if name not in BENCHMARKS:
        raise argparse.ArgumentTypeError(
            f"'{name}' is none of {', '.join(BENCHMARKS)}.{nearest(name, BENCHMARKS)}"
        )
    return name


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    silence_mujoco()
    parser = argparse.ArgumentParser(
        prog="benchmark",
        description="Measures how fast vgps_ros is, as ratios to peers and to floors measured in "
        f"the same run, and writes {RESULT}. Peers are installed by 'make bench'.",
    )
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        type=_known,
        help=f"of {', '.join(BENCHMARKS)}; without a name all but {', '.join(LONG)}",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("recordings/benchmarks"), help="folder for the result"
    )
    parsed = parser.parse_args(arguments)
    names = parsed.names or [name for name in BENCHMARKS if name not in LONG]
    lacking = [PEERS[name] for name in names if name in PEERS and not find_spec(PEERS[name])]
    if "sampling_peers" in names and not sampling_peers.PYTHON.exists():
        lacking.append("judo")
    if lacking:
        sys.exit(
            f"benchmark: {', '.join(lacking)} is compared with, but not installed: use `make "
            "bench`, which installs the peers."
        )
    try:
        sound = run(names, parsed.output, table_console(wide=True))
    except OSError as error:
        sys.exit(f"benchmark: {error}")
    except KeyboardInterrupt:
        sys.exit("benchmark: interrupted; the rows that were measured are written.")
    sys.exit(0 if sound else "benchmark: one failed; its traceback is above.")
