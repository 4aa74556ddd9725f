# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compares two sets of trainings, A and B, over their training seeds.

Every policy is tried as `vgps evaluate` does, in the task of A's first one, in the same starts,
commands and disturbances. A training counts once, however many rollouts judge it. Shown are
interquartile means over the trainings, their difference, and the probability that a training of A
is better than one of B, each with an interval of 95 % by a stratified bootstrap. Where both sides
have trainings of the same seeds, one each, the difference is that of these pairs.
"""

import argparse
import json
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.programs.command_line import Parser, refuse_existing
from vgps_ros.programs.evaluate import add_trials, judge_policy, open_run
from vgps_ros.storage.files import write_json
from vgps_ros.storage.run_folder import RunFolder, read_result

if TYPE_CHECKING:
    from vgps_ros.core.records import Array

_COLUMNS = ("A", "B", "A less B", "A better")


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    for name in ("A", "B"):
        text = "run, policy or glob in quotes, or several with commas between"
        parser.add_argument(name, help=text)
    add_trials(parser)
    text = "draw A and B in the first rollout in which one of a pair alone falls"
    parser.add_argument("--fall", type=Path, metavar="GIF", help=text)


def run(arguments: argparse.Namespace) -> None:
    """Tries the trainings that the arguments name, and compares them."""
    files = [file for file in (arguments.json, arguments.fall) if file and file != Path("-")]
    refuse_existing(files, overwrite=arguments.overwrite)
    paths = [
        [Path(name) for part in text.split(",") for name in sorted(glob(part)) or [part]]
        for text in (arguments.A, arguments.B)
    ]
    _, task = open_run(paths[0][0], arguments.task)
    tried = [
        [judge_policy(open_run(path, arguments.task)[0], task, arguments) for path in side]
        for side in paths
    ]
    results = [[result for result, _ in side] for side in tried]
    pairs = _pairs(*([_seed(path) for path in side] for side in paths))
    found: dict[str, Any] = {
        "task": task.name,
        "runs": [[str(path) for path in side] for side in paths],
        "pairs": pairs,
        "figures": compare_figures([[*map(_figures, side)] for side in results], pairs),
        "falls_of_one": _falls(results, pairs or [(0, 0)]),
    }
    if arguments.fall:
        if not found["falls_of_one"]:
            raise InvalidInputError("No policy fell where its pair did not; leave out --fall.")
        from vgps_ros.views.filmstrip import write_motions

        i, j, _, *place = found["falls_of_one"][0].values()
        motions = [replay(*place) for _, replay in (tried[0][i], tried[1][j]) if replay]
        write_motions(task.mjcf, motions, task.dynamics.time_step, arguments.fall)
    if arguments.json == Path("-"):
        print(json.dumps(found))
        return
    _show(found)
    if arguments.json:
        write_json(arguments.json, found)


def _seed(path: Path) -> int | None:
    result = RunFolder(path).result
    return read_result(result).get("seed") if result.is_file() else None


def _pairs(ours: list[int | None], theirs: list[int | None]) -> list[tuple[int, int]]:
    """Returns which of both have the same seed; none where a seed is unknown or there twice."""
    if any(None in seeds or len({*seeds}) < len(seeds) for seeds in (ours, theirs)):
        return []
    return [(i, theirs.index(seed)) for i, seed in enumerate(ours) if seed in theirs]


def _figures(result: dict[str, Any]) -> dict[str, float | None]:
    """Returns the figures of a result; less is better where a name begins with error or cost."""
    if "commands" in result:
        found = {}
        for name, part in (("held", "all_commands"), ("changing", "changing")):
            for what, key in (("up", "survival"), ("obeys", "obeys")):
                found[f"{what}, commands {name}"] = result[part][key][-1]
            for command, error in result[part]["rms"].items():
                found[f"error of {command}, commands {name}"] = error
    else:
        found = {"up": result["survival"], "cost per step": result["cost_per_step"]["median"]}
    for kind, each in result.get("robustness", {}).items():
        shares = zip(each["values"], each["survival"], strict=True)
        found |= {f"up, {kind} {value:g}": share for value, share in shares}
    return found


def compare_figures(
    sides: list[list[dict[str, float | None]]], pairs: list[tuple[int, int]]
) -> list[dict[str, Any]]:
    """Returns a row for each figure that all trainings have."""
    from vgps_ros.search.seed_statistics import interquartile_mean as iqm
    from vgps_ros.search.seed_statistics import probability_of_improvement, with_interval

    def difference(a: "Array", b: "Array", axis: int) -> "Array":
        return iqm(a, axis) - iqm(b, axis)

    rows = []
    for name in sides[0][0]:
        values = [[figures.get(name) for figures in side] for side in sides]
        if None in values[0] + values[1]:
            continue
        a, b = (np.array(side, dtype=float) for side in values)
        apart = np.array([0.0 if a[i] == b[j] else a[i] - b[j] for i, j in pairs])
        sign = 1.0 if name.startswith(("error", "cost")) else -1.0
        bands = (
            with_interval(iqm, a),
            with_interval(iqm, b),
            with_interval(iqm, apart) if pairs else with_interval(difference, a, b),
            probability_of_improvement([sign * a], [sign * b]),
        )
        columns = ([float(part) for part in vars(band).values()] for band in bands)
        rows.append({"figure": name, "values": values, **dict(zip(_COLUMNS, columns, strict=True))})
    return rows


def _falls(sides: list[list[dict[str, Any]]], pairs: list[tuple[int, int]]) -> list[dict[str, Any]]:
    """Returns each rollout in which one of a pair falls, and the other does not."""
    found = []
    for i, j in pairs:
        a, b = (result.get("robustness", {}) for result in (sides[0][i], sides[1][j]))
        for kind in a:
            each = zip(a[kind]["values"], a[kind]["fallen"], b[kind]["fallen"], strict=True)
            for value, fallen, others in each:
                for rollout in sorted({*fallen} ^ {*others}):
                    who = {"A": i, "B": j, "fell": "A" if rollout in fallen else "B"}
                    found.append(who | {"kind": kind, "value": value, "rollout": rollout})
    return found


def _show(found: dict[str, Any]) -> None:
    """Prints the table."""
    from rich.table import Table

    from vgps_ros.views.console import table_console

    counts = [len(side) for side in found["runs"]]
    falls = [sum(fall["fell"] == side for fall in found["falls_of_one"]) for side in "AB"]
    title = f"{found['task']}, {counts[0]} and {counts[1]} trainings"
    caption = f"Of the pairs' same disturbed rollouts A alone fell in {falls[0]}, B in {falls[1]}."
    table = Table("figure", *_COLUMNS, title=title, caption=caption, caption_justify="left")
    for row in found["figures"]:
        cells = [f"{m:.3f} ({low:.3f} to {high:.3f})" for m, low, high in map(row.get, _COLUMNS)]
        if min(counts) < 2:  # one training has no interval
            cells = [cell.partition(" ")[0] for cell in cells]
        table.add_row(row["figure"], *cells)
    table_console(wide=True).print(table)
