# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Looks a task over: dimensions, cost, derivatives, DDP's progress, a picture, what looks wrong.

It takes seconds, and changes nothing. Example: vgps check hopper/task.yaml
"""

import argparse
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Range, Setting
from vgps_ros.programs.command_line import Parser, picture, refuse_existing

if TYPE_CHECKING:
    from vgps_ros.tasks import Task
    from vgps_ros.wizard.task_check import TaskCheck

ITERATIONS = Setting("iterations", 40, Range(1, 10_000), "most iterations of DDP")

SECONDS = Setting(
    "seconds", 30.0, Range(0.0), "time after which DDP, and the choice of a first motion, end [s]"
)


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of this command."""
    parser.add_argument("task", help="a name, a task file or its folder, or FILE.py:FUNCTION")
    parser.add_settings(ITERATIONS, SECONDS, SEED)
    text = "file for a picture of the optimised motion, such as motion.png"
    parser.add_output("--picture", text, type=picture)


def run(arguments: argparse.Namespace) -> None:
    """Checks the task, and prints what it finds."""
    from rich.console import Console
    from rich.progress import Progress

    if arguments.picture:
        refuse_existing([arguments.picture], overwrite=arguments.overwrite)
    try:
        with Progress(console=Console(stderr=True), transient=True) as progress:
            bar = progress.add_task("DDP", total=arguments.iterations)

            def advance(index: int, _: float) -> None:
                part = "DDP" if index <= arguments.iterations else "each command alone"
                progress.update(bar, completed=index, description=part)

            task, found = _examine_in_thread(arguments, advance)
    except KeyboardInterrupt:
        print("vgps check: interrupted.", file=sys.stderr, flush=True)
        os._exit(1)  # what is compiled may go on for minutes, and Python would wait for it
    _show(task, found)
    if arguments.picture and found.optimized:
        _draw(task, found, arguments.picture)


def _examine_in_thread(
    arguments: argparse.Namespace, on_iteration: Callable[[int, float], None]
) -> tuple["Task", "TaskCheck"]:
    """Looks the task over in a thread, since compiled code would hear of no signal in this one."""
    from vgps_ros.tasks import make_task
    from vgps_ros.wizard.task_check import examine_task

    outcome = Future[tuple["Task", "TaskCheck"]]()

    def work() -> None:
        try:
            task, given = make_task(arguments.task), (arguments.iterations, arguments.seed)
            outcome.set_result((task, examine_task(task, *given, on_iteration, arguments.seconds)))
        except Exception as error:
            outcome.set_exception(error)

    threading.Thread(target=work, daemon=True).start()
    return outcome.result()


def _show(task: "Task", found: "TaskCheck") -> None:
    """Prints what was found."""
    from rich.table import Column, Table
    from rich.text import Text

    from vgps_ros.views.console import table_console

    console, dims, freedoms = table_console(), task.dims, task.dynamics.model.nv
    console.print(
        f"{dims['n_x']} numbers a state ({freedoms} degrees of freedom, positions and "
        f"velocities), {dims['n_u']} controls, {task.controls.label()} "
        f"({', '.join(task.controls.names)}), "
        f"{task.horizon} steps of {task.dynamics.time_step:g} s and {task.lookahead} beyond, each "
        f"of {task.dynamics.substeps} simulator steps."
    )
    console.print(f"The policy reads {', '.join(task.observation.names)}.")
    if found.parts:
        table = Table(
            "part of the cost",
            Column("first guess" if found.is_guess else "first rollout", justify="right"),
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
        if found.is_guess:
            console.print(
                "It begins with a guess that no robot can follow (begin), so what it ends with may "
                "cost more."
            )
    if found.commands:
        names = ("commanded alone", "unit", "value", "DDP's motion does")
        table = Table(*names[:2], *(Column(name, justify="right") for name in names[2:]))
        for name, unit, value, does in found.commands:
            table.add_row(name, unit, f"{value:.3g}", f"{does:.3g}")
        console.print(table)
    if found.errors:
        median, most = np.quantile(found.errors, [0.5, 0.9])
        console.print(
            f"Derivatives differ from centred differences by {median:.1e} (median over steps), "
            f"{most:.1e} (90 %)."
        )
    for note in found.notes:
        console.print(f"Note: {note}", highlight=False)
    for trouble in found.troubles:
        console.print(Text.assemble(("!", "bold red"), f" {trouble}"))
    if not found.troubles:
        console.print("Nothing looks wrong.", style="green")


def _draw(task: "Task", found: "TaskCheck", path: Path) -> None:
    from vgps_ros.search.run_record import RunRecord
    from vgps_ros.views.filmstrip import RenderingError, filmstrip
    from vgps_ros.views.plots import motion, save

    assert found.optimized is not None
    run = RunRecord(task.mjcf, task.dynamics.time_step, executed_states=found.optimized.states)
    try:
        figure = filmstrip(run)
    except RenderingError:  # no OpenGL on this machine
        figure = motion(run)
    assert figure is not None
    save(figure, path)
    print(f"Wrote {path}.")
