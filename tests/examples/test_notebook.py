# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The notebook is the example, executed: a kernel executes it anew, and finds the same figures."""

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


def text_of(notebook):
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return "".join(output.text for output in outputs if output.output_type == "stream")


def figures(text):
    return [float(number) for number in re.findall(r"-?\d+\.\d+", text)]


def test_the_notebook_runs_and_is_the_example_with_the_outputs_that_it_has(tmp_path, monkeypatch):
    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path))
    committed = nbformat.read(ROOT / "examples" / "01_linear_system.ipynb", as_version=4)
    nbformat.validate(committed)
    made = script().executed()
    assert [c.source for c in committed.cells] == [c.source for c in made.cells]
    assert len(figures(text_of(made))) == 20 * 5
    assert figures(text_of(made)) == pytest.approx(figures(text_of(committed)), abs=2e-4)
    bounds = [float(b) for b in re.findall(r"bound +(-?[\d.]+)", text_of(made))]
    assert bounds == sorted(bounds)
    pictures = [
        o for c in made.cells for o in c.get("outputs", []) if "image/png" in o.get("data", {})
    ]
    assert len(pictures) == 1
