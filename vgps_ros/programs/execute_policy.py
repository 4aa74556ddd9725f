"""Program `execute_policy`: lets the policy drive the simulation in lock-step, and scores it."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.utilities import remove_ros_args
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.records import Trajectory
from vgps_ros.ros_runtime.policy_run import PolicyRun
from vgps_ros.storage.files import write_json
from vgps_ros.storage.run_folder import read_result
from vgps_ros.tasks import TASKS, Task, make_task


def score(task: Task, trajectory: Trajectory) -> dict[str, float]:
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
    console: Console, task: Task, figures: dict[str, float], training: dict[str, Any] | None
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="execute_policy",
        description="Resets a running simulation, lets the policy drive it in lock-step, and "
        "prints how far it came and what it cost. Needs the nodes simulation and policy_executor, "
        "and a policy on the topic policy; start this program any time before or after them.",
    )
    parser.add_argument(
        "--task", default="swimmer", help=f"the simulation's task: {', '.join(sorted(TASKS))}"
    )
    parser.add_argument(
        "--steps", type=int, help="control steps to run (default: the horizon of the task)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    parser.add_argument(
        "--result", type=Path, metavar="FILE", help="result.json whose costs to show beside"
    )
    parser.add_argument(
        "--simulation", default="simulation", help="name of the simulation node (%(default)s)"
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=20.0,
        help="longest wait for the simulation, a policy or a step, in seconds (%(default)s)",
    )
    return parser


def _run(arguments: argparse.Namespace) -> None:
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
        content = {"task": task.name, "steps": steps, **figures}
        write_json(arguments.json, content)
    _show(console, task, figures, training)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    parsed = _parser().parse_args(remove_ros_args(sys.argv)[1:] if arguments is None else arguments)
    rclpy.init()
    try:
        _run(parsed)
    except (VgpsError, OSError) as error:
        sys.exit(f"execute_policy: {error}")
    except (KeyboardInterrupt, ExternalShutdownException, RuntimeError):
        # A signal may strike between any two calls of rclpy, which then lack their context.
        if rclpy.ok():
            raise
        sys.exit("execute_policy: interrupted.")
    finally:
        rclpy.try_shutdown()
