# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a controller's motions cost and ask of a robot: energy, forces, contacts.

The cost of transport is the energy by the weight and the way, P / (m g v), of the mechanical power
that actuators give or take at the joints, P = Σ |τ q̇|. Slip is the speed at which what touches the
ground moves along it, each contact weighted by its force. The load is the largest share of an
actuator's largest force.
"""

from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search.judgement import SETTLING, Trial, command_grid, execute_trial, first_phases
from vgps_ros.tasks import Task

SECONDS = 5.0  # length of the rollout at each command
_LEAST_SPEED = 0.1  # from which on a way has a cost [m/s]


@dataclass(frozen=True)
class GaitFigures:
    """Records what a motion costs and asks; None where there is nothing to measure."""

    power: float  # mean mechanical power [W]
    cost_of_transport: float | None  # P / (m g v) of what moves horizontally
    load: float | None  # largest force of an actuator by its limit
    slip: float | None  # mean speed of contacts along the ground [m/s]
    impact: float | None  # largest force from the ground by the robot's weight


def gaits(task: Task, driver: Driver) -> list[dict[str, Any] | None]:
    """Returns the figures at each command of the grid, from a rollout each; None after a fall."""
    grid, period = command_grid(task.signals), task.dynamics.time_step
    steps, first = round(SECONDS / period), round(SETTLING / period)
    trial = Trial(
        np.tile(task.initial_state, (len(grid), 1)),
        np.repeat(grid[:, None], steps, axis=1),
        np.zeros((len(grid), steps, task.dynamics.control_dim)),
        phases=first_phases(len(grid)),
    )
    states, controls, _ = execute_trial(task, driver, trial)
    return [
        asdict(measure_gait(task, x[first:], u[first:])) if is_up else None
        for x, u, is_up in zip(states, controls, task.survived(states), strict=True)
    ]


def measure_gait(task: Task, states: Array, controls: Array) -> GaitFigures:
    """Returns the figures of a motion.

    Args:
        task: the robot.
        states: shape (T+1, n_x).
        controls: shape (T, n_u).
    """
    model, data = task.dynamics.model, mujoco.MjData(task.dynamics.model)
    weight = float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))
    limited = model.actuator_forcelimited > 0
    strongest = np.abs(model.actuator_forcerange[limited]).max(axis=1)
    steps = len(controls)
    power, load, ground, slip, middle = (np.zeros((steps, *n)) for n in ((), (), (), (), (2,)))
    for t, (state, control) in enumerate(zip(states[:-1], controls, strict=True)):
        parts = np.split(state, [model.nq, model.nq + model.nv])
        data.qpos[:], data.qvel[:], data.act[:] = parts
        data.ctrl[:] = control
        mujoco.mj_forward(model, data)
        middle[t] = data.subtree_com[0, :2]
        power[t] = np.abs(data.qfrc_actuator * data.qvel).sum()
        load[t] = np.max(np.abs(data.actuator_force[limited]) / strongest, initial=0.0)
        forces, speeds = _contacts(model, data)
        ground[t], slip[t] = forces.sum(), forces @ speeds
    way = np.linalg.norm(middle[-1] - middle[0])
    speed = float(way / (max(1, steps - 1) * task.dynamics.time_step))
    mean, pressed = float(power.mean()), float(ground.sum())
    return GaitFigures(
        power=mean,
        cost_of_transport=mean / (weight * speed) if weight and speed > _LEAST_SPEED else None,
        load=float(load.max()) if limited.any() else None,
        slip=float(slip.sum()) / pressed if pressed else None,
        impact=float(ground.max()) / weight if weight else None,
    )


def _contacts(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Returns each contact's force from the world [N], and its speed along the ground [m/s]."""
    forces, speeds = [], []
    force, jacobian = np.zeros(6), np.zeros((3, model.nv))
    for i, contact in enumerate(data.contact):
        bodies = model.geom_bodyid[contact.geom]
        if 0 not in bodies or contact.efc_address < 0:
            continue
        mujoco.mj_contactForce(model, data, i, force)
        mujoco.mj_jac(model, data, jacobian, None, contact.pos, int(bodies.max()))
        normal, velocity = contact.frame[:3], jacobian @ data.qvel
        forces.append(force[0])
        speeds.append(np.linalg.norm(velocity - (velocity @ normal) * normal))
    return np.array(forces), np.array(speeds)
