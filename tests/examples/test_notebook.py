# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The notebooks are the examples, executed: a kernel executes them anew, and finds the same."""

import importlib.util
import re
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
ROOT = Path(__file__).parents[2]


def script():
    spec = importlib.util.spec_from_file_location("write", ROOT / "scripts" / "write_notebook.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def committed(name):
    notebook = nbformat.read(ROOT / "examples" / f"{name}.ipynb", as_version=4)
    nbformat.validate(notebook)
    return notebook


@pytest.fixture
def own_folders(tmp_path, monkeypatch):
    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path))


def sources(notebook):
    return [cell.source for cell in notebook.cells]


def text_of(notebook):
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return "".join(output.text for output in outputs if output.output_type == "stream")


def pictures(notebook, kind):
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return [output for output in outputs if kind in output.get("data", {})]


def figures(text):
    return [float(number) for number in re.findall(r"-?\d+\.\d+", text)]


def learned(text):
    """Returns the speed [m/s] and the percentage that bears a push, after each iteration."""
    rows = re.findall(r"^\d+: ([\d.]+) m/s of 0.6 m/s, (\d+)% bear", text, re.M)
    return [(float(speed), int(share)) for speed, share in rows]


def test_the_notebook_of_the_linear_system_has_the_outputs_of_its_code(own_folders):
    made = script().executed("01_linear_system")
    before = committed("01_linear_system")
    assert sources(before) == sources(made)
    assert len(figures(text_of(made))) == 20 * 5
    assert figures(text_of(made)) == pytest.approx(figures(text_of(before)), abs=2e-4)
    bounds = [float(b) for b in re.findall(r"bound +(-?[\d.]+)", text_of(made))]
    assert bounds == sorted(bounds)
    assert len(pictures(made, "image/png")) == 1


def test_the_notebook_of_the_quadruped_shows_one_that_learned_to_walk():
    before = committed("09_quadruped")
    assert sources(before) == sources(script().notebook("09_quadruped"))
    assert (ROOT / "examples" / "09_quadruped.ipynb").stat().st_size < 1_500_000
    assert len(learned(text_of(before))) == 8
    assert 0.4 < learned(text_of(before))[-1][0] < 0.8
    assert len(pictures(before, "image/png")) == 2
    assert len(pictures(before, "image/gif")) == 1


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_quadruped_of_the_notebook_learns_anew(own_folders):
    made = script().executed("09_quadruped")
    assert len(learned(text_of(made))) == 8
    assert max(share for _, share in learned(text_of(made))[-3:]) > 20
    [went] = re.findall(r"it goes ([\d.]+) m", text_of(made))
    assert 4.0 < float(went) < 8.0
