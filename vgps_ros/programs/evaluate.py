"""Program `evaluate`: how far, how fast and for how long a learned policy goes."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from vgps_ros.core.checks import positive
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.storage.files import write_json
from vgps_ros.storage.policy_file import load_policy
from vgps_ros.tasks import TASKS, Task, make_task
from vgps_ros.views.table_console import table_console

VELOCITY_PER_POSITION = 10.0  # a start perturbed by 0.01 rad is perturbed by 0.1 rad/s


def evaluate(
    task: Task,
    policy: GaussianPolicy,
    *,
    seconds: float,
    rollouts: int,
    perturbation: float,
    seed: int,
    stochastic: bool,
) -> dict[str, Any]:
    """Rolls a policy out from perturbed starts.

    Distance, speed and cost are those up to the end, or until a rollout falls or diverges.

    Args:
        task: dynamics, cost, x_1 and what falling is.
        policy: π_θ.
        seconds: length of each rollout [s].
        rollouts: their number.
        perturbation: standard deviation of the joints' angles in x_1 [rad]; that of their
            velocities is ten times as large [rad/s]. Slides stay where they are.
        seed: of all random draws.
        stochastic: whether the policy's noise is drawn.
    """
    positive("seconds", seconds)
    positive("rollouts", rollouts)
    if not (np.isfinite(perturbation) and perturbation >= 0):
        raise InvalidInputError(f"perturbation is {perturbation}, but it must be at least 0.")
    steps = max(1, round(seconds / task.dynamics.time_step))
    rng = generator(seed, Stream.EVALUATION, 0)
    scale = perturbation * np.concatenate([task.hinges, VELOCITY_PER_POSITION * task.hinges])
    starts = task.initial_state + scale * rng.standard_normal((rollouts, len(scale)))

    def control_law(_: int, x: Array) -> Array:
        mean = policy.mean(x)
        return mean + policy.noise_std * rng.standard_normal(mean.shape) if stochastic else mean

    states, controls, _ = task.dynamics.rollouts(starts, control_law, steps)
    standing = np.isfinite(states).all(axis=2) & ~task.fallen(states)
    # Steps up to the first state in which a rollout does not stand; 1 at least, for the means.
    lasted = np.where(standing.all(axis=1), steps, np.maximum(standing.argmin(axis=1), 1))
    survived = task.survived(states)
    time = lasted * task.dynamics.time_step
    last = np.where(survived, lasted, lasted - 1)
    distance = task.distance(starts, states[np.arange(rollouts), last])
    costs = task.cost(states[:, :-1], controls)
    costs = np.where(np.arange(steps) < lasted[:, None], costs, 0.0).sum(axis=1)
    return {
        "task": task.name,
        "seconds": steps * task.dynamics.time_step,
        "rollouts": rollouts,
        "perturbation": perturbation,
        "seed": seed,
        "stochastic": stochastic,
        "survival": float(survived.mean()),
        "time": _spread(time),
        "distance": _spread(distance),
        "speed": _spread(distance / time),
        "cost_per_step": _spread(costs / lasted),
    }


def _spread(values: Array) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "smallest": float(values.min()),
        "largest": float(values.max()),
    }


def show(result: dict[str, Any]) -> None:
    """Prints a result as a table."""
    kind = "stochastic" if result["stochastic"] else "deterministic"
    table = Table(
        title=f"{result['task']}, {kind} policy, {result['rollouts']} rollouts of "
        f"{result['seconds']:g} s, survival {100 * result['survival']:.0f} %"
    )
    names = {"time": "time [s]", "distance": "distance [m]", "speed": "speed [m/s]"}
    names["cost_per_step"] = "cost per step"
    columns = ("mean", "median", "smallest", "largest")
    table.add_column("until it falls or time is up")
    for column in columns:
        table.add_column(column, justify="right")
    for key, name in names.items():
        table.add_row(name, *(f"{result[key][column]:.3f}" for column in columns))
    table_console().print(table)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    silence_mujoco()
    parser = argparse.ArgumentParser(
        prog="evaluate", description="Rolls out a learned policy from perturbed starts."
    )
    parser.add_argument("--policy", type=Path, required=True, help="policy.json of a training")
    parser.add_argument("--task", choices=sorted(TASKS), required=True, help="control problem")
    parser.add_argument("--seconds", type=float, default=10.0, help="length of a rollout [s]")
    parser.add_argument("--rollouts", type=int, default=20, help="number of rollouts")
    parser.add_argument(
        "--perturbation",
        type=float,
        default=0.01,
        help="sd of the first joint angles [rad]; that of their velocities is ten times it",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random draws")
    parser.add_argument("--stochastic", action="store_true", help="draw the policy's noise")
    parser.add_argument("--json", type=Path, help="also write the result to this file")
    parsed = parser.parse_args(arguments)
    try:
        policy, learned_for = load_policy(parsed.policy)
        if learned_for != parsed.task:
            raise InvalidInputError(
                f"{parsed.policy} was learned for the task '{learned_for}', not '{parsed.task}'; "
                f"use --task {learned_for}."
            )
        task = make_task(parsed.task)
        policy.check_fits(task.dynamics.state_dim, task.dynamics.control_dim)
        result = evaluate(
            task,
            policy,
            seconds=parsed.seconds,
            rollouts=parsed.rollouts,
            perturbation=parsed.perturbation,
            seed=parsed.seed,
            stochastic=parsed.stochastic,
        )
        show(result)
        print(json.dumps(result))
        if parsed.json:
            write_json(parsed.json, result)
    except (VgpsError, OSError) as error:
        sys.exit(f"evaluate: {error}")
    except KeyboardInterrupt:
        sys.exit("evaluate: interrupted.")
