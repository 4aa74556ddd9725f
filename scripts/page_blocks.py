# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Makes the blocks of figures in README.md and docs/ from the content of docs/figures.json.

A block stands between the lines `<!-- figures: NAME -->` and `<!-- end of figures -->`, where NAME
is a key of `BLOCKS`. `write_figures.py` measures the figures and writes the blocks into the pages.
"""

import re
import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from comparison_blocks import comparison_block, improvement_block

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end of figures -->)", re.S)
Figures = dict[str, Any]


def swimmer_block(figures: Figures) -> str:
    """Says how the swimmers end."""
    rows = [*figures["swimmer"]["5"], *figures["swimmer"]["10"]]
    four = figures["swimmer"]["four_initial_states"]
    text = (
        f"Over seeds {_seeds(rows)}, with 5 and with 10 hidden units, the policy without noise "
        f"ends at {_range(rows, 'deterministic', '.2f')} of the initial DDP solution's cost, and "
        f"the policy with noise at {_range(rows, 'stochastic', '.2f')}. One policy of 10 units "
        "that learned from four initial states swims from all of them, at "
        f"{four['deterministic']:.3f} and {four['stochastic']:.2f}."
    )
    return textwrap.fill(text, 100)


def demo_block(figures: Figures) -> str:
    """Shows the beginning and the end of what the demo prints."""
    lines = figures["demo"]["output"]
    last = next(i for i, line in enumerate(lines) if line.lstrip().startswith("50/50"))
    table = [line for line in lines[last:] if line.startswith("│")]
    paths = [line for line in lines if line.startswith(("Bag:", "Recording:", "Learning curve:"))]
    shown = [*lines[:4], " ...", *lines[last : last + 2], *table, *paths]
    return "\n".join(["```", *shown, "```"])


def walker_block(figures: Figures) -> str:
    """Makes the table of the walker's page."""
    shown = figures["demonstration"]
    table = [
        "| measured | |",
        "| --- | --- |",
        f"| speed of the demonstration, over 30 s | {shown['speed']:.2f} m/s |",
        f"| its cost per step, and after {shown['ddp_iterations']} DDP iterations | "
        f"{shown['cost_per_step']:.3f}, {shown['ddp_cost_per_step']:.3f} |",
    ]
    for name, units, iterations in (("walker", 10, 50), ("walker_five_units", 5, 130)):
        rows = figures[name]
        walks = sum(row["from_x1"] == 1.0 for row in rows)
        table += [
            f"| {units} units, seeds {_seeds(rows)}, {iterations} iterations: cost without noise, "
            "as a multiple of the initial DDP solution's | "
            f"{_list(rows, 'deterministic', '.2f')} |",
            f"| {units} units without noise from x_1: walk for 20 s | {walks} of {len(rows)} |",
            f"| {units} units without noise from x_1: distance in 60 s | "
            f"{_list(rows, 'distance_60s', '.1f')} m |",
            f"| {units} units without noise, 20 perturbed starts (0.01 rad, 0.1 rad/s): walk for "
            f"10 s | {_list(rows, 'perturbed', '.0%')} |",
            f"| {units} units with noise, 40 rollouts: walk for 4 s | "
            f"{_list(rows, 'with_noise', '.1%')} |",
        ]
    return "\n".join(table)


def five_units_block(figures: Figures) -> str:
    """Makes the table of five units, a row a seed."""
    head = "seed | cost without noise / initial DDP's | 20 s from x_1 | 20 perturbed starts, 10 s"
    table = [f"| {head} | with noise, 40 rollouts, 4 s |", "| --- | --- | --- | --- | --- |"]
    for row in figures["walker_five_units"]:
        walks = "walks" if row["from_x1"] == 1.0 else "falls"
        table.append(
            f"| {row['seed']} | {row['deterministic']:.3f} | {walks} | "
            f"{row['perturbed']:.0%} | {row['with_noise']:.1%} |"
        )
    return "\n".join(table)


def exported_block(figures: Figures) -> str:
    """Makes the table of how exactly ONNX files compute."""
    table = [
        "| robot | readings | hidden units | float32 | float64 |",
        "| --- | --- | --- | --- | --- |",
    ]
    table += [
        f"| {name} | {row['readings']} | {', '.join(map(str, row['units']))} | "
        f"{row['float32']:.1e} | {row['float64']:.1e} |"
        for name, row in figures["exported"].items()
    ]
    return "\n".join(table)


BLOCKS: dict[str, Callable[[Figures], str]] = {
    "swimmer": swimmer_block,
    "demo": demo_block,
    "walker": walker_block,
    "five_units": five_units_block,
    "exported": exported_block,
    "comparison": comparison_block,
    "improvement": improvement_block,
}


def _values(rows: Iterable[Figures], key: str, form: str) -> list[str]:
    return ["diverged" if row[key] is None else f"{row[key]:{form}}" for row in rows]


def _list(rows: Iterable[Figures], key: str, form: str) -> str:
    return ", ".join(_values(rows, key, form)).replace("%", " %")


def _range(rows: Iterable[Figures], key: str, form: str) -> str:
    values = sorted(_values(rows, key, form))
    return f"{values[0]} to {values[-1]}"


def _seeds(rows: list[Figures]) -> str:
    return f"{rows[0]['seed']} to {rows[-1]['seed']}"


def pages() -> list[Path]:
    """Returns the pages that may hold blocks."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def with_figures(page: str, figures: Figures) -> str:
    """Returns a page's text with each block as the figures give it."""
    return BLOCK.sub(lambda m: f"{m[1]}{BLOCKS[m[2]](figures)}\n{m[3]}", page)
