# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The two costs that Figure 1 of the paper plots, and how far, fast and long a policy drives."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search.rollouts import Executions
from vgps_ros.tasks import Task

STEPS = 10_000_000  # of all rollouts together, whose states are in memory at once
SPREAD: dict[str, Callable[[Array], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "smallest": np.min,
    "largest": np.max,
}
FIGURES = {"time": "time [s]", "distance": "distance [m]", "speed": "speed [m/s]"}
FIGURES["cost_per_step"] = "cost per step"


@dataclass(frozen=True)
class Evaluation:
    """Costs of a policy.

    Attributes:
        deterministic_costs: cost without noise in each situation, shape (I,); inf where the
            rollout diverged.
        stochastic_costs: cost of each stochastic rollout, shape (N,); inf where it diverged.
        deterministic_survived: whether each deterministic rollout neither diverged nor fell, (I,).
        stochastic_survived: the same for the stochastic rollouts, shape (N,).
    """

    deterministic_costs: Array
    stochastic_costs: Array
    deterministic_survived: NDArray[np.bool_]
    stochastic_survived: NDArray[np.bool_]


def evaluate(
    tasks: Sequence[Task], policy: GaussianPolicy, rollouts: int, executions: Executions, k: int
) -> Evaluation:
    """Rolls the policy of iteration k out in each situation, once without noise from its x_1.

    Further rollouts, stochastic ones, start from draws around x_1; from them iteration k + 1 may
    learn.
    """
    costs, survived = [], []
    for i, here in enumerate(tasks):
        without = np.zeros((1, here.horizon, here.dynamics.control_dim))
        alone = here.dynamics.execute(policy, here.observation, here.initial_state[None], without)
        noisy = executions.of(here, policy, rollouts, k + 1, i)
        for states, controls in (alone, (noisy.states, noisy.controls)):
            costs.append(here.rollout_costs(states, controls))
            survived.append(here.survived(states))
    return Evaluation(
        deterministic_costs=np.concatenate(costs[::2]),
        stochastic_costs=np.concatenate(costs[1::2]),
        deterministic_survived=np.concatenate(survived[::2]),
        stochastic_survived=np.concatenate(survived[1::2]),
    )


def measure_driving(
    task: Task,
    driver: Driver,
    *,
    seconds: float,
    rollouts: int,
    perturbation: float,
    seed: int,
    stochastic: bool,
) -> dict[str, Any]:
    """Rolls a policy out from perturbed starts, with all commands at rest.

    Distance, speed and cost are those up to the end, or until a rollout falls or diverges. Of a
    robot that stays in its place it also says how far from its target each reading of the cost is
    in the last step, over the rollouts that neither fell nor diverged.

    Args:
        task: dynamics, cost, x_1 and what falling is.
        driver: the policy, with what it reads.
        seconds: length of each rollout [s].
        rollouts: their number.
        perturbation: standard deviation of the joints' angles in x_1 [rad]; that of their
            velocities is ten times as large [rad/s]. Slides stay where they are.
        seed: of all random draws.
        stochastic: whether the policy's noise is drawn.

    Raises:
        InvalidInputError: the rollouts have too many steps, or the policy has no noise to draw.
    """
    steps = max(1, round(seconds / task.dynamics.time_step))
    if rollouts * steps > STEPS:
        raise InvalidInputError(
            f"{rollouts} rollouts of {steps} steps are too many: use at most {STEPS} steps in all."
        )
    noise_std = driver.policy.noise_std
    if stochastic and not noise_std.any():
        raise InvalidInputError("The policy has no noise to draw; leave out --stochastic.")
    rng = generator(seed, Stream.EVALUATION, 0)
    starts = perturbed_starts(task, perturbation, rollouts, rng)

    context = task.signals.constant_context(task.signals.rest, steps)
    task = task.in_context(context)

    policy, n_u = driver.new_law(), task.dynamics.control_dim

    def control_law(t: int, x: Array) -> Array:
        noise = noise_std * rng.standard_normal((len(x), n_u)) if stochastic else 0.0
        return policy(driver.observation.within(context[t])(x), noise)

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
    figures = zip(FIGURES, (time, distance, distance / time, costs / lasted), strict=True)
    return {
        "task": task.name,
        "seconds": steps * task.dynamics.time_step,
        "rollouts": rollouts,
        "perturbation": perturbation,
        "seed": seed,
        "stochastic": stochastic,
        "survival": float(survived.mean()),
        **{name: _spread(values) for name, values in figures},
        "misses": _misses(task, states[survived], controls[survived]) if task.angles[0] else {},
    }


def _spread(values: Array) -> dict[str, float]:
    return {key: float(f(values)) for key, f in SPREAD.items()}


def _misses(task: Task, states: Array, controls: Array) -> dict[str, dict[str, float]]:
    """Returns how far each reading that the cost scores is from its target in the last step."""
    if not len(states) or task.cost.following:  # whose targets move
        return {}
    readings = task.cost.features(states[:, -2:-1], controls[:, -1:])[:, 0]
    misses = np.abs(readings - np.atleast_2d(task.cost.targets)[-1]).T
    return {name: _spread(each) for name, each in zip(task.cost_names, misses, strict=True)}


def perturbed_starts(
    task: Task, perturbation: float, rollouts: int, rng: np.random.Generator
) -> Array:
    """Draws initial states, shape (rollouts, n_x); see `measure_driving`."""
    space = task.dynamics.space
    scale = np.zeros(space.tangent_dim)
    scale[: len(task.angles)] = perturbation * task.angles
    scale[task.velocities] = 10.0 * perturbation * task.angles
    return space.add(task.initial_state, scale * rng.standard_normal((rollouts, len(scale))))
