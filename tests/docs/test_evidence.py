# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The pages of evidence: each figure is that of its rows, and each table can be made anew."""

import importlib.util
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks import evidence
from benchmarks.evidence import PAGES, TABLE, TABLES, written
from benchmarks.parts import VARIANTS, WHOLE
from vgps_ros.programs.__main__ import COMMANDS

ROOT = Path(__file__).parents[2]
PLANS = ("README", "protocol")  # what they name was not measured
EVIDENCE = [path for path in PAGES if path.parent.name == "evidence" and path.stem not in PLANS]
COMMIT = re.compile(r"\b(?=\d*[a-f])(?=[a-f]*\d)[0-9a-f]{7}\b")
COMMAND = re.compile(r"(?:python -m|make|vgps) (?:benchmarks[\w.]*|[a-z][\w-]*)")
MACHINE = re.compile(r"x86_64|aarch64")


def name_of(page: Path) -> str:
    return page.stem


def tables_with_what_is_said_of_them(text: str) -> list[tuple[str, str]]:
    """Returns each table that has figures, and the text of its section.

    The lines with which an enclosing section begins count too, but not those of the page where it
    has sections.
    """
    parts = re.split(r"^(#+) .*\n", text, flags=re.M)
    opening: dict[int, str] = {}
    found = []
    for marks, body in zip(parts[1::2], parts[2::2], strict=True):
        level = len(marks)
        opening = {each: said for each, said in opening.items() if each < level} | {level: body}
        said = "".join(opening[each] for each in opening if each > 1 or each == level)
        tables = re.findall(r"(?:^\|.*\n)+", body, re.M)
        found += [(t, said) for t in tables if re.search(r"\d", "".join(t.splitlines()[2:]))]
    return found


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_tables_of_a_page_are_those_of_the_committed_rows(page):
    assert page.read_text() == written(page), "python -m benchmarks.evidence writes them anew"


def test_each_table_of_rows_stands_on_a_page():
    named = [name for page in PAGES for _, name, _ in TABLE.findall(page.read_text())]
    assert sorted(named) == sorted(TABLES)


@pytest.mark.parametrize("page", EVIDENCE, ids=name_of)
def test_each_table_of_figures_names_its_commit_its_command_and_its_machine(page):
    text = page.read_text()
    for table, said in tables_with_what_is_said_of_them(text):
        assert COMMIT.search(said), f"no commit:\n{table}"
        assert COMMAND.search(said), f"no command:\n{table}"
        assert MACHINE.search(said) or MACHINE.search(text.partition("\n## ")[0]), table


def test_a_table_without_its_commit_is_found():
    text = "# A\nCommit 1234abc.\n## B\nSaid.\n### C\n| a |\n| --- |\n| 1 |\n## D\nNot.\n"
    ((table, said),) = tables_with_what_is_said_of_them(text)
    assert "| 1 |" in table
    assert "Said" in said
    assert not COMMIT.search(said)
    assert COMMIT.search(text)


NUMBER = re.compile(r"(?<![\w.])(?:\d[\d,]*)?\.?\d+(?![\w.]*\d)")
LINK = re.compile(r"\]\(([\w./]+\.md)")
ITEM = re.compile(r"^- (?:.+\n)(?:  .+\n)*|^\| (?!---).+\n", re.M)


def numbers(text: str) -> set[float]:
    """Returns the numbers of a text, but for those in links and those spelt out."""
    plain = re.sub(r"\]\([^)]*\)|`[^`]*`", "]", text)
    return {float(number.replace(",", "")) for number in NUMBER.findall(plain)}


def untraced(page: Path) -> dict[str, set[float]]:
    """Returns, of each list item with links to pages, the numbers that none of them has."""
    found = {}
    for item in ITEM.findall(TABLE.sub("", page.read_text())):
        linked = [page.parent / link for link in LINK.findall(item)]
        if linked:
            found[item] = numbers(item) - set.union(*(numbers(p.read_text()) for p in linked))
    return found


def test_each_figure_of_the_summary_stands_on_the_page_that_it_links_to():
    found = untraced(next(page for page in EVIDENCE if page.stem == "summary"))
    assert len(found) > 10
    assert not {item: lacking for item, lacking in found.items() if lacking}


def test_each_figure_of_the_readmes_table_stands_on_the_pages_of_evidence():
    text = (ROOT / "README.md").read_text().partition("## What it can and cannot do")[2]
    pages = (*EVIDENCE, ROOT / "docs" / "how_to" / "train_a_controller.md")
    known = set[float]().union(*(numbers(page.read_text()) for page in pages))
    rows = [row for row in ITEM.findall(text.partition("\n## ")[0]) if row.startswith("|")]
    assert len(rows) > 8
    assert not {row: lacking for row in rows if (lacking := numbers(row) - known)}


def test_a_figure_that_its_page_does_not_have_is_found(tmp_path):
    (tmp_path / "rows.md").write_text("It costs .76, and 1,234 of them 91-100 %.\n")
    page = tmp_path / "page.md"
    page.write_text(
        "- 0.76 and 1234 of 91 ([rows](rows.md))\n- .77\n  here ([rows](rows.md))\n- 5\n"
    )
    assert list(untraced(page).values()) == [set(), {0.77}]


