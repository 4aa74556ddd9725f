# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A task under a disturbance, and draws of disturbances.

The push is part of the dynamics, x_{t+1} = f_t(x_t, u_t), which are as deterministic as without it:
an optimisation knows when it comes, rollouts and derivatives contain it. A policy does not know it,
since what it reads has no time; it learns what each q(ζ) does after its push.
"""

from dataclasses import replace
from functools import lru_cache

import mujoco
import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.patterns import known
from vgps_ros.core.records import Array
from vgps_ros.simulation.compiled_states import NO_PUSH, Push
from vgps_ros.simulation.disturbed_model import body_names, disturbed_model, may_rub
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.disturbance import Disturbance, DisturbanceSettings
from vgps_ros.tasks.task import Task

UNDISTURBED = Disturbance()


@lru_cache(maxsize=64)  # each solve of a search asks for the same ones
def disturbed(task: Task, disturbance: Disturbance) -> Task:
    """Returns the task under a disturbance: the same start and cost, other dynamics.

    Raises:
        InvalidInputError: the disturbance does not suit the robot.
    """
    if not (any(disturbance.push) or disturbance.changes_model):
        return task
    model = task.dynamics.model
    body = body_number(task, disturbance.body)
    if disturbance.friction != 1.0 and not may_rub(model):
        raise InvalidInputError(
            f"The friction of contacts shall change by the factor {disturbance.friction:.3g}, but "
            f"no two geoms of the robot of {task.name} can touch with friction; leave out "
            "disturb.friction or --frictions."
        )
    if disturbance.changes_model:
        model = disturbed_model(
            task.mjcf,
            body_names(task.mjcf)[body],
            disturbance.payload,
            disturbance.friction,
            disturbance.slope,
            disturbance.ridges,
            disturbance.ridges_seed,
        )
    push = _push(disturbance, body, task.dynamics.time_step)
    dynamics = Dynamics(model, task.dynamics.substeps, push=push)

    def here(features: Readings) -> Readings:
        return Readings(dynamics.simulations, features.names)

    cost = task.cost
    if isinstance(cost.features, Readings):  # not those of a task in Python that has its own
        cost = replace(cost, features=here(cost.features))
    return replace(
        task,
        dynamics=dynamics,
        cost=cost,
        observation=here(task.observation),
        fallen=replace(task.fallen, readings=here(task.fallen.readings)),
        limits=replace(task.limits, readings=here(task.limits.readings)),
    )


def draw_disturbance(
    task: Task, settings: DisturbanceSettings, rng: np.random.Generator
) -> Disturbance:
    """Draws a disturbance.

    Raises:
        InvalidInputError: there is no such body, or it cannot be pushed.
    """
    body = body_number(task, settings.body)
    time, angle, friction, slope, payload = rng.uniform(size=5)
    ahead = _direction(task, body, angle) if settings.push or settings.slope else np.zeros(2)
    return Disturbance(
        body=body_names(task.mjcf)[body],
        push=tuple((settings.push * ahead).tolist()),
        push_time=settings.push_before * time,
        push_duration=settings.push_duration,
        payload=settings.payload * payload,
        friction=1.0 + settings.friction * (2.0 * friction - 1.0),
        slope=tuple((settings.slope * (2.0 * slope - 1.0) * np.abs(ahead)).tolist()),
        ridges=settings.ridges,
        ridges_seed=int(rng.integers(2**32)) if settings.ridges else 0,
    )


def body_number(task: Task, name: str) -> int:
    """Returns the number of the body of this name, or of the heaviest one if it is empty.

    Raises:
        InvalidInputError: there is no such body.
    """
    if not name:
        return int(np.argmax(task.dynamics.model.body_mass))
    names = body_names(task.mjcf)[1:]
    return 1 + names.index(known("body", name, names))


def _push(disturbance: Disturbance, body: int, time_step: float) -> Push:
    if not any(disturbance.push):
        return NO_PUSH
    first = round(disturbance.push_time / time_step)
    steps = max(1, round(disturbance.push_duration / time_step))
    force = np.array([*disturbance.push, 0.0]) / (steps * time_step)
    return Push(body, first, first + steps, force)


def _direction(task: Task, body: int, share: float) -> Array:
    """Returns a horizontal direction in which a body can be pushed, shape (2,).

    Args:
        task: the robot.
        body: the body's number.
        share: draws the direction, from 0 to 1.
    """
    model = task.dynamics.model
    data, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
    data.qpos[:] = task.initial_state[: model.nq]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    free = np.abs(jacobian[:2]).max(axis=1) > 1e-9
    if not free.any():
        name = body_names(task.mjcf)[body]
        raise InvalidInputError(
            f"The body '{name}' cannot move horizontally, so that no push moves it; name another "
            "one as disturb.body."
        )
    if free.all():
        return np.array([np.cos(2 * np.pi * share), np.sin(2 * np.pi * share)])
    return np.where(free, 1.0 if share < 0.5 else -1.0, 0.0)
