# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The pages of evidence: each figure is that of its rows, and each table can be made anew."""

import importlib.util
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks.evidence import PAGES, TABLE, TABLES, written
from vgps_ros.programs.__main__ import COMMANDS

ROOT = Path(__file__).parents[2]
EVIDENCE = [path for path in PAGES if path.parent.name == "evidence" and path.stem != "README"]
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
