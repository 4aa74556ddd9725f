# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""README, AGENTS, CONTRIBUTING and docs: what they name exists, and their code runs."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from vgps_ros import NODES
from vgps_ros.programs.__main__ import COMMANDS
from vgps_ros.storage.files import read_yaml
from vgps_ros.tasks import make_task
from vgps_ros.tasks.task_file import read_task_file

ROOT = Path(__file__).parents[2]
AT_THE_TOP = ("README", "AGENTS", "CONTRIBUTING", "QUALITY_DECLARATION", "SECURITY")
PAGES = [*(ROOT / f"{name}.md" for name in AT_THE_TOP), *sorted((ROOT / "docs").rglob("*.md"))]
EVIDENCE = ROOT / "docs" / "evidence"  # what was measured once; it names files of its time
TAUGHT = [page for page in PAGES if EVIDENCE not in page.parents]
WRITTEN_BY_RUNS = {"bag/", "checkpoints/", "dist/", "log/", "runs/", "recordings/", "tensorboard/"}
NO_PATHS = {"cmd_vel/linear/x", "m/s"}  # a field of a topic, and a unit
# In backticks, with a slash: no option, no topic, no service of a node, no environment's name.
# A word in capitals stands for a name.
PATH = re.compile(r"`((?![/~-]|[A-Z]+/)(?:[\w.-]+/(?:[\w.-]+/)*[\w.-]*|test_\w+\.py))`")
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")
COMMAND = re.compile(r"\bvgps ((?:node )?[a-z][\w-]*)")


def fenced(text: str) -> str:
    return "\n".join(re.findall(r"^```\w*\n(.*?)^```", text, re.M | re.S))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_leads_somewhere_in_the_repository(page):
    for link, anchor in LINK.findall(page.read_text()):
        assert "://" in link or (page.parent / link).exists(), link
        if anchor:
            assert anchor[1:] in anchors((page.parent / link).read_text()), link + anchor


def anchors(text: str) -> set[str]:
    """Returns the anchors of a page's headings, as code hosts and the site name them."""
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", TAUGHT, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_path_and_command_of_a_page_exists(page):
    text = page.read_text()
    for path in set(PATH.findall(text)) - WRITTEN_BY_RUNS - NO_PATHS:
        assert (ROOT / path).exists() or (ROOT / "tests" / path).exists(), path
    for command in COMMAND.findall(fenced(text)):
        word = command.removeprefix("node ")
        assert word in (NODES if command.startswith("node ") else [*COMMANDS, *NODES]), command
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
    assert set(re.findall(r"^make ([\w-]+)", fenced(text), re.M)) <= set(targets)


def test_the_navigation_names_all_pages_but_the_evidence():
    named = re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text())
    docs = ROOT / "docs"
    there = {str(page.relative_to(docs)) for page in TAUGHT if docs in page.parents}
    assert there <= set(named)


@pytest.mark.parametrize("page", ["docs/explanation/reliability.md", "SECURITY.md"])
def test_each_promise_of_a_page_on_trust_names_tests_that_exist(page):
    rows = [line for line in (ROOT / page).read_text().splitlines() if line.startswith("| ")]
    promises = [row for row in rows if "tested in" not in row and "---" not in row]
    assert len(promises) >= 6
    for row in promises:
        tests = re.findall(r"`([\w/]+\.py)`", row.split("|")[-2])
        assert tests, row
        assert all((ROOT / "tests" / name.removeprefix("tests/")).exists() for name in tests), row


KEY = re.compile(r"`((?:changes|lookahead|marginals|begin|optimizer|search): [^`]+)`")


def test_what_the_page_on_tuning_advises_may_stand_in_a_task_file(tmp_path):
    shutil.copytree(ROOT / "vgps_ros" / "tasks" / "hopper", tmp_path, dirs_exist_ok=True)
    whole = read_yaml((tmp_path / "task.yaml").read_text(), "the hopper's task")
    advice = KEY.findall((ROOT / "docs" / "how_to" / "tune.md").read_text())
    assert len(advice) >= 10
    for each in advice:
        (tmp_path / "task.yaml").write_text(yaml.safe_dump(whole | read_yaml(each, each)))
        read_task_file(tmp_path)
        if not each.startswith("changes"):  # which name what other models lack
            make_task(str(tmp_path))


def test_the_readme_is_short_and_its_picture_is_small():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120
    assert (ROOT / "docs" / "images" / "controller.gif").stat().st_size < 3 * 2**20


def test_the_readmes_lines_of_python_train_a_swimmer(tmp_path):
    (code,) = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), re.M | re.S)
    assert code.count("iterations=50") == 1
    run = subprocess.run(
        [sys.executable, "-c", code.replace("iterations=50", "iterations=2")],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    (path,) = tmp_path.rglob("result.json")
    result = json.loads(path.read_text())
    assert len(result["iterations"]) == 2
    cost, initial = result["iterations"][-1]["deterministic_cost"], result["initial_ddp_cost"]
    assert run.stdout.split() == (
        f"The policy costs {cost:.1f}, the initial DDP solution costs {initial:.1f}.".split()
    )
