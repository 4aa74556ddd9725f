# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A simulation as compiled loops see it, and its states.

A state is x = (qpos, qvel, act). Arrays this short are copied by plain loops, which take a tenth of
the time of a slice.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compiled_part
from vgps_ros.core.records import Array
from vgps_ros.simulation.model import StepStructure
from vgps_ros.simulation.mujoco_functions import mj_differentiate_pos, mj_integrate_pos


class BodyPush(NamedTuple):
    """A force on a body's centre of mass during some control steps.

    Attributes:
        body: number of the body.
        first: the first step in which it acts; steps count from where a motion begins.
        last: the step in which it acts no longer.
        force: the force in the world's axes, shape (3,) [N].
    """

    body: int
    first: int
    last: int
    force: Array


NO_PUSH = BodyPush(0, 0, 0, np.zeros(3))
NEVER = np.int64(-1)  # a step in which no push acts


class CompiledSimulation(NamedTuple):
    """The arrays of a simulation, for the loops; valid only while its model and data live.

    Attributes:
        model: address of the model.
        data: address of the data, whose arrays the next fields are.
        low: lowest controls.
        high: highest controls; loops clip to both, and record what is left.
        substeps: simulator steps for which one control is held.
        structure: what derivatives of a step may leave out.
        smooth_rates: derivatives of smooth forces by velocities, row after row without zeros;
            row_lengths, row_starts and row_columns tell where each stands.
        applied: force and torque on each body's centre of mass along the world's axes, shape
            (nbody, 6) [N, N·m]; zero between two steps.
        push: the push, whose force loops write to `applied`.
    """

    model: int
    data: int
    qpos: Array
    qvel: Array
    act: Array
    ctrl: Array
    warmstart: Array
    sensordata: Array
    low: Array
    high: Array
    qacc: Array
    qfrc_actuator: Array
    substeps: int
    structure: StepStructure
    smooth_rates: Array
    row_lengths: NDArray[np.int32]
    row_starts: NDArray[np.int32]
    row_columns: NDArray[np.int32]
    applied: Array
    push: BodyPush


@compiled_part
def put_state(sim, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Puts the simulation into the state x with which z begins."""
    n_q, n_v, n_a = len(sim.qpos), len(sim.qvel), len(sim.act)
    for i in range(n_q):
        sim.qpos[i] = z[i]
    for i in range(n_v):
        sim.qvel[i] = z[n_q + i]
    for i in range(n_a):
        sim.act[i] = z[n_q + n_v + i]


@compiled_part
def copy(source, target):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Copies an array, as long as the target."""
    for i in range(len(target)):
        target[i] = source[i]


@compiled_part
def is_within(values, bound):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns whether all values are inside the bound; NaN is not."""
    for value in values:  # noqa: SIM110 - numba compiles a loop sooner
        if not abs(value) < bound:
            return False
    return True


@compiled_part
def push_at(sim, t):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Applies the push if it acts in control step t, or NEVER; returns whether it does."""
    acts = sim.push.first <= t < sim.push.last
    for i in range(len(sim.push.force)):
        sim.applied[sim.push.body, i] = sim.push.force[i] if acts else 0.0
    return acts


@compiled_part
def get_state(sim, x):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the simulation's state."""
    n_q, n_v, n_a = len(sim.qpos), len(sim.qvel), len(sim.act)
    for i in range(n_q):
        x[i] = sim.qpos[i]
    for i in range(n_v):
        x[n_q + i] = sim.qvel[i]
    for i in range(n_a):
        x[n_q + n_v + i] = sim.act[i]


@compiled_part
def subtract(sim, x, origin, deviation):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes x ⊖ origin."""
    n_q, n_v = len(sim.qpos), len(sim.qvel)
    mj_differentiate_pos(sim.model, deviation.ctypes.data, 1.0, origin.ctypes.data, x.ctypes.data)
    for i in range(n_q, len(x)):
        deviation[i - n_q + n_v] = x[i] - origin[i]


@compiled_part
def add(sim, x, deviation, size):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Moves x by a deviation times `size`."""
    n_q, n_v = len(sim.qpos), len(sim.qvel)
    mj_integrate_pos(sim.model, x.ctypes.data, deviation.ctypes.data, size)
    for i in range(n_q, len(x)):
        x[i] += size * deviation[i - n_q + n_v]


@compiled_part
def move(sim, x, direction, j, size):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Moves x along coordinate j of its deviations; `direction`, (n_v,), is zero before and after.

    Coordinates from n_dx on are those of the control, which stands behind x in the same array.
    """
    n_v = len(sim.qvel)
    if j < n_v:
        direction[j] = size
        mj_integrate_pos(sim.model, x.ctypes.data, direction.ctypes.data, 1.0)
        direction[j] = 0.0
    else:
        x[j - n_v + len(sim.qpos)] += size
