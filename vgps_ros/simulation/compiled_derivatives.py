# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives of steps in a compiled loop, which calls MuJoCo's C functions without Python.

Where all forces of a robot have derivatives in closed form, as those of most robots with legs or
arms do, a step takes them (`compiled_closed_form`). Other steps, such as those of a body in a
fluid, or with a contact of two meshes, take differences of full steps, column by column. MuJoCo
computes a step in stages, and a neighbour whose positions, or velocities too, are those of the
point skips the stages that are valid for it already.
"""

import mujoco
import numpy as np

from vgps_ros.core.compilation import compile_at_first_call, compiled_part
from vgps_ros.simulation import mujoco_functions as mj
from vgps_ros.simulation.compiled_closed_form import find_moves, put_moves
from vgps_ros.simulation.compiled_states import (
    NEVER,
    copy,
    get_state,
    move,
    push_at,
    put_state,
    subtract,
)

# Stages that a step may skip, because their results are still valid from the step before.
_NOTHING = np.int32(mujoco.mjtStage.mjSTAGE_NONE)
_OF_POSITIONS = np.int32(mujoco.mjtStage.mjSTAGE_POS)
_OF_VELOCITIES = np.int32(mujoco.mjtStage.mjSTAGE_VEL)


@compile_at_first_call
def differentiate(  # type: ignore[no-untyped-def]  # pragma: no cover
    sim, mech, work, columns, eps, kink, first, states, controls, f_x, f_u
):
    """Writes f_x, f_u at N steps from the first on, by the chain rule over their simulator steps.

    Derivatives are along the `columns` of (δx, u); others are those of the identity. Controls come
    first, positions last, so that the stages which a step skips stay valid. Differences have width
    eps, and are centred where a velocity is within `kink` of zero; with an infinite `kink` all
    steps take them. Steps in which a push acts always do. Returns the number of simulator steps.
    """
    n_q, n_v, n_u = len(sim.qpos), len(sim.qvel), len(sim.ctrl)
    n_x, n_dx = states.shape[1], f_x.shape[1]
    z, warm, after = np.empty(n_x + n_u), np.empty(n_v), np.empty(n_x)  # z = (x, u)
    memory = np.empty(n_x + n_u), np.empty(n_x), np.empty(n_x), np.zeros(n_v), np.empty(n_dx)
    a, b = np.eye(n_dx), np.empty((n_dx, n_u))
    steps = 0
    for t in range(len(states)):
        copy(states[t], z[:n_x])
        copy(controls[t], z[n_x:])
        warm[:] = 0.0
        may_know = not push_at(sim, first + t) and mech.is_known and kink < np.inf
        for substep in range(sim.substeps):
            _step(sim, z, warm, _NOTHING, after)
            copy(sim.warmstart, warm)  # the constraint forces at the neighbours are close to these
            steps += 1
            if may_know and find_moves(sim, mech, z, after, work):
                put_moves(sim, mech, after, work, columns, a, b)
            else:
                is_centred = _is_any_below(z[n_q : n_q + n_v], kink)
                point = z, warm, after
                steps += _take_differences(sim, columns, eps, is_centred, point, memory, a, b)
            by_x, by_u = (a @ f_x[t], a @ f_u[t] + b) if substep else (a, b)
            copy(by_x.ravel(), f_x[t].ravel())
            copy(by_u.ravel(), f_u[t].ravel())
            copy(after, z[:n_x])
    push_at(sim, NEVER)
    return steps


@compiled_part
def _step(sim, z, warm, skip, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Steps from z = (x, u); the results of skipped stages must be valid for z."""
    put_state(sim, z)
    copy(z[len(after) :], sim.ctrl)
    copy(warm, sim.warmstart)
    mj.mj_step_skip(sim.model, sim.data, skip, 1)
    get_state(sim, after)


@compiled_part
def _take_differences(sim, columns, eps, centred, point, memory, a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes differences of steps at a point; returns their number.

    They point inwards where a control is at its limit: beyond it nothing changes.
    """
    (z, warm, after), (moved, plus, minus, direction, column) = point, memory
    n_v, n_x, n_dx, steps = len(sim.qvel), len(after), len(a), 0
    for j in columns:
        skip = _OF_VELOCITIES if j >= 2 * n_v else _OF_POSITIONS if j >= n_v else _NOTHING
        skip = skip if sim.structure.may_skip else _NOTHING
        width, is_centred = eps, centred
        if j >= n_dx:
            u = j - n_dx
            above, below = sim.high[u] - z[n_x + u], z[n_x + u] - sim.low[u]
            is_centred = centred and min(above, below) >= eps
            width = eps if above >= eps else -eps
        copy(z, moved)
        move(sim, moved, direction, j, width)
        _step(sim, moved, warm, skip, plus)
        if is_centred:
            copy(z, moved)
            move(sim, moved, direction, j, -eps)
            _step(sim, moved, warm, skip, minus)
            width = 2.0 * eps
        subtract(sim, plus, minus if is_centred else after, column)
        for i in range(n_dx):
            if j < n_dx:
                a[i, j] = column[i] / width
            else:
                b[i, j - n_dx] = column[i] / width
        steps += 2 if is_centred else 1
    return steps


@compiled_part
def _is_any_below(values, limit):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns whether the size of any value is below a limit."""
    for value in values:  # noqa: SIM110 - numba compiles a loop sooner
        if abs(value) < limit:
            return True
    return False
