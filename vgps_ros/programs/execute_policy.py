# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Lets the policy drive the simulation in lock-step, and scores it.

It resets a running simulation, lets the policy drive it, and prints how far it came and what it
cost. It needs the nodes simulation and policy_executor, and a policy on the topic policy; start it
any time before or after them.
"""

import argparse
from functools import partial
from pathlib import Path

from vgps_ros.core.settings import Setting
from vgps_ros.programs.command_line import Parser, refuse_existing
from vgps_ros.storage.files import write_json
from vgps_ros.storage.run_folder import read_result
from vgps_ros.tasks.registry import TASK


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    wait = "longest wait for the simulation, a policy or a step [s]"
    parser.add_settings(TASK, Setting("timeout", 20.0, wait, minimum=0.1, maximum=86_400.0))
    steps = Setting("steps", 1, "control steps to run", minimum=1, maximum=1_000_000_000)
    parser.add_settings(steps, unset="the horizon of the task")
    parser.add_output("--json", "also write the figures here", metavar="FILE")
    parser.add_argument(
        "--result", type=Path, metavar="FILE", help="result.json whose costs to show beside"
    )
    parser.add_argument("--simulation", default="simulation", help="name of the simulation node")
    parser.add_ros_arguments()


def run(arguments: argparse.Namespace) -> None:
    """Runs the policy as the arguments say."""
    if arguments.json:
        refuse_existing([arguments.json], overwrite=arguments.overwrite)
    from rich.progress import Progress
    from rich.table import Column, Table

    from vgps_ros.programs.policy_run import PolicyRun
    from vgps_ros.ros_runtime.runner import client_node
    from vgps_ros.tasks import make_task
    from vgps_ros.views.console import plain_console

    console = plain_console()
    task = make_task(arguments.task)
    steps = getattr(arguments, "steps", task.horizon)
    training = read_result(arguments.result) if arguments.result else None
    how = (arguments.simulation, arguments.timeout, arguments.namespace)
    with client_node(partial(PolicyRun, task, *how)) as node, Progress(console=console) as progress:
        bar = progress.add_task("Executing the policy", total=steps)
        for done in node.execute(steps):
            progress.update(bar, completed=done)
    trajectory = node.trajectory(steps)
    duration = steps * task.dynamics.time_step
    distance = float(task.distance(trajectory.states[0], trajectory.states[-1]))
    figures = {"duration": duration, "distance": distance, "mean_speed": distance / duration}
    figures["cost"] = task.trajectory_cost(trajectory)
    if arguments.json:
        write_json(arguments.json, {"task": task.name, "steps": steps, **figures})
    value = Column("value", justify="right")
    table = Table("", value, "unit", title=f"The policy drives the {task.name}")
    for (name, figure), unit in zip(figures.items(), ("s", "m", "m/s", ""), strict=True):
        table.add_row(name.replace("_", " "), f"{figure:.3f}", unit)
    if training:
        last = training["iterations"][-1]
        for name, cost in (
            ("cost of the initial DDP solution", training["initial_ddp_cost"]),
            ("cost in training, deterministic", last["deterministic_cost"]),
            ("cost in training, stochastic", last["stochastic_cost_mean"]),
        ):
            table.add_row(name, "diverged" if cost is None else f"{cost:.3f}", "")
    console.print(table)
