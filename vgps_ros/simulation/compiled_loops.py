"""Rollouts and derivatives in compiled loops, which call MuJoCo's C functions without Python."""

import mujoco
import numpy as np

from vgps_ros.core.compilation import compiled
from vgps_ros.core.compiled_network import CompiledNetwork, network_output
from vgps_ros.core.dynamics import CONTROL_BOUND, DIVERGENCE_BOUND
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.simulation.mujoco_functions import address, mj_step, mj_step_skip

# Stages that a step may skip, because their results are still valid from the step before.
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)
_OF_POSITIONS = int(mujoco.mjtStage.mjSTAGE_POS)
_OF_VELOCITIES = int(mujoco.mjtStage.mjSTAGE_VEL)
# Drag has a kink at zero velocity: differences are centred within so many perturbations of it.
_KINK = 10.0
# A rollout whose states [m, rad, m/s, rad/s] or controls [N·m] leave these bounds has diverged.
_BOUNDS = (DIVERGENCE_BOUND, CONTROL_BOUND)


class Simulator:
    """One simulation of a model, for one thread at a time.

    Attributes:
        data: MuJoCo's record of the simulation.

    Args:
        model: a model with as many positions as velocities.
        substeps: simulator steps for which one control is held.
        cyclic: indices of the positions that change nothing but themselves.
    """

    def __init__(self, model: mujoco.MjModel, substeps: int, cyclic: Array):
        self.data = data = mujoco.MjData(model)
        self._model = model  # kept as long as its memory is used
        arrays = (data.qpos, data.qvel, data.ctrl, data.qacc_warmstart)
        self._memory = (address(model), address(data), *arrays, substeps)
        n_v, n_u = model.nv, model.nu
        # Controls first, positions last, so that the stages which a step skips stay valid.
        self._columns = np.concatenate(
            [
                np.arange(2 * n_v, 2 * n_v + n_u),
                np.arange(n_v, 2 * n_v),
                np.setdiff1d(np.arange(n_v), cyclic),
            ]
        )

    def advance(
        self, states: Array, controls: Array, after: Array, bounds: tuple[float, float] = _BOUNDS
    ) -> tuple[int, int]:
        """Does one control step of several rollouts.

        Args:
            states: x of each, shape (N, n_x); a rollout outside its bound has diverged.
            controls: u of each, shape (N, n_u); NaN afterwards where the rollout had diverged.
            after: result f(x, u), shape (N, n_x); NaN where x, u or the result is out of bounds.
            bounds: bounds on the magnitudes of states and controls.

        Returns:
            How many controls were executed, and how many rollouts are still inside the bounds.
        """
        executed, inside = _advance_each(self._memory, bounds, states, controls, after)
        return executed, inside

    def follow(self, start: Array, nominal: Trajectory, gains: Array) -> Trajectory:
        """Executes u = ū + K (x − x̄); NaN from where a state or a control leaves its bound.

        Args:
            start: x_1, shape (n_x,).
            nominal: x̄, ū.
            gains: K, shape (T, n_u, n_x).
        """
        states = np.full((nominal.horizon + 1, len(start)), np.nan)
        controls = np.full(nominal.controls.shape, np.nan)
        states[0] = start
        _follow(self._memory, _BOUNDS, nominal.states, nominal.controls, gains, states, controls)
        return Trajectory(states, controls)

    def execute(
        self, network: CompiledNetwork, noise: Array, states: Array, controls: Array
    ) -> None:
        """Executes u = μ_θ(x) + noise in several rollouts, one after another.

        Args:
            network: μ_θ.
            noise: shape (N, T, n_u), [N·m].
            states: result, shape (N, T+1, n_x), which begins with x_1; it stays as it was from
                where a state or a control leaves its bound.
            controls: result, shape (N, T, n_u), likewise.
        """
        _execute(self._memory, _BOUNDS, network, noise, states, controls)

    def differentiate(
        self, states: Array, controls: Array, eps: float, f_x: Array, f_u: Array
    ) -> int:
        """Writes f_x, f_u at points, by finite differences; returns the simulator steps it took.

        Args:
            states: shape (N, n_x).
            controls: shape (N, n_u).
            eps: perturbation.
            f_x: result, shape (N, n_x, n_x).
            f_u: result, shape (N, n_x, n_u).
        """
        return int(_differentiate(self._memory, self._columns, states, controls, eps, f_x, f_u))


@compiled
def _advance_each(memory, bounds, states, controls, after):  # type: ignore[no-untyped-def]  # pragma: no cover
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
def _follow(  # type: ignore[no-untyped-def]  # pragma: no cover
    memory, bounds, nominal_states, nominal_controls, gains, states, controls
):
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
def _execute(memory, bounds, network, noise, states, controls):  # type: ignore[no-untyped-def]  # pragma: no cover
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
def _differentiate(memory, columns, states, controls, eps, f_x, f_u):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Applies the chain rule over the simulator steps of one control."""
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
