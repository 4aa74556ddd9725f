# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The share of a policy's rollouts that survive pushes, slopes, payloads and other friction."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.tasks import Task
from vgps_ros.tasks.disturbance import Disturbance, DisturbanceSettings
from vgps_ros.tasks.disturbed_task import body_number, disturbed, draw_disturbance

ENOUGH = 0.9  # share of the rollouts that survive what a policy is said to bear

# Each kind of disturbance, with its name on an axis.
KINDS = {
    "pushes": "impulse [N·s]",
    "slopes": "slope, upwards [rad]",
    "payloads": "payload [kg]",
    "frictions": "factor on friction",
}


@dataclass(frozen=True)
class Trials:
    """The rollouts in which each disturbance is tried, the same ones for all of them.

    Attributes:
        starts: x_1 of each, shape (N, n_x).
        noise: shape (N, T, n_u), [N·m]; zeros for the policy without noise.
        seed: of the pushes' times and directions.
        settings: the body, and when and for how long it is pushed.
    """

    starts: Array
    noise: Array
    seed: int
    settings: DisturbanceSettings


def robustness(
    task: Task,
    policy: GaussianPolicy,
    trials: Trials,
    values: Mapping[str, Sequence[float]],
) -> dict[str, Any]:
    """Tries disturbances of several sizes.

    Args:
        task: the undisturbed robot.
        policy: π_θ.
        trials: the rollouts.
        values: sizes to try of each kind; see `KINDS`.

    Returns:
        By kind: the values in order, the share of rollouts that survive each, and between which
        values it is `ENOUGH`; None where not even so many survive without a disturbance.

    Raises:
        InvalidInputError: the task does not say what a fall is, or the body cannot be pushed.
    """
    if not task.fallen.lowest.size:
        raise InvalidInputError(
            f"The task {task.name} does not say when the robot has fallen, so that survival tells "
            "nothing; add `fallen` to its file."
        )
    body_number(task, trials.settings.body)

    @cache  # each kind is tried without a disturbance too, which is the same for all kinds
    def share(kind: str, value: float) -> float:
        drawn = _disturbances(task, kind, value, trials)
        return float(survived(task, policy, drawn, trials).mean())

    found = {}
    for kind, given in values.items():
        ordered, calm = sorted(given), 1.0 if kind == "frictions" else 0.0
        shares = [share("frictions", 1.0) if v == calm else share(kind, v) for v in ordered]
        found[kind] = {
            "values": ordered,
            "survival": shares,
            "borne": _borne(ordered, shares, calm) if share("frictions", 1.0) >= ENOUGH else None,
        }
    return found


def survived(
    task: Task, policy: GaussianPolicy, disturbances: Sequence[Disturbance], trials: Trials
) -> NDArray[np.bool_]:
    """Returns whether each rollout neither diverges nor falls under its disturbance, shape (N,)."""
    rows: dict[Disturbance, list[int]] = {}
    for i, disturbance in enumerate(disturbances):
        rows.setdefault(disturbance, []).append(i)
    standing = np.empty(len(disturbances), dtype=bool)
    for disturbance, own in rows.items():
        here = disturbed(task, disturbance)
        drawn = trials.starts[own], trials.noise[own]
        states, _ = here.dynamics.execute(policy, here.observation, *drawn)
        standing[own] = here.survived(states)
    return standing


def _disturbances(task: Task, kind: str, value: float, trials: Trials) -> list[Disturbance]:
    """Returns the disturbance of each trial; times and directions are the same for all values."""
    settings = replace(trials.settings, push=value)
    if kind == "pushes":
        rngs = (generator(trials.seed, Stream.DISTURBANCES, i) for i in range(len(trials.starts)))
        return [draw_disturbance(task, settings, rng) for rng in rngs]
    changes: dict[str, Any] = {
        "slopes": {"slope": (value, 0.0)},
        "payloads": {"body": settings.body, "payload": value},
        "frictions": {"friction": value},
    }
    return [Disturbance(**changes[kind])] * len(trials.starts)


def _borne(values: Sequence[float], shares: Sequence[float], calm: float) -> list[float]:
    """Returns the range around no disturbance, which is borne, in which all values are borne."""
    low = high = calm
    for value, share in zip(values, shares, strict=True):
        if value >= calm and share >= ENOUGH:
            high = value
        elif value >= calm:
            break
    for value, share in zip(reversed(values), reversed(shares), strict=True):
        if value <= calm and share >= ENOUGH:
            low = value
        elif value <= calm:
            break
    return [low, high]
