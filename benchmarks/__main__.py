# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs the benchmarks: `python -m benchmarks [NAME ...]`; `make bench` installs the peers first."""

import argparse
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from benchmarks import (
    cluster,
    graph,
    learning,
    optimizers,
    reinforcement,
    sampling_peers,
    solver,
    task_files,
    trajectory_peers,
)
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
    "network_loop": graph.network_loop,
    "real_time": graph.real_time,
    "start": graph.start,
    "service": graph.service,
    "nodes": graph.nodes,
    "shares": learning.shares,
    "workers": learning.workers,
    "cluster_workers": cluster.cluster_workers,
    "growth": learning.growth,
    "m_step": learning.m_step,
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
    console.print(_terminal_table(rows))
    (output / TABLE).write_text(_markdown(rows))
    if any(row.curve for row in rows):
        save(_growth_figure(rows), output / "growth.png")
    console.print(f"Wrote {RESULT} and {TABLE} to {output}.")
    return sound


COLUMNS = ("what", "ours", "peer or floor", "ratio", "target", "met")


def _cells(row: Comparison) -> tuple[str, ...]:
    """Returns a row's texts, one for each column."""
    return (
        row.name,
        f"{row.ours:.4g} {row.unit}".strip(),
        f"{row.peer:.4g} {row.unit}".strip(),
        f"{row.ratio:.3f}",
        "" if row.target is None else f"{row.target:.3g}",
        {None: "", True: "yes", False: "no"}[row.met],
    )


def _terminal_table(rows: Sequence[Comparison]) -> Table:
    """Returns the rows for the terminal."""
    shown = Table(box=SIMPLE)
    for name in COLUMNS:
        shown.add_column(name, justify="left" if name == "what" else "right")
    for row in rows:
        shown.add_row(*_cells(row))
    return shown


def _markdown(rows: Sequence[Comparison]) -> str:
    """Returns the rows, with their remarks, as a table of Markdown."""
    lines = [(*COLUMNS, "remark"), tuple("---" for _ in (*COLUMNS, "remark"))]
    lines += [(*_cells(row), row.remark) for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _growth_figure(rows: Sequence[Comparison]) -> Figure:
    """Draws each growth that was measured beside what it is compared with."""
    grown = [row for row in rows if row.curve]
    figure = Figure(figsize=(3.6 * len(grown), 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, row in zip(figure.subplots(1, len(grown), squeeze=False)[0], grown, strict=True):
        sizes, seconds = zip(*row.curve, strict=True)
        axes.loglog(sizes, seconds, "o-", label=f"measured, exponent {row.ours:.2f}")
        peer = [seconds[-1] * (size / sizes[-1]) ** row.peer for size in sizes]
        axes.loglog(sizes, peer, ":", color="black", label=f"exponent {row.peer:g}")
        axes.set_xlabel(row.name.partition(": exponent")[0])
        axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
        axes.minorticks_off()
        axes.legend(fontsize=8)
    figure.axes[0].set_ylabel("time [s]")
    return figure


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


if __name__ == "__main__":
    main()
