#!/usr/bin/env python3
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes the notebooks of examples/ from the examples of the same names, and executes them.

pip install -r requirements/notebook.txt        # in a checkout, make setup has done so
python scripts/write_notebook.py [01_linear_system] [09_quadruped]
"""

import ast
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

EXAMPLES = Path(__file__).parents[1] / "examples"
TUBE = """
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
"""
CURVE = """
import matplotlib.pyplot as plt

speeds, shares = np.array(curve).T
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
left.plot(range(1, len(curve) + 1), speeds, "o-")
left.axhline(0.6, color="grey", linestyle="--")
left.set(xlabel="iteration", ylabel="speed [m/s]", ylim=(0, 0.75))
right.plot(range(1, len(curve) + 1), shares, "o-")
right.set(xlabel="iteration", ylabel="share that bears a push", ylim=(-0.05, 1.05));
"""
SPEEDS = """
print("asked [m/s]   goes [m/s]   bear 20 N·s   bear 40 N·s")
for asked in (-0.4, 0.0, 0.4, 0.8):
    commands = held((10, (asked, 0, 0)))
    alone = drive(policy, commands)[0]
    borne = [task.survived(drive(policy, commands, 24, push)).mean() for push in (20, 40)]
    goes = (alone[-1, 0] - alone[0, 0]) / 10
    print(f"{asked:8.1f} {goes:13.2f} {borne[0]:13.0%} {borne[1]:13.0%}")
"""
STRIP = """
from vgps_ros.views.filmstrip import frames

course = held((3, (0.6, 0, 0)), (3, (0.3, 0, 0.8)), (3, (0, 0.3, 0)), (2, (0, 0, 0)))
states = drive(policy, course)[0]
times = np.linspace(0, len(states) - 1, 5).astype(int)
figure, axes = plt.subplots(1, 5, figsize=(13, 2), layout="constrained")
for each, picture, t in zip(axes, frames(task.mjcf, states[times], 240, 320), times, strict=True):
    each.imshow(picture)
    each.set_title(f"{t * period:.1f} s")
    each.set_axis_off()
"""
GIF = """
from io import BytesIO

from IPython.display import Image as Shown
from PIL import Image

pictures = [Image.fromarray(each) for each in frames(task.mjcf, states[::4], 180, 270)]
pictures = [each.quantize(palette=pictures[0].quantize(32), dither=0) for each in pictures]
file = BytesIO()
pictures[0].save(
    file, "GIF", save_all=True, append_images=pictures[1:], duration=round(4000 * period), loop=0
)
Shown(file.getvalue(), format="gif")
"""
# What each notebook has beyond its example: sentences and code, one after the other.
FURTHER = {
    "01_linear_system": [("The policy without noise goes along the middle of the tube.", TUBE)],
    "09_quadruped": [
        ("Speed and pushes after each iteration:", CURVE),
        ("Its policy reads no speed, so it errs a little, and pushes can fell it:", SPEEDS),
        ("A course, as MuJoCo renders it (which needs EGL, or `MUJOCO_GL=osmesa`):", STRIP),
        ("The same in motion. `vgps train --task quadruped` goes on to 22 iterations.", GIF),
    ],
}


def notebook(name: str) -> nbformat.NotebookNode:
    """Returns the notebook without outputs: the docstring, each part of the code, and more."""
    text = (EXAMPLES / f"{name}.py").read_text()
    module = ast.parse(text)
    title, _, about = str(ast.get_docstring(module)).rpartition("\n\n")[0].partition("\n")
    first = module.body[0].end_lineno or 0
    parts = "\n".join(text.splitlines()[first:]).strip().split("\n\n\n")
    cells = [new_markdown_cell(f"# {title}\n{about}"), *map(new_code_cell, parts)]
    for sentence, code in FURTHER[name]:
        cells += [new_markdown_cell(sentence), new_code_cell(code.strip())]
    for i, cell in enumerate(cells):
        cell.id = f"part-{i}"  # random otherwise
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return new_notebook(cells=cells, metadata={"kernelspec": kernel})


def executed(name: str) -> nbformat.NotebookNode:
    """Returns the notebook with the outputs of a kernel of its own."""
    made = notebook(name)
    NotebookClient(made, timeout=3600, kernel_name="python3").execute()
    return made


def main() -> None:
    """Writes the notebooks that are named on the command line; without a name, all of them."""
    for name in sys.argv[1:] or FURTHER:
        made = executed(name)
        for cell in made.cells:
            cell.metadata.pop("execution", None)  # times
        nbformat.write(made, EXAMPLES / f"{name}.ipynb")


if __name__ == "__main__":
    main()
