#!/usr/bin/env python3
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes examples/01_linear_system.ipynb from the example of the same name, and executes it.

pip install -r requirements/notebook.txt        # in a checkout, make setup has done so
python scripts/write_notebook.py
"""

import ast
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

EXAMPLE = Path(__file__).parents[1] / "examples" / "01_linear_system.py"
PICTURE = """
import matplotlib.pyplot as plt

mean, spread = [x_1], [S_1]
for K, S in zip(gains, covariances, strict=True):
    mean.append((A + B @ K) @ mean[-1])
    spread.append((A + B @ K) @ spread[-1] @ (A + B @ K).T + B @ S @ B.T)
time, place = dt * np.arange(T + 1), np.array(mean)[:, 0]
sd = np.sqrt(np.array(spread)[:, 0, 0])
acted = [x_1]
for _ in range(T):
    acted.append((A + B @ W) @ acted[-1])
plt.fill_between(time, place - 2 * sd, place + 2 * sd, alpha=0.3, label="q ± 2 sd")
plt.plot(time, place, label="mean of q")
plt.plot(time, np.array(acted)[:, 0], "--", label="policy without noise")
plt.xlabel("time [s]")
plt.ylabel("position [m]")
plt.legend();
""".strip()


def notebook() -> nbformat.NotebookNode:
    """Returns the notebook without outputs: the docstring, each part of the code, and a picture."""
    text = EXAMPLE.read_text()
    module = ast.parse(text)
    title, _, about = str(ast.get_docstring(module)).rpartition("\n\n")[0].partition("\n")
    first = module.body[0].end_lineno or 0
    parts = "\n".join(text.splitlines()[first:]).strip().split("\n\n\n")
    cells = [new_markdown_cell(f"# {title}\n{about}"), *map(new_code_cell, parts)]
    cells += [
        new_markdown_cell("The policy without noise goes along the middle of the tube."),
        new_code_cell(PICTURE),
    ]
    for i, cell in enumerate(cells):
        cell.id = f"part-{i}"  # random otherwise
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return new_notebook(cells=cells, metadata={"kernelspec": kernel})


def executed() -> nbformat.NotebookNode:
    """Returns the notebook with the outputs of a kernel of its own."""
    made = notebook()
    NotebookClient(made, timeout=300, kernel_name="python3").execute()
    return made


def main() -> None:
    """Writes the notebook."""
    made = executed()
    for cell in made.cells:
        cell.metadata.pop("execution", None)  # times
    nbformat.write(made, EXAMPLE.with_suffix(".ipynb"))


if __name__ == "__main__":
    main()
