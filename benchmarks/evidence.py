# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes the tables of the pages that come from committed rows: `python -m benchmarks.evidence`.

A table stands between `<!-- table: NAME -->` and `<!-- end of table -->`. A test compares each page
with what this program would write, so a table that is older than its rows fails.
"""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv

from benchmarks.figure1.cells import PANELS, Panel
from benchmarks.figure1.curves import CURVES, RISING
from benchmarks.figure1.statistics import (
    CEILING,
    SUCCESS,
    Results,
    improvement,
    last_costs,
    summary,
)
from benchmarks.figure1.table import Columns, by_panel
from benchmarks.legs import RUNS as LEGS
from benchmarks.parts import ROWS as PARTS_ROWS
from benchmarks.parts import VARIANTS, WHOLE
from benchmarks.past_the_paper import METHODS as PAST
from benchmarks.past_the_paper import PEERS
from benchmarks.past_the_paper import ROWS as PAST_ROWS
from benchmarks.robots import ALONE, OWN, lines, robots
from benchmarks.sweep import read_rows
from vgps_ros.core.records import Array
from vgps_ros.programs.compare import compare_figures
from vgps_ros.search.robustness import ENOUGH
from vgps_ros.search.seed_statistics import interquartile_mean, with_interval

ROOT = Path(__file__).resolve().parents[1]
EVIDENCE = ROOT / "docs" / "evidence"
ROBOTS = EVIDENCE / "robots"
CLAIMS = Path(__file__).with_name("claims.md")
EXPLAINED = ("paper_and_ours.md", "past_the_paper.md")
PAGES = (
    *sorted(EVIDENCE.glob("*.md")),
    *(ROOT / "docs" / "explanation" / name for name in EXPLAINED),
)
FRESH = range(21, 26)  # the quadruped's seeds on which no setting was chosen
UNSEEN = 9  # first seed of Figure 1's swimmers that no page had named before
PAST_COSTS = ("q_cost", "deterministic", "stochastic_median")
RIVALS_ROWS, TUNING_ROWS = EVIDENCE / "rivals.jsonl", EVIDENCE / "rivals_tuning.jsonl"
TABLE = re.compile(r"(<!-- table: ([^\n]+) -->\n)(?s:.*?)(<!-- end of table -->)")
NOISE = {"median": "with noise, median rollout", "mean": "with noise, mean of the rollouts"}
# What the parts of vgps are judged by: figures of disturbances, by kind.
TRIED = {
    "pushes": ("survival", "up after a push of {:g} N·s"),
    "dampings": ("obeys", "obeys, joints' damping × {:g}"),
    "armatures": ("obeys", "obeys, joints' armature × {:g}"),
    "contacts": ("obeys", "obeys, MuJoCo's contact"),
    "latencies": ("obeys", "obeys, {:g} s late"),
}
FALLS = CEILING - 1e-6  # an interval from here on is one of policies that all fall


def written(page: Path) -> str:
    """Returns a page's text, each of its tables made anew."""
    return TABLE.sub(lambda m: f"{m[1]}\n{TABLES[m[2]]()}\n{m[3]}", page.read_text())


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Returns a table of Markdown."""
    shown = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(row)} |\n" for row in shown)


@cache
def figure1() -> Results:
    """Returns the rows of Figure 1, by panel and method."""
    return by_panel(pyarrow.csv.read_csv(EVIDENCE / "figure1.csv"))


@cache
def summaries() -> dict[tuple[str, str], dict[str, Any]]:
    """Returns what each method of each panel ends at, with noise by the median and by the mean."""
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for average in NOISE:
        for row in summary(figure1(), average):
            own = {name.replace("stochastic", average): value for name, value in row.items()}
            found.setdefault((row["panel"], row["method"]), {}).update(own)
    return found


@cache
def probabilities(task: str = "", first: int = 0) -> dict[str, dict[str, float]]:
    """Returns how probable it is that a seed of vgps ends lower, by the other method.

    It is that of one task, or of all, and of the seeds from a first one on.
    """
    columns = {"without": "deterministic_cost"} | {n: f"stochastic_cost_{n}" for n in NOISE}
    chosen: dict[Panel, dict[str, Columns]] = {}
    for name, methods in figure1().items():
        for method, own in methods.items() if task in ("", name.task) else ():
            late = own["seed"][:, 0] >= first
            if late.any():
                kept = {column: values[late] for column, values in own.items()}
                chosen.setdefault(name, {})[method] = kept
    ends = {kind: last_costs(chosen, column) for kind, column in columns.items()}
    return {row["against"]: row for row in improvement(ends) if row["ours"] == "vgps"}


def panel(name: str) -> str:
    """Returns the table of one panel of Figure 1."""
    rows = []
    for method in CURVES:
        row = summaries()[name, method]
        costs = [_with_interval(row, kind, FALLS) for kind in ("deterministic", *NOISE)]
        share = f"{row['succeed']} of {row['seeds']}"
        rows.append((_label(method), *costs, share, f"{row['survival']:.0%}".replace("%", " %")))
    return table(("method", "without noise", *NOISE.values(), "succeed", "stay up"), rows)


def improvements() -> str:
    """Returns the table of the probabilities that a seed of vgps ends lower."""
    rows = [
        (_label(name), *(_with_interval(row, kind) for kind in ("without", *NOISE)))
        for name, row in probabilities().items()
    ]
    return table(("against", "without noise", *NOISE.values()), rows)


def improvements_by_task() -> str:
    """Returns the same by robot, and on the seeds that nobody had looked at before."""
    sets = (("swimmer", 0), ("walker", 0), ("swimmer", UNSEEN))
    found = [probabilities(*each) for each in sets]
    kinds = ("without", "median")
    rows = [
        (_label(name), *(_with_interval(each[name], kind) for each in found for kind in kinds))
        for name in found[-1]
    ]
    labels = (f"{task}{f', seeds {first} to 19' if first else ''}" for task, first in sets)
    names = ("without noise", "with noise")
    return table(("against", *(f"{each}, {name}" for each in labels for name in names)), rows)


def _label(method: str) -> str:
    return f"{method}, tuned for longer" if method == RISING else method


def _with_interval(row: dict[str, Any], name: str, most: float = np.inf) -> str:
    middle, low, high = (row[name + ending] for ending in ("", "_low", "_high"))
    return "falls" if low >= most else f"{middle:.2f} ({low:.2f} to {high:.2f})"


def defaults() -> str:
    """Returns the table of the paper's schedule beside ours."""
    rows = []
    for name in PANELS:
        task, units = name.split("-")
        shown = []
        for method in ("vgps", RISING):
            row, one = summaries()[name, method], figure1()[Panel.named(name)][method]
            if row["median_low"] >= FALLS:
                text = f"{_walk(one)} walk without noise; all fall with it"
            else:
                text = f"{row['deterministic']:.2f}, {row['median']:.2f}"
                if task == "walker":
                    text += f" ({row['survival']:.0%} stay up)".replace("%", " %")
            shown.append(text)
        rows.append((f"{task}, {units} units", *shown))
    return table(("panel", "the paper's α: without noise, with noise", "our defaults"), rows)


