"""Finite differences in a compiled loop, which calls MuJoCo's C functions without Python."""

import mujoco
import numpy as np

from vgps_ros.core.compilation import compiled
from vgps_ros.simulation.compiled_states import get_state, move, put_state, subtract
from vgps_ros.simulation.mujoco_functions import mj_step_skip

# Stages that a step may skip, because their results are still valid from the step before.
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)
_OF_POSITIONS = int(mujoco.mjtStage.mjSTAGE_POS)
_OF_VELOCITIES = int(mujoco.mjtStage.mjSTAGE_VEL)


@compiled
def differentiate(sim, columns, eps, kink, states, controls, f_x, f_u):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes f_x, f_u at N points, by the chain rule over the simulator steps of one control.

    Takes differences of width eps along the `columns` of (δx, u): controls first, positions last,
    so that the stages which a step skips stay valid. They are centred where a velocity is within
    `kink` of zero, and point inwards where a control is at its limit: beyond it nothing changes.
    Returns the number of simulator steps.
    """
    n_q, n_v, n_u = len(sim.qpos), len(sim.qvel), len(sim.ctrl)
    n_x, n_dx = states.shape[1], f_x.shape[1]
    z, moved, warm = np.empty(n_x + n_u), np.empty(n_x + n_u), np.empty(n_v)  # z = (x, u)
    after, plus, minus = np.empty(n_x), np.empty(n_x), np.empty(n_x)
    direction, column = np.zeros(n_v), np.empty(n_dx)
    a, b = np.eye(n_dx), np.empty((n_dx, n_u))  # the columns of cyclic positions stay as they are
    steps = 0
    for t in range(len(states)):
        z[:n_x] = states[t]
        z[n_x:] = controls[t]
        warm[:] = 0.0
        for substep in range(sim.substeps):
            _step(sim, z, warm, _NOTHING, after)
            warm[:] = sim.warmstart  # the neighbours' constraint forces are close to these
            centred = np.min(np.abs(z[n_q : n_q + n_v])) < kink
            for j in columns:
                skip = _OF_VELOCITIES if j >= 2 * n_v else _OF_POSITIONS if j >= n_v else _NOTHING
                width, is_centred = eps, centred
                if j >= n_dx:
                    u = j - n_dx
                    above, below = sim.high[u] - z[n_x + u], z[n_x + u] - sim.low[u]
                    is_centred = centred and min(above, below) >= eps
                    width = eps if above >= eps else -eps
                moved[:] = z
                move(sim, moved, direction, j, width)
                _step(sim, moved, warm, skip, plus)
                if is_centred:
                    moved[:] = z
                    move(sim, moved, direction, j, -eps)
                    _step(sim, moved, warm, skip, minus)
                subtract(sim, plus, minus if is_centred else after, column)
                target = a[:, j] if j < n_dx else b[:, j - n_dx]
                target[:] = column / (2.0 * eps if is_centred else width)
                steps += 2 if is_centred else 1
            steps += 1
            f_x[t] = a @ f_x[t] if substep else a
            f_u[t] = a @ f_u[t] + b if substep else b
            z[:n_x] = after
    return steps


@compiled
def _step(sim, z, warm, skip, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Steps from z = (x, u); the results of skipped stages must be valid for z."""
    put_state(sim, z)
    sim.ctrl[:] = z[len(after) :]
    sim.warmstart[:] = warm
    mj_step_skip(sim.model, sim.data, skip if sim.may_skip else _NOTHING, 1)
    get_state(sim, after)
