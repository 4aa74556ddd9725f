"""Rollouts and derivatives in compiled loops, which call MuJoCo's C functions without Python."""

import mujoco
import numpy as np

from vgps_ros.core.compilation import compiled
from vgps_ros.core.compiled_network import network_output
from vgps_ros.core.records import Array
from vgps_ros.simulation.mujoco_functions import address, mj_step, mj_step_skip

# Stages that a step may skip, because their results are still valid from the step before.
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)
_OF_POSITIONS = int(mujoco.mjtStage.mjSTAGE_POS)
_OF_VELOCITIES = int(mujoco.mjtStage.mjSTAGE_VEL)
# Drag has a kink at zero velocity: differences are centred within so many perturbations of it.
_KINK = 10.0
Memory = tuple[int, int, Array, Array, Array, Array, int]
"""Addresses of model and data; qpos, qvel, ctrl and qacc_warmstart of the data; substeps."""


def memory_of(model: mujoco.MjModel, data: mujoco.MjData, substeps: int) -> Memory:
    """Returns what the loops need of a simulation; valid only while model and data live."""
    arrays = (data.qpos, data.qvel, data.ctrl, data.qacc_warmstart)
    return (address(model), address(data), *arrays, substeps)


@compiled
def advance(memory, bounds, states, controls, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Does one control step of N rollouts; `bounds` are those of states and controls.

    Writes f(x, u) to `after`, but NaN where x, u or f(x, u) is out of bounds, and NaN to controls
    where x is. Returns how many controls were executed, and how many rollouts are within bounds.
    """
    ctrl = memory[4]
    executed = inside = 0
    for i in range(len(states)):
        x = after[i]
        x[:] = states[i]
        is_inside = _is_within(x, bounds[0])
        if not is_inside:
            controls[i] = np.nan
        elif _is_within(controls[i], bounds[1]):
            ctrl[:] = controls[i]
            executed += 1
            is_inside = _advance(memory, x, bounds[0])
        else:
            is_inside = False
        if is_inside:
            inside += 1
        else:
            x[:] = np.nan
    return executed, inside


@compiled
def follow(  # type: ignore[no-untyped-def]  # pragma: no cover
    memory, bounds, nominal_states, nominal_controls, gains, states, controls
):
    """Writes the rollout of u = ū + K (x − x̄) from states[0], up to where it leaves its bounds."""
    ctrl = memory[4]
    x = states[0].copy()
    if not _is_within(x, bounds[0]):
        return
    for t in range(len(controls)):
        for i in range(len(ctrl)):
            ctrl[i] = nominal_controls[t, i]
            for j in range(len(x)):
                ctrl[i] += gains[t, i, j] * (x[j] - nominal_states[t, j])
        controls[t] = ctrl
        if not (_is_within(ctrl, bounds[1]) and _advance(memory, x, bounds[0])):
            return
        states[t + 1] = x


@compiled
def execute(memory, bounds, network, noise, states, controls):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes rollouts of u = μ_θ(x) + noise from states[:, 0], up to where they leave bounds."""
    ctrl = memory[4]
    a, z = np.empty(np.max(network[1])), np.empty(np.max(network[1]))
    for rollout in range(len(states)):
        x = states[rollout, 0].copy()
        if not _is_within(x, bounds[0]):
            continue
        for t in range(noise.shape[1]):
            network_output(network, x, a, z)
            for i in range(len(ctrl)):
                ctrl[i] = a[i] + noise[rollout, t, i]
            controls[rollout, t] = ctrl
            if not (_is_within(ctrl, bounds[1]) and _advance(memory, x, bounds[0])):
                break
            states[rollout, t + 1] = x


@compiled
def _advance(memory, x, bound):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Lets the control act on x; returns false if x then is outside the bound."""
    model, data, qpos, qvel, _, warmstart, substeps = memory
    n_v = len(qvel)
    qpos[:] = x[:n_v]
    qvel[:] = x[n_v:]
    warmstart[:] = 0.0  # nothing carries over from one control to the next
    for _ in range(substeps):
        mj_step(model, data)
    x[:n_v] = qpos
    x[n_v:] = qvel
    return _is_within(x, bound)


@compiled
def _is_within(values, bound):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns whether all values are inside the bound; NaN is not."""
    return np.all(np.abs(values) < bound)


@compiled
def differentiate(memory, columns, eps, states, controls, f_x, f_u):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes f_x, f_u at N points, by the chain rule over the simulator steps of one control.

    Takes differences of width eps along the `columns` of z = (x, u): controls first, positions
    last, so that the stages which a step skips stay valid. Returns the number of simulator steps.
    """
    _, _, _, qvel, ctrl, warmstart, substeps = memory
    n_v, n_u = len(qvel), len(ctrl)
    n_x = 2 * n_v
    z, warm = np.empty(n_x + n_u), np.empty(n_v)  # z = (x, u)
    after, plus, minus = np.empty(n_x), np.empty(n_x), np.empty(n_x)
    a, b = np.eye(n_x), np.empty((n_x, n_u))  # the columns of cyclic positions stay as they are
    steps = 0
    for t in range(len(states)):
        z[:n_x] = states[t]
        z[n_x:] = controls[t]
        warm[:] = 0.0
        for substep in range(substeps):
            _step(memory, z, warm, _NOTHING, after)
            warm[:] = warmstart  # the neighbours' constraint forces are close to these
            minus[:] = after
            centred = np.min(np.abs(z[n_v:n_x])) < _KINK * eps
            for j in columns:
                skip = _OF_VELOCITIES if j >= n_x else _OF_POSITIONS if j >= n_v else _NOTHING
                middle = z[j]
                z[j] = middle + eps
                _step(memory, z, warm, skip, plus)
                if centred:
                    z[j] = middle - eps
                    _step(memory, z, warm, skip, minus)
                z[j] = middle
                column = a[:, j] if j < n_x else b[:, j - n_x]
                column[:] = (plus - minus) / (2.0 * eps if centred else eps)
            steps += 1 + len(columns) * (2 if centred else 1)
            f_x[t] = a @ f_x[t] if substep else a
            f_u[t] = a @ f_u[t] + b if substep else b
            z[:n_x] = after
    return steps


@compiled
def _step(memory, z, warm, skip, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Steps from z = (x, u); the results of skipped stages must be valid for z."""
    model, data, qpos, qvel, ctrl, warmstart, _ = memory
    n_v = len(qvel)
    qpos[:] = z[:n_v]
    qvel[:] = z[n_v : 2 * n_v]
    ctrl[:] = z[2 * n_v :]
    warmstart[:] = warm
    mj_step_skip(model, data, skip, 1)
    after[:n_v] = qpos
    after[n_v:] = qvel