def _multiples(one: Columns, column: str) -> Array:
    return np.fmin(np.nan_to_num(one[column] / one["initial_ddp_cost"], nan=CEILING), CEILING)


def _walk(one: Columns) -> str:
    up = one["deterministic_survival"][:, -1] == 1.0
    return f"{up.sum()} of {len(up)}"


class Claim:
    """The figures of one method in one panel, as the table of claims says them by name.

    Those that may be of an iteration k are of the last one where k is 0.
    """

    def __init__(self, panel_name: str, method: str):
        """Takes the rows of a method in a panel."""
        self._one = figure1()[Panel.named(panel_name)][method]
        self._up = self._one["deterministic_survival"] == 1.0

    def cost(self, k: int = 0) -> str:
        """Returns the cost without noise: median, lowest and highest."""
        return _spread(_multiples(self._one, "deterministic_cost")[:, k - 1], ".2f")

    def noisy(self, k: int = 0) -> str:
        """Returns the cost of the median rollout with noise."""
        return _spread(_multiples(self._one, "stochastic_cost_median")[:, k - 1], ".2f")

    def survival(self) -> str:
        """Returns the share of the rollouts with noise that stay up at the end [%]."""
        return _spread(100 * self._one["stochastic_survival"][:, -1], ".0f", " %")

    def succeed(self) -> str:
        """Returns how many seeds succeed at the end."""
        cost = _multiples(self._one, "deterministic_cost")[:, -1]
        return f"{(self._up[:, -1] & (cost <= SUCCESS)).sum()} of {len(cost)}"

    def walk(self) -> str:
        """Returns how many seeds walk without noise at the end."""
        return _walk(self._one)

    def ever(self) -> str:
        """Returns how many seeds walk without noise in some iteration, and when first."""
        found = self._up.any(axis=1)
        first = self._up[found].argmax(axis=1) + 1
        when = " to ".join(str(k) for k in sorted({first.min(), first.max()})) if len(first) else ""
        when = when and f" (first at k = {when})"
        return f"{found.sum()} of {len(found)}{when}"


