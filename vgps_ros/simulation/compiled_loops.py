"""Rollouts and derivatives in compiled loops, which call MuJoCo's C functions without Python."""

import mujoco
import numpy as np

from vgps_ros.core.compilation import compiled
from vgps_ros.core.compiled_network import network_output
from vgps_ros.simulation.compiled_readings import read
from vgps_ros.simulation.compiled_states import add, get_state, move, put_state, subtract
from vgps_ros.simulation.mujoco_functions import mj_step_skip

# Stages that a step may skip, because their results are still valid from the step before.
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)
_OF_POSITIONS = int(mujoco.mjtStage.mjSTAGE_POS)
_OF_VELOCITIES = int(mujoco.mjtStage.mjSTAGE_VEL)


@compiled
def advance(sim, bounds, states, controls, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Does one control step of N rollouts; `bounds` are those of states and controls.

    Clips the controls to their limits. Writes f(x, u) to `after`, but NaN where x, u or f(x, u) is
    out of bounds, and NaN to controls where x is. Returns how many controls were executed, and how
    many rollouts are within bounds.
    """
    executed = inside = 0
    for i in range(len(states)):
        x = after[i]
        x[:] = states[i]
        is_inside = _is_within(x, bounds[0])
        for j in range(len(sim.ctrl)):
            controls[i, j] = sim.ctrl[j] = _clipped(sim, j, controls[i, j])
        if not is_inside:
            controls[i] = np.nan
        elif _is_within(controls[i], bounds[1]):
            executed += 1
            is_inside = _advance(sim, x, bounds[0])
        else:
            is_inside = False
        if is_inside:
            inside += 1
        else:
            x[:] = np.nan
    return executed, inside


@compiled
def follow(  # type: ignore[no-untyped-def]  # pragma: no cover
    sim, bounds, nominal_states, nominal_controls, gains, gaps, states, controls
):
    """Writes the rollout of u = ū + K (x ⊖ x̄) from states[0], up to where it leaves its bounds.

    Where `gaps` has rows, one a step, each state stays short of f(x, u) by its row.
    """
    x, deviation = states[0].copy(), np.empty(gains.shape[2])
    if not _is_within(x, bounds[0]):
        return
    for t in range(len(controls)):
        subtract(sim, x, nominal_states[t], deviation)
        for i in range(len(sim.ctrl)):
            sim.ctrl[i] = nominal_controls[t, i]
            for j in range(len(deviation)):
                sim.ctrl[i] += gains[t, i, j] * deviation[j]
            sim.ctrl[i] = _clipped(sim, i, sim.ctrl[i])
        controls[t] = sim.ctrl
        if not (_is_within(sim.ctrl, bounds[1]) and _advance(sim, x, bounds[0])):
            return
        if len(gaps):
            add(sim, x, gaps[t], -1.0)
        states[t + 1] = x


@compiled
def execute(sim, bounds, network, observation, noise, states, controls):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes rollouts of u = μ_θ(h(x)) + noise from states[:, 0], up to where they leave bounds."""
    a, z = np.empty(np.max(network[1])), np.empty(np.max(network[1]))
    for rollout in range(len(states)):
        x = states[rollout, 0].copy()
        if not _is_within(x, bounds[0]):
            continue
        for t in range(noise.shape[1]):
            read(sim, observation, x, a)
            network_output(network, a, z)
            for i in range(len(sim.ctrl)):
                sim.ctrl[i] = _clipped(sim, i, a[i] + noise[rollout, t, i])
            controls[rollout, t] = sim.ctrl
            if not (_is_within(sim.ctrl, bounds[1]) and _advance(sim, x, bounds[0])):
                break
            states[rollout, t + 1] = x


@compiled
def _advance(sim, x, bound):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Lets the control act on x; returns false if x then is outside the bound."""
    put_state(sim, x)
    sim.warmstart[:] = 0.0  # nothing carries over from one control to the next
    for _ in range(sim.substeps):
        mj_step_skip(sim.model, sim.data, _NOTHING, 1)
    get_state(sim, x)
    return _is_within(x, bound)


@compiled
def _clipped(sim, i, control):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns a control within its limits; NaN stays."""
    return min(max(control, sim.low[i]), sim.high[i])


@compiled
def _is_within(values, bound):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns whether all values are inside the bound; NaN is not."""
    return np.all(np.abs(values) < bound)


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
