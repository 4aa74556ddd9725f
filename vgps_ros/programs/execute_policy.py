# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Lets the policy drive the simulation in lock-step, and scores it.

It resets a running simulation, lets the policy drive it, and prints how far it came and what it
cost. It needs the nodes simulation and policy_executor, and a policy on the topic policy; start it
any time before or after them.
"""

import argparse
import math
from functools import partial
from pathlib import Path

from vgps_ros.core.settings import Range, Setting
from vgps_ros.programs.command_line import Parser, picture, refuse_existing
from vgps_ros.storage.files import write_json
from vgps_ros.storage.run_folder import read_result
from vgps_ros.tasks.course import FIGURE_OF_EIGHT, course_of
from vgps_ros.tasks.registry import TASK


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_settings(TASK)
    steps = Setting("steps", 1, Range(1, 1_000_000_000), "control steps to run")
    parser.add_settings(steps, unset="the horizon of the task, or the whole course")
    parser.add_argument(
        "--course",
        help=f"{FIGURE_OF_EIGHT}, or a file as `vgps drive` takes it: what is commanded by cmd_vel "
        "on the way, if the task has commands that come from there",
    )
    parser.add_argument(
        "--picture",
        type=picture,
        help="also draw what was driven beside what was commanded, if anything was",
    )
    parser.add_output("--json", "also write the figures here", metavar="FILE")
    parser.add_argument(
        "--result", type=Path, metavar="FILE", help="result.json whose costs to show beside"
    )
    parser.add_argument("--simulation", default="simulation", help="name of the simulation node")
    parser.add_ros_arguments("the simulation, a policy or a step")


def run(arguments: argparse.Namespace) -> None:
    """Runs the policy as the arguments say."""
    files = [path for path in (arguments.json, arguments.picture) if path]
    refuse_existing(files, overwrite=arguments.overwrite)
    from rich.progress import Progress
    from rich.table import Column, Table

    from vgps_ros.programs.policy_run import PolicyRun
    from vgps_ros.ros_runtime.runner import client_node
    from vgps_ros.search.commanded_motion import CommandedMotion
    from vgps_ros.tasks import make_task
    from vgps_ros.views.console import plain_console

    console = plain_console()
    task = make_task(arguments.task)
    is_driven = arguments.course and any(command.source for command in task.signals.commands)
    course = course_of(arguments.course) if is_driven else None
    period = task.dynamics.time_step
    steps = task.horizon if course is None else math.ceil(course.duration / period)
    steps = getattr(arguments, "steps", steps)
    training = read_result(arguments.result) if arguments.result else None
    how = (arguments.simulation, arguments.timeout, arguments.namespace, course)
    with client_node(partial(PolicyRun, task, *how)) as node, Progress(console=console) as progress:
        bar = progress.add_task("Executing the policy", total=steps)
        for done in node.execute(steps):
            progress.update(bar, completed=done)
    trajectory, driven = node.trajectory(steps), None
    if task.signals.names:
        task = task.in_context(contexts := node.contexts(steps))
        driven = CommandedMotion.of(task, trajectory, contexts)
    duration = steps * period
    distance = float(task.distance(trajectory.states[0], trajectory.states[-1]))
    rows = [("duration", duration, "s"), ("distance", distance, "m")]
    rows += [("mean speed", distance / duration, "m/s")]
    rows += [("cost", task.trajectory_cost(trajectory), "")]
    if driven:
        units = [command.unit for command in driven.commands]
        errors = zip(driven.errors.items(), units, strict=True)
        rows += [(f"rms error of {name}", error, unit) for (name, error), unit in errors]
        if driven.drift is not None:
            rows += [("end of the path off by", driven.drift, "m")]
        if arguments.picture:
            from vgps_ros.views.plots import driving, save

            save(driving(driven), arguments.picture)
    if arguments.json:
        figures = {name.replace(" ", "_"): figure for name, figure, _ in rows}
        write_json(arguments.json, {"task": task.name, "steps": steps, **figures})
    value = Column("value", justify="right")
    table = Table("", value, "unit", title=f"The policy drives the {task.name}")
    for name, figure, unit in rows:
        table.add_row(name, f"{figure:.3f}", unit)
    if training and not course:  # those costs are of the horizon
        last = training["iterations"][-1]
        for name, cost in (
            ("cost of the initial DDP solution", training["initial_ddp_cost"]),
            ("cost in training, deterministic", last["deterministic_cost"]),
            ("cost in training, stochastic", last["stochastic_cost_mean"]),
        ):
            table.add_row(name, "diverged" if cost is None else f"{cost:.3f}", "")
    console.print(table)
