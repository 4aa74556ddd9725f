"""Lets the policy drive the simulation in lock-step, and scores it.

It resets a running simulation, lets the policy drive it, and prints how far it came and what it
cost. It needs the nodes simulation and policy_executor, and a policy on the topic policy; start it
any time before or after them.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.records import Trajectory
from vgps_ros.core.settings import Setting
from vgps_ros.experiments.command_line import (
    Parser,
    add_overwrite,
    add_ros_arguments,
    add_setting,
    refuse_existing,
)
from vgps_ros.storage.files import write_json
from vgps_ros.storage.run_folder import read_result
from vgps_ros.tasks.settings import TASK

if TYPE_CHECKING:
    from vgps_ros.tasks import Task

TIMEOUT = Setting(
    "timeout", 20.0, "longest wait for the simulation, a policy or a step [s]", minimum=0.1,
    maximum=86_400.0,
)  # fmt: skip


def score(task: "Task", trajectory: Trajectory) -> dict[str, float]:
    """Returns how far and how fast the robot came, and the task's cost."""
    duration = trajectory.horizon * task.dynamics.time_step
    distance = float(task.distance(trajectory.states[0], trajectory.states[-1]))
    return {
        "duration": duration,
        "distance": distance,
        "mean_speed": distance / duration,
        "cost": task.trajectory_cost(trajectory),
    }


def _show(
    console: Console, task: "Task", figures: dict[str, float], training: dict[str, Any] | None
) -> None:
    table = Table(title=f"The policy drives the {task.name}")
    table.add_column("")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name, unit in (("duration", "s"), ("distance", "m"), ("mean_speed", "m/s"), ("cost", "")):
        table.add_row(name.replace("_", " "), f"{figures[name]:.3f}", unit)
    if training:
        last = training["iterations"][-1]
        for name, cost in (
            ("cost of the initial DDP solution", training["initial_ddp_cost"]),
            ("cost in training, deterministic", last["deterministic_cost"]),
            ("cost in training, stochastic", last["stochastic_cost_mean"]),
        ):
            table.add_row(name, "diverged" if cost is None else f"{cost:.3f}", "")
    console.print(table)


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    for setting in (TASK, TIMEOUT):
        add_setting(parser, setting)
    parser.add_argument(
        "--steps", type=int, help="control steps to run; default: the horizon of the task"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    add_overwrite(parser)
    parser.add_argument(
        "--result", type=Path, metavar="FILE", help="result.json whose costs to show beside"
    )
    parser.add_argument("--simulation", default="simulation", help="name of the simulation node")
    add_ros_arguments(parser)


def run(arguments: argparse.Namespace) -> None:
    """Runs the policy as the arguments say."""
    if arguments.json:
        refuse_existing([arguments.json], overwrite=arguments.overwrite)
    import rclpy
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    try:
        _execute(arguments)
    except (ExternalShutdownException, RuntimeError) as error:
        # A signal may strike between any two calls of rclpy, which then lack their context.
        if rclpy.ok():
            raise
        raise KeyboardInterrupt from error
    finally:
        rclpy.try_shutdown()


def _execute(arguments: argparse.Namespace) -> None:
    from vgps_ros.ros_runtime.policy_run import PolicyRun
    from vgps_ros.tasks import make_task

    console = Console()
    task = make_task(arguments.task)
    steps = task.horizon if arguments.steps is None else arguments.steps
    if steps < 1:
        raise VgpsError(f"--steps is {steps}, but it must be at least 1.")
    training = read_result(arguments.result) if arguments.result else None
    node = PolicyRun(task, arguments.simulation, arguments.timeout)
    try:
        with Progress(console=console) as progress:
            bar = progress.add_task("Executing the policy", total=steps)
            for done in node.execute(steps):
                progress.update(bar, completed=done)
    finally:
        node.destroy_node()
    figures = score(task, node.trajectory(steps))
    if arguments.json:
        write_json(arguments.json, {"task": task.name, "steps": steps, **figures})
    _show(console, task, figures, training)
