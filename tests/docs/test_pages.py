# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""README, CONTRIBUTING and docs: what they name exists, their code runs, their figures hold."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from vgps_ros.storage.plain_yaml import read_yaml
from vgps_ros.tasks import make_task
from vgps_ros.tasks.task_file import read_task_file

ROOT = Path(__file__).parents[2]
AT_THE_TOP = ("README", "CONTRIBUTING", "QUALITY_DECLARATION", "SECURITY")
PAGES = [
    *(ROOT / f"{name}.md" for name in AT_THE_TOP),
    *sorted((ROOT / "docs").glob("*.md")),
]
WRITTEN_BY_RUNS = {"bag/", "checkpoints/", "log/", "runs/", "recordings/", "tensorboard/"}
# In backticks, with a slash: no option, no topic, no service of a node, no environment's name.
# A word in capitals stands for a name.
PATH = re.compile(r"`((?![/~-]|[A-Z]+/)(?:[\w.-]+/(?:[\w.-]+/)*[\w.-]*|test_\w+\.py))`")
# Pages that scripts/site_pages.py makes of the code; `make site` checks all links again.
MADE_BY_THE_SITE = {"examples.md", "interfaces.md", "parameters.md", "api/index.md"}
COMMAND = re.compile(r"\bvgps ((?:node )?[a-z][\w-]*)")


def fenced(text: str) -> str:
    return "\n".join(re.findall(r"^```\w*\n(.*?)^```", text, re.M | re.S))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_path_link_and_command_of_a_page_exists(page):
    text = page.read_text()
    for link in re.findall(r"\]\(([^)#]+)", text):
        made = page.parent.name == "docs" and link in MADE_BY_THE_SITE
        assert made or "://" in link or (page.parent / link).exists(), link
    for path in set(PATH.findall(text)) - WRITTEN_BY_RUNS:
        assert (ROOT / path).exists() or (ROOT / "tests" / path).exists(), path
    for command in COMMAND.findall(fenced(text)):
        name = command.replace("-", "_").removeprefix("node ")
        folders = ("nodes",) if command.startswith("node ") else ("programs", "nodes")
        assert any((ROOT / "vgps_ros" / f / f"{name}.py").is_file() for f in folders), command
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
    assert set(re.findall(r"^make ([\w-]+)", fenced(text), re.M)) <= set(targets)


KEY = re.compile(r"`((?:changes|lookahead|marginals|begin|optimizer|search): [^`]+)`")


@pytest.mark.parametrize("page", ["tuning", "your_own_robot"])
def test_what_a_page_advises_for_a_task_file_may_stand_in_one(page, tmp_path):
    shutil.copytree(ROOT / "vgps_ros" / "tasks" / "hopper", tmp_path, dirs_exist_ok=True)
    whole = read_yaml((tmp_path / "task.yaml").read_text(), "the hopper's task")
    advice = KEY.findall((ROOT / "docs" / f"{page}.md").read_text())
    assert len(advice) >= 5
    for each in advice:
        (tmp_path / "task.yaml").write_text(yaml.safe_dump(whole | read_yaml(each, each)))
        read_task_file(tmp_path)
        if not each.startswith("changes"):  # which name what other models lack
            make_task(str(tmp_path))


def test_the_readme_is_short_and_its_picture_is_small():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 130
    assert (ROOT / "docs" / "robots.gif").stat().st_size < 2**20


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


def test_the_pages_quote_the_figures_of_the_committed_runs(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    blocks = importlib.import_module("page_blocks")
    figures = json.loads((ROOT / "docs" / "figures.json").read_text())
    quoted = set()
    for page in blocks.pages():
        text = page.read_text()
        assert blocks.with_figures(text, figures) == text, page
        quoted |= {name for _, name, _ in blocks.BLOCK.findall(text)}
    assert quoted == set(blocks.BLOCKS)
    figures["swimmer"]["four_initial_states"]["deterministic"] = 0.123
    readme = (ROOT / "README.md").read_text()
    assert "0.123" in blocks.with_figures(readme, figures)


def test_the_comparison_s_figures_are_those_of_its_rows(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    blocks = importlib.import_module("comparison_blocks")
    figures = json.loads((ROOT / "docs" / "figures.json").read_text())
    assert blocks.summed_up(ROOT / "docs" / "figure1.csv") == figures["comparison"]


def test_the_script_that_writes_the_figures_checks_them():
    command = [sys.executable, "scripts/write_figures.py", "--check"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