def _spread(values: Array, form: str, unit: str = "") -> str:
    def said(value: float) -> str:
        return f"{CEILING:g} or a fall" if value >= CEILING and not unit else f"{value:{form}}"

    low, middle, high = (said(f(values)) for f in (np.min, np.median, np.max))
    return f"{middle}{unit} ({low} to {high})" if low != high else f"{middle}{unit}"


def claims() -> str:
    """Returns the table of the paper's claims: what it says, what is measured, whether it holds.

    In `claims.md` a figure is {PANEL METHOD FIGURE}, perhaps with its k, by the names of `Claim`;
    {odds KIND} are the probabilities that a seed of vgps ends lower.
    """

    def figure(found: re.Match[str]) -> str:
        name, *words = found[1].split()
        if name == "odds":
            odds = ((other, row[words[0]]) for other, row in probabilities().items())
            return ", ".join(f"{odd:.2f} over {other}" for other, odd in odds if other != RISING)
        method, figure, *k = words
        said: str = getattr(Claim(name, method), figure)(*map(int, k))
        return said

    return re.sub(r"\{([^}]+)\}", figure, CLAIMS.read_text())


def policies() -> str:
    """Returns the table of policies on ten seeds: median and worst."""
    rows = read_rows(EVIDENCE / "policies.jsonl")
    costs = ("deterministic_cost", "stochastic_cost_median")
    shares = (("perturbed_20s", "perturbed_10s"), ("noise_4s",), ("noise_20s",))
    shown = []
    for task, units, first in (
        ("swimmer", 5, 701), ("swimmer", 10, 701), ("walker", 10, 701), ("walker", 5, 701),
        ("hopper", [64, 64], 701), ("hopper", [64, 64], 708),
    ):  # fmt: skip
        own = [r for r in rows if (r["task"], r["units"]) == (task, units) and r["seed"] >= first]
        cells = []
        for name in costs:
            values = [r[name] if r[name] is not None else np.inf for r in own]
            form = ".0f" if np.median(values) > 100 else ".3f"
            cells.append(f"{np.median(values):{form}} ({max(values):{form}})")
        for names in shares:
            values = [r[name] for r in own for name in names if name in r]
            text = f"{np.median(values):.0%} ({min(values):.0%})" if values else "–"
            cells.append(text.replace("%", " %"))
        size = " and ".join(map(str, units)) if isinstance(units, list) else str(units)
        seeds = f"{first} to {max(r['seed'] for r in own)}"
        cells.append(f"{np.median([r['seconds'] for r in own]):.0f} s")
        shown.append((f"{task}, {size} units", seeds, *cells))
    head = ("without noise", "with noise", "perturbed starts", "noise, 4 s", "noise, 20 s")
    return table(("policy", "seeds", *head, "processor time"), shown)


