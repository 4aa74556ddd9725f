# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Looks a task over: dimensions, cost, derivatives, DDP's progress, a picture, what looks wrong.

It takes seconds, and changes nothing. Example: vgps check hopper/task.yaml
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Setting
from vgps_ros.experiments.command_line import Parser, picture, refuse_existing

if TYPE_CHECKING:
    from vgps_ros.experiments.task_check import TaskCheck
    from vgps_ros.tasks import Task

ITERATIONS = Setting("iterations", 40, "most iterations of DDP", minimum=1, maximum=10_000)


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of this command."""
    parser.add_argument("task", help="a name, a task file or its folder, or FILE.py:FUNCTION")
    parser.add_settings(ITERATIONS, SEED)
    text = "file for a picture of the optimised motion, such as motion.png"
    parser.add_output("--picture", text, type=picture)


def run(arguments: argparse.Namespace) -> None:
    """Checks the task, and prints what it finds."""
    from rich.console import Console
    from rich.progress import Progress

    from vgps_ros.experiments.task_check import check_task
    from vgps_ros.tasks import make_task

    if arguments.picture:
        refuse_existing([arguments.picture], overwrite=arguments.overwrite)
    task = make_task(arguments.task)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("DDP", total=arguments.iterations)
        found = check_task(
            task,
            arguments.iterations,
            arguments.seed,
            lambda index, _: progress.update(bar, completed=index),
        )
    show(task, found)
    if arguments.picture and found.optimized:
        _draw(task, found, arguments.picture)


def show(task: "Task", found: "TaskCheck") -> None:
    """Prints what was found."""
    from rich.table import Column, Table
    from rich.text import Text

    from vgps_ros.views.table_console import table_console

    console, dims, freedoms = table_console(), task.dims, task.dynamics.model.nv
    console.print(
        f"{dims['n_x']} numbers a state ({freedoms} degrees of freedom, positions and "
        f"velocities), {dims['n_u']} controls ({', '.join(task.actuated_joint_names)}), "
        f"{task.horizon} steps of {task.dynamics.time_step:g} s and {task.lookahead} beyond, each "
        f"of {task.dynamics.substeps} simulator steps."
    )
    console.print(f"The policy reads {', '.join(task.observation.names)}.")
    if found.parts:
        table = Table(
            "part of the cost",
            Column("first rollout", justify="right"),
            Column("optimised", justify="right"),
        )
        for name, first, last in found.parts:
            table.add_row(name, f"{first:.4g}", f"{last:.4g}")
        table.add_row(
            "all",
            f"{sum(first for _, first, _ in found.parts):.4g}",
            f"{sum(last for _, _, last in found.parts):.4g}",
            style="bold",
        )
        console.print(table)
    if len(found.costs) > 1:
        count = len(found.costs) - 1
        console.print(
            f"DDP: {found.costs[0]:.4g} to {found.costs[-1]:.4g} in {count} iterations and "
            f"{found.seconds:.1f} s, {found.seconds / count:.3f} s each."
        )
    if found.errors:
        median, most = np.quantile(found.errors, [0.5, 0.9])
        console.print(
            f"Derivatives differ from centred differences by {median:.1e} (median over steps), "
            f"{most:.1e} (90 %)."
        )
    for trouble in found.troubles:
        console.print(Text.assemble(("!", "bold red"), f" {trouble}"))
    if not found.troubles:
        console.print("Nothing looks wrong.", style="green")


def _draw(task: "Task", found: "TaskCheck", path: Path) -> None:
    from vgps_ros.views.filmstrip import RenderingError, filmstrip
    from vgps_ros.views.plots import motion, save
    from vgps_ros.views.run_record import RunRecord

    assert found.optimized is not None
    run = RunRecord(task.mjcf, task.dynamics.time_step, executed_states=found.optimized.states)
    try:
        figure = filmstrip(run)
    except RenderingError:  # no OpenGL on this machine
        figure = motion(run)
    assert figure is not None
    save(figure, path)
    print(f"Wrote {path}.")
