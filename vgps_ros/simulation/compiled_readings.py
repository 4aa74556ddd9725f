# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Readings of states in compiled loops, with their derivatives by finite differences."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compile_at_first_call, compiled_part
from vgps_ros.simulation import mujoco_functions as mj
from vgps_ros.simulation.compiled_states import copy, is_within, put_state

# What a reading is: a coordinate of the state, its sine or cosine, a number in sensordata, or (with
# 0 to 3 added) w, x, y or z of a quaternion.
COORDINATE, SINE, COSINE, SENSOR, QUATERNION = range(5)
# What MuJoCo has to compute for the sensors: nothing, positions and velocities of bodies, or all.
NOTHING, KINEMATICS, EVERYTHING = range(3)


class ReadingPlan(NamedTuple):
    """A plan tells the loops how to compute r readings.

    Attributes:
        needs: what MuJoCo has to compute.
        kinds: what each reading is, shape (r,).
        places: index of each in the state or in sensordata, shape (r,).
        tangent: index of each coordinate in a deviation, shape (r,); of the first of a rotation.
        columns: coordinates of (δx, u) that sensors feel, positions after all others.
    """

    needs: int
    kinds: NDArray[np.int64]
    places: NDArray[np.int64]
    tangent: NDArray[np.int64]
    columns: NDArray[np.int64]


@compile_at_first_call
def read_each(sim, plan, states, controls, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the readings of N states; NaN where a state or control is not finite."""
    for i in range(len(states)):
        if is_within(states[i], np.inf) and is_within(controls[i], np.inf):
            copy(controls[i], sim.ctrl)
            read(sim, plan, states[i], out[i])
        else:
            out[i] = np.nan


@compiled_part
def read(sim, plan, x, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the readings of a state, for the control that the simulation holds."""
    if plan.needs > NOTHING:
        put_state(sim, x)
        _compute(sim, plan.needs, True)
    for i in range(len(plan.kinds)):
        kind, place = plan.kinds[i], plan.places[i]
        if kind == SENSOR:
            out[i] = sim.sensordata[place]
        elif kind == COORDINATE or kind >= QUATERNION:
            out[i] = x[place]
        else:
            out[i] = np.sin(x[place]) if kind == SINE else np.cos(x[place])


@compiled_part
def _compute(sim, needs, positions_too):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Computes the sensors; those of positions may be valid already."""
    if needs == EVERYTHING:
        sim.warmstart[:] = 0.0
        mj.mj_forward(sim.model, sim.data)
        return
    if positions_too:
        mj.mj_kinematics(sim.model, sim.data)
        mj.mj_com_pos(sim.model, sim.data)
        mj.mj_sensor_pos(sim.model, sim.data)
    mj.mj_com_vel(sim.model, sim.data)
    mj.mj_subtree_vel(sim.model, sim.data)
    mj.mj_sensor_vel(sim.model, sim.data)


@compile_at_first_call
def differentiate_each(sim, plan, eps, states, controls, out, by_state, by_control):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the readings of N states, and their derivatives with respect to (δx, u).

    The width of the differences is eps. They are zero with respect to the control, except where
    MuJoCo has to compute everything.
    """
    n_q, n_v, n_dx = len(sim.qpos), len(sim.qvel), by_state.shape[2]
    direction = np.zeros(n_v)
    by_state[:] = 0.0
    by_control[:] = 0.0
    for n in range(len(states)):
        x = states[n]
        copy(controls[n], sim.ctrl)
        read(sim, plan, x, out[n])
        for j in plan.columns:  # each is moved in the simulation, and put back
            if j < n_v:
                direction[j] = eps
                mj.mj_integrate_pos(sim.model, sim.qpos.ctypes.data, direction.ctypes.data, 1.0)
                direction[j] = 0.0
                _compute(sim, plan.needs, True)
                copy(x, sim.qpos)
            elif j < 2 * n_v:
                sim.qvel[j - n_v] += eps
                _compute(sim, plan.needs, False)
                sim.qvel[j - n_v] = x[n_q + j - n_v]
            elif j < n_dx:
                sim.act[j - 2 * n_v] += eps
                _compute(sim, plan.needs, False)
                sim.act[j - 2 * n_v] = x[n_q + j - n_v]
            else:
                sim.ctrl[j - n_dx] += eps
                _compute(sim, plan.needs, False)
                sim.ctrl[j - n_dx] = controls[n, j - n_dx]
            for i in range(len(plan.kinds)):
                if plan.kinds[i] == SENSOR:
                    slope = (sim.sensordata[plan.places[i]] - out[n, i]) / eps
                    if j < n_dx:
                        by_state[n, i, j] = slope
                    else:
                        by_control[n, i, j - n_dx] = slope
        for i in range(len(plan.kinds)):
            kind, place, first = plan.kinds[i], plan.places[i], plan.tangent[i]
            if kind >= QUATERNION:
                part = kind - QUATERNION
                _turn(x[place - part : place - part + 4], part, by_state[n, i, first : first + 3])
            elif kind != SENSOR:
                by_state[n, i, first] = _slope(kind, x[place])


@compiled_part
def _turn(q, part, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the derivative of w, x, y or z of a quaternion with respect to a rotation."""
    if part == 0:
        for i in range(3):
            out[i] = -0.5 * q[1 + i]
        return
    axis, next_one, last = part - 1, part % 3, (part + 1) % 3
    out[axis] = 0.5 * q[0]
    out[next_one] = -0.5 * q[1 + last]
    out[last] = 0.5 * q[1 + next_one]


@compiled_part
def _slope(kind, value):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns the derivative of a reading with respect to its coordinate."""
    return 1.0 if kind == COORDINATE else np.cos(value) if kind == SINE else -np.sin(value)