def training(variant: str, seed: int, share: float) -> dict[str, object]:
    """Returns a row as of `benchmarks.parts`, whose shares are all alike."""
    held = {"survival": [1.0], "obeys": [share], "rms": {"forward": 1.0 - share}}
    tried = {
        kind: {"values": [1.0], "survival": [share], "obeys": [share]} for kind in evidence.TRIED
    }
    made = {"commit": "1234abc", "machine": "x86_64", "simulator_steps": 1e6, "core_seconds": 60}
    return {
        "variant": variant,
        "seed": seed,
        "all_commands": held,
        "changing": held,
        **tried,
        **made,
    }


def test_differences_of_parts_are_of_pairs_of_whole_seeds(monkeypatch):
    rows = [
        training(name, seed, share - 0.1 * (name != WHOLE))
        for seed, share in ((9101, 0.5), (9102, 0.7), (9104, 0.7), (9105, 0.7), (9106, 0.9))
        for name in VARIANTS
    ]
    rows.append(training(WHOLE, 9103, 0.0))  # whose variants are still to come
    monkeypatch.setattr(evidence, "read_rows", lambda _: rows)
    figures, differences = evidence.parts(), evidence.parts(differences=True)
    assert "Seeds 9101, 9102, 9104, 9105, 9106; commit 1234abc" in figures
    assert "| obeys at 25 commands | 0.700 (0.567 to 0.833) | 0.600 (0.467 to 0.733) |" in figures
    # The same of each pair, while a seed of the variant is better than one of vgps in 7 of 25.
    assert "| obeys at 25 commands | -0.100 (-0.100 to -0.100); 0.28" in differences
    assert "| error forward at 25 commands | +0.100 (+0.100 to +0.100); 0.28" in differences


def test_a_training_that_failed_by_an_error_counts_as_one_that_fell(monkeypatch):
    rows = [training(name, 9101, 0.5) for name in VARIANTS]
    failed = {"variant": "with memory", "seed": 9101, "commit": "1234abc", "machine": "x86_64"}
    rows = [row for row in rows if row["variant"] != "with memory"] + [failed | {"error": 1}]
    monkeypatch.setattr(evidence, "read_rows", lambda _: rows)
    (line,) = [text for text in evidence.parts().splitlines() if "obeys at 25" in text]
    assert line.split(" | ")[5] == "0.00"  # one seed alone has no interval
    assert "so far: 1; differences need 5" in evidence.parts(differences=True)
    (line,) = [text for text in evidence.parts().splitlines() if "failed" in text]
    assert line == "| failed by an error | 0 | 0 | 0 | 0 | 1 | 0 |"


def test_rivals_stand_beside_vgps_on_the_seeds_that_both_have(monkeypatch):
    ours = [training(name, seed, 0.9) for seed in range(9101, 9106) for name in VARIANTS]
    theirs: list[dict[str, object]] = []
    rows = {evidence.PARTS_ROWS: ours, evidence.RIVALS_ROWS: theirs}
    monkeypatch.setattr(evidence, "read_rows", rows.get)
    assert "Seeds of all columns so far: 0" in evidence.rivals()
    theirs += [training("", seed, 0.4) | {"method": "PPO"} for seed in (9101, 9102)]
    figures = evidence.rivals()
    assert "Seeds 9101, 9102;" in figures
    assert "| figure | vgps | PPO |" in figures
    assert "| obeys at 25 commands | 0.90 / 0.90 | 0.40 / 0.40 |" in figures  # too few for a mean
    theirs += [training("", seed, 0.4) | {"method": "PPO"} for seed in (9103, 9104, 9105)]
    assert "| -0.500 (-0.500 to -0.500); 0.00 (" in evidence.rivals(differences=True)


@pytest.fixture(scope="module")
def history() -> list[str]:
    """The commits that led here; without them, as in a shallow clone or a package, skips."""

    def git(*words: str) -> str:
        command = ["git", *words]
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout

    if git("rev-parse", "--is-shallow-repository").strip() != "false":
        pytest.skip("no whole history here")
    return git("rev-list", "HEAD").split()


@pytest.mark.parametrize("page", EVIDENCE, ids=name_of)
def test_each_commit_of_a_page_is_of_this_history(page, history):
    assert set(COMMIT.findall(page.read_text())) <= {commit[:7] for commit in history}


@pytest.mark.parametrize("page", EVIDENCE, ids=name_of)
def test_each_command_of_a_page_exists(page):
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
    text = page.read_text()
    quoted = re.findall(r"^```bash\n(.*?)^```", text, re.M | re.S) + re.findall(r"`([^`]+)`", text)
    for command in COMMAND.findall("\n".join(quoted)):
        *program, name = command.split()
        if program == ["vgps"]:
            assert name in COMMANDS, command
        elif program == ["make"]:
            assert name in targets, command
        else:
            assert importlib.util.find_spec(name), command