def motions(names: Iterable[str]) -> str:
    """Returns the table of robots that learn a motion."""
    shown = []
    for name in names:
        own = [row for row in lines() if row["robot"] == name]
        optima = [row for row in own if "converged_cost" in row]
        starts = [ratio for row in optima for ratio in row["perturbed_to_converged"]]
        shown.append(
            (
                f"[{name.rpartition('/')[2]}](robots/{name}.png)",
                ", ".join(map(str, own[0]["hidden_units"])),
                f"{_each('seed', own)}; {', '.join(dict.fromkeys(r['commit'] for r in own))}",
                _each("deterministic", own, "{:.2f}"),
                _each("stochastic_median", own, "{:.2f}"),
                _each("deterministic_to_converged", optima, "{:.2f}"),
                f"{np.median(starts):.2f} ({max(starts):.2f})" if starts else "–",
                _each("stochastic_survival", own, "{:.0%}").replace("%", " %"),
                _each("speed", own, "{:.2f}"),
            )
        )
    head = ["robot", "hidden units", "seeds; commit", "without noise", "with noise"]
    head += ["÷ converged DDP", "the same, perturbed starts", "stays up with noise", "m/s"]
    return table(head, shown)


def legs() -> str:
    """Returns the table of robots with legs that obey commands: a line each, its seeds in order."""
    found: dict[str, list[dict[str, Any]]] = {}
    for row in sorted(read_rows(LEGS), key=lambda row: int(row["seed"])):
        found.setdefault(row["robot"], []).append(row)

    def shares(name: str, own: list[dict[str, Any]]) -> str:
        values = (row[name] for row in own)
        return " / ".join("–" if share is None else f"{100 * share:.0f}" for share in values)

    shown = []
    for robot in sorted(found, key=lambda robot: -min(row["obeys"] for row in found[robot])):
        own = found[robot]
        picture = f"{robot.lower().replace(' ', '_')}.png"
        errors = (" ".join(f"{e:.3f}".removeprefix("0") for e in row["errors"]) for row in own)
        shown.append(
            (
                f"[{robot}](robots/{picture})" if (ROBOTS / picture).is_file() else robot,
                own[0]["note"],
                _each("seed", own),
                shares("up", own),
                shares("obeys", own),
                shares("changing_up", own),
                shares("changing_obeys", own),
                " / ".join(errors),
                _each("borne", own).replace("None", "–"),
                shares("late", own),
                _each("minutes", own, "{:.0f}"),
                ", ".join(dict.fromkeys(row["commit"] for row in own)),
            )
        )
    head = ["robot", "its model", "seeds", "up [%]", "obeys [%]", "changing: up", "obeys"]
    return table((*head, "errors", "borne [N·s]", "late: up", "minutes", "commit"), shown)


def _each(name: str, rows: Iterable[dict[str, Any]], form: str = "{}") -> str:
    return " / ".join(form.format(row[name]) for row in rows) or "–"


def past_the_paper() -> str:
    """Returns the table of methods beside vgps: medians over seeds, worst in brackets."""
    shown, names = [], dict.fromkeys(row["task"] for row in read_rows(PAST_ROWS))
    for task, method in product(names, (*PAST, *PEERS)):
        own = [r for r in read_rows(PAST_ROWS) if (r["task"], r["method"]) == (task, method)]
        if not own:
            continue
        last = ([row[name][-1] for row in own if name in row] for name in PAST_COSTS)
        ends = [[np.inf if cost is None else cost for cost in costs] for costs in last]
        costs = [
            f"{np.median(e):.0f} ({max(e):.0f})".replace("inf", "diverges") if e else "–"
            for e in ends
        ]
        shares = [row["stochastic_survival"][-1] for row in own if "stochastic_survival" in row]
        survival = f"{np.median(shares):.0%}" if shares else "–"
        seeds = f"{_each('seed', own)}; {', '.join(dict.fromkeys(r['commit'] for r in own))}"
        taken = (np.median([row["steps"][i] for row in own]) / 1e3 for i in (0, -1))
        seconds = f"{np.median([row['seconds'] for row in own]):.0f} s"
        steps = ", ".join(f"{each:.0f}" for each in taken)
        shown.append((task, method, seeds, *costs, survival.replace("%", " %"), steps, seconds))
    head = ["task", "method", "seeds; commit", "q", "policy without noise", "with noise, median"]
    head += ["stays up with noise", "thousand simulator steps: k = 1, end", "processor time"]
    return table(head, shown)


