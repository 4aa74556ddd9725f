# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a run of benchmarks leaves: a table for the terminal, one for documents, and a picture."""

from collections.abc import Sequence

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.box import SIMPLE
from rich.table import Table

from benchmarks.timing import Comparison

COLUMNS = ("what", "ours", "peer or floor", "ratio", "target", "met")


def cells(row: Comparison) -> tuple[str, ...]:
    """Returns a row's texts, one for each column."""
    return (
        row.name,
        f"{row.ours:.4g} {row.unit}".strip(),
        f"{row.peer:.4g} {row.unit}".strip(),
        f"{row.ratio:.3f}",
        "" if row.target is None else f"{row.target:.3g}",
        {None: "", True: "yes", False: "no"}[row.met],
    )


def terminal_table(rows: Sequence[Comparison]) -> Table:
    """Returns the rows for the terminal."""
    shown = Table(box=SIMPLE)
    for name in COLUMNS:
        shown.add_column(name, justify="left" if name == "what" else "right")
    for row in rows:
        shown.add_row(*cells(row))
    return shown


def markdown(rows: Sequence[Comparison]) -> str:
    """Returns the rows, with their remarks, as a table of Markdown."""
    lines = [(*COLUMNS, "remark"), tuple("---" for _ in (*COLUMNS, "remark"))]
    lines += [(*cells(row), row.remark) for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def growth_figure(rows: Sequence[Comparison]) -> Figure:
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