def robustness() -> str:
    """Returns the table of pushes, slopes and loads that walkers bear."""
    found = json.loads((EVIDENCE / "robustness.json").read_text())
    pushes = next(iter(found.values()))["robustness"]["pushes"]["values"]
    rows = []
    for label, result in found.items():
        own = result["robustness"]
        shares = own["pushes"]["survival"]
        (_, push), slopes, (_, load) = (own[k]["borne"] for k in ("pushes", "slopes", "payloads"))
        borne = f"{push:g} N·s, slopes of {slopes[0]:g} to {slopes[1]:g} rad, {load:g} kg"
        rows.append((label, *(f"{share:.0%}".replace("%", " %") for share in shares), borne))
    head = [f"{push:g} N·s" for push in pushes]
    return table(("learned from", *head, f"borne by {ENOUGH:.0%}".replace("%", " %")), rows)


def fresh_seeds() -> str:
    """Returns the table of the quadruped's fresh seeds, of the rows of the page on controllers."""
    text = (
        (EVIDENCE / "controller.md").read_text().partition("## Ten seeds")[2].partition("\n## ")[0]
    )
    head, *rows = (line.strip("| \n").split(" | ") for line in re.findall(r"^\|.*$", text, re.M))
    own = [row for row in rows if row[0].isdigit() and int(row[0]) in FRESH]
    shown = []
    for i, name in enumerate(head[1:], start=1):
        values = np.array([re.findall(r"\d*\.\d+", row[i]) for row in own], dtype=float)
        band = with_interval(interquartile_mean, values)
        triples = zip(*vars(band).values(), strict=True)
        form = ".3f" if "error" in name else ".2f"
        shown.append(
            (name, ", ".join(f"{m:{form}} ({a:{form}} to {b:{form}})" for m, a, b in triples))
        )
    return table(("what", f"{len(own)} fresh seeds"), shown)


_FEWEST = 5  # seeds for an interval: of three, 20 % would not hold what is alike
_BAND = "{:.2f} ({:.2f} to {:.2f})"
_FELL = 1.0  # error of a training that failed [m/s, rad/s], about that of one that stands


def parts(differences: bool = False) -> str:
    """Returns the table of vgps and its variants, or of what each variant has beyond vgps."""
    rows = {(row["variant"], row["seed"]): row for row in read_rows(PARTS_ROWS)}
    return _by_seed(rows, list(VARIANTS), differences)


def rivals(differences: bool = False) -> str:
    """Returns the table of vgps and its rivals, or of what each rival has beyond vgps."""
    rows = {(row["method"], row["seed"]): row for row in read_rows(RIVALS_ROWS)}
    names = ["vgps", *dict.fromkeys(method for method, _ in rows)]
    own = {("vgps", r["seed"]): r for r in read_rows(PARTS_ROWS) if r["variant"] == WHOLE}
    return _by_seed(own | rows, names, differences)


def tuning() -> str:
    """Returns the table of PPO's trials."""
    rows = read_rows(TUNING_ROWS)
    names = list(rows[0]["settings"]) if rows else []
    best = max(rows, key=lambda row: row["value"], default=None)
    shown = [
        (
            f"**{row['trial'] + 1}**" if row is best else str(row["trial"] + 1),
            *(f"{row['settings'][name]:.3g}" for name in names),
            *(", ".join(f"{share:.2f}" for share in row[key]) for key in ("up", "obeys")),
        )
        for row in rows
    ]
    return table(("trial", *(f"`{name}`" for name in names), "up", "obeys"), shown)


def _by_seed(
    own: dict[tuple[str, int], dict[str, Any]], names: list[str], differences: bool
) -> str:
    """Returns the table of trainings, or of what each has beyond those of the first name.

    It has the seeds that all names have: the figure of each, of enough seeds their interquartile
    mean. Of differences a cell also says how probable it is that a seed of this name is better than
    one of the first.
    """
    first = names[0]
    seeds = sorted({seed for _, seed in own if all((name, seed) in own for name in names)})
    if len(seeds) < (_FEWEST if differences else 1) or len(names) == 1:
        count = len(seeds) if names[1:] else 0
        return f"Seeds of all columns so far: {count}; differences need {_FEWEST}.\n"
    trained = {name: [own[name, seed] for seed in seeds] for name in names}
    sides = {name: [_judged(row) for row in rows] for name, rows in trained.items()}
    pairs = [(i, i) for i in range(len(seeds))]
    found = {n: compare_figures([side, sides[first]], pairs) for n, side in sides.items()}
    names = names[1:] if differences else names
    shown = []
    for i, row in enumerate(found[first]):
        cells = [found[name][i] for name in names]
        if differences:
            apart = "{:+.3f} ({:+.3f} to {:+.3f}); "
            texts = [apart.format(*c["A less B"]) + _BAND.format(*c["A better"]) for c in cells]
        elif len(seeds) < _FEWEST:
            form = ".3f" if row["figure"].startswith("error") else ".2f"
            texts = [" / ".join(f"{value:{form}}" for value in c["values"][0]) for c in cells]
        else:
            texts = ["{:.3f} ({:.3f} to {:.3f})".format(*c["A"]) for c in cells]
        shown.append((row["figure"], *texts))
    if differences:
        return table(("figure", *names), shown)
    steps = [f"{_median(trained[n], 'simulator_steps') / 1e6:.1f}" for n in names]
    minutes = [f"{_median(trained[n], 'core_seconds') / 60:.0f}" for n in names]
    failed = [str(sum("error" in row for row in trained[n])) for n in names]
    shown += [("million simulator steps, median", *steps), ("core minutes, median", *minutes)]
    shown += [("failed by an error", *failed)]
    used = [row for rows in trained.values() for row in rows]
    made = {key: _listed(row[key] for row in used) for key in ("commit", "machine")}
    head = f"Seeds {_listed(map(str, seeds))}; commit {made['commit']}; {made['machine']}.\n\n"
    return head + table(("figure", *names), shown)


def _judged(row: dict[str, Any]) -> dict[str, float | None]:
    """Returns the figures of a training; one that failed by an error counts as one that fell."""
    sound = next((r for r in read_rows(PARTS_ROWS) if "error" not in r), row)
    groups = row if "error" not in row else sound
    found = {
        "obeys while commands change": groups["changing"]["obeys"][-1],
        "obeys at 25 commands": groups["all_commands"]["obeys"][-1],
    }
    found |= {
        f"error {name} at 25 commands": e for name, e in groups["all_commands"]["rms"].items()
    }
    for kind, (key, name) in TRIED.items():
        values = zip(groups[kind]["values"], groups[kind][key], strict=True)
        found |= {name.format(value): share for value, share in values}
    failed = "error" in row
    return {
        n: (_FELL if n.startswith("error") else 0.0) if failed or v is None else v
        for n, v in found.items()
    }


def _median(trained: Sequence[dict[str, Any]], name: str) -> float:
    return float(np.median([row[name] for row in trained if name in row]))


def _listed(texts: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(texts))


def _of_others() -> list[str]:
    return [n for n in robots() if n not in OWN and not n.startswith(ALONE)]


TABLES: dict[str, Callable[[], str]] = {
    **{f"Figure 1, {name}": partial(panel, name) for name in PANELS},
    "probability of improvement": improvements,
    "probability of improvement by robot": improvements_by_task,
    "claims": claims,
    "defaults": defaults,
    "policies": policies,
    "built-in robots": partial(motions, OWN),
    "robots of others": lambda: motions(_of_others()),
    "robots from a pose": lambda: motions(n for n in robots() if n.startswith(ALONE)),
    "robustness": robustness,
    "past the paper": past_the_paper,
    "legs": legs,
    "fresh seeds of the quadruped": fresh_seeds,
    "parts of vgps": parts,
    "differences by parts of vgps": partial(parts, differences=True),
    "vgps and PPO": rivals,
    "what PPO has beyond vgps": partial(rivals, differences=True),
    "trials of PPO": tuning,
}


def main() -> None:
    """Writes the tables of all pages."""
    for page in PAGES:
        page.write_text(written(page))


if __name__ == "__main__":
    main()
