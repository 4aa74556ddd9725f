"""A MuJoCo model as discrete dynamics.

A control is held for a number of simulator steps:

    x_{t+1} = f(x_t, u_t),    x = (qpos, qvel),

with f_x, f_u from centred finite differences. The model must have as many positions as velocities
(hinges and slides only), so that states can be subtracted.
"""

import os
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
from mujoco.rollout import Rollout
from numpy.typing import NDArray

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, LinearDynamics, Trajectory
from vgps_ros.core.simulator_warnings import simulator_warnings

# A state beyond this magnitude has diverged: neither metres nor radians per second get there.
DIVERGENCE_BOUND = 1e4
# MuJoCo replaces a control beyond 1e10 by zero, and so would hide that it diverged [N·m].
CONTROL_BOUND = 1e9
_FULL_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS

ControlLaw = Callable[[int, Array], Array]
"""Maps the step t and states (N, n_x) to controls (N, n_u), [N·m]."""


class Dynamics:
    """x' = f(x, u) for a MuJoCo model, with rollouts and derivatives.

    Attributes:
        simulator_steps: simulator steps done so far, those of finite differences included.
        threads: threads that share the finite differences.

    Args:
        model: the robot; positions and velocities must have the same dimension.
        substeps: simulator steps for which one control is held.
        eps: perturbation of the centred differences.
        threads: threads that share the differences; their number does not change the result.

    Raises:
        InvalidInputError: the model has quaternions or actuator states.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        substeps: int = 1,
        eps: float = 1e-6,
        threads: int | None = None,
    ):
        if model.nq != model.nv or model.na:
            raise InvalidInputError(
                f"The model has nq={model.nq}, nv={model.nv}, na={model.na}, but nq must equal nv "
                "and na must be 0: use hinge and slide joints and motors only."
            )
        # MuJoCo would silently reset a state that it finds bad; here it counts as diverged.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.model = model
        self.substeps = substeps
        self.eps = eps
        self.state_dim = 2 * model.nv
        self.control_dim = model.nu
        self.time_step = model.opt.timestep * substeps
        self.threads = threads or len(os.sched_getaffinity(0))
        self.simulator_steps = 0
        self._data = mujoco.MjData(model)
        self._stepper = Rollout(nthread=0)

    @property
    def warnings(self) -> Counter[str]:
        """How often MuJoCo warned so far in this process, by kind."""
        return simulator_warnings()

    def step(self, state: Array, control: Array) -> Array:
        """Returns f(x, u), shape (n_x,)."""
        return self._steps(state[None], control[None])[0]

    def rollouts(
        self, initial_states: Array, control_law: ControlLaw, horizon: int
    ) -> tuple[Array, Array]:
        """Runs several rollouts in closed loop, side by side.

        A rollout that diverges is NaN from the step after which it did.

        Args:
            initial_states: shape (N, n_x).
            control_law: maps t and the states (N, n_x) to controls (N, n_u).
            horizon: T.

        Returns:
            States, shape (N, T+1, n_x), and controls, shape (N, T, n_u).
        """
        n = len(initial_states)
        states = np.full((n, horizon + 1, self.state_dim), np.nan)
        controls = np.full((n, horizon, self.control_dim), np.nan)
        states[:, 0] = initial_states
        alive = np.flatnonzero(_is_sound(initial_states, DIVERGENCE_BOUND))
        for t in range(horizon):
            # The law sees zeros where a rollout has diverged; one control may serve all.
            control = np.broadcast_to(
                control_law(t, np.nan_to_num(states[:, t])), controls[:, t].shape
            )
            controls[alive, t] = control[alive]
            alive = alive[_is_sound(control[alive], CONTROL_BOUND)]
            if not len(alive):
                break
            states[alive, t + 1] = self._steps(states[alive, t], controls[alive, t])
            sound = _is_sound(states[alive, t + 1], DIVERGENCE_BOUND)
            states[alive[~sound], t + 1] = np.nan
            alive = alive[sound]
        return states, controls

    def rollout(self, initial_state: Array, control_law: ControlLaw, horizon: int) -> Trajectory:
        """Runs one rollout; `control_law` still sees states of shape (1, n_x)."""
        states, controls = self.rollouts(initial_state[None], control_law, horizon)
        return Trajectory(states[0], controls[0])

    def linearize(self, trajectory: Trajectory) -> LinearDynamics:
        """Returns f_x, f_u along a trajectory, by centred differences over several threads."""
        horizon = trajectory.horizon
        f_x = np.empty((horizon, self.state_dim, self.state_dim))
        f_u = np.empty((horizon, self.state_dim, self.control_dim))

        def linearize_steps(steps: range) -> None:
            data = mujoco.MjData(self.model)
            for t in steps:
                f_x[t], f_u[t] = self._linearize_step(
                    data, trajectory.states[t], trajectory.controls[t]
                )

        chunks = [range(i, horizon, self.threads) for i in range(self.threads)]
        with ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(linearize_steps, chunks))
        # A point and two neighbours of it along each coordinate of state and control.
        points = 2 * (self.state_dim + self.control_dim) + 1
        self.simulator_steps += horizon * self.substeps * points
        return LinearDynamics(f_x, f_u)

    def _linearize_step(
        self, data: mujoco.MjData, state: Array, control: Array
    ) -> tuple[Array, Array]:
        """Returns f_x, f_u at one point: the chain rule over the simulator steps of one control."""
        self._load(data, state, control)
        f_x = np.eye(self.state_dim)
        f_u = np.zeros((self.state_dim, self.control_dim))
        a, b = np.empty_like(f_x), np.empty_like(f_u)
        for substep in range(self.substeps):
            if substep:
                mujoco.mj_step(self.model, data)
            mujoco.mjd_transitionFD(self.model, data, self.eps, True, a, b, None, None)
            f_x, f_u = a @ f_x, a @ f_u + b
        return f_x, f_u

    def _steps(self, states: Array, controls: Array) -> Array:
        """Returns f(x, u) of each pair, shape (N, n_x); nothing carries over from one to another.

        MuJoCo's loop over them is faster than Python's, for a single one too.
        """
        n, end = len(states), 1 + self.state_dim
        before = np.zeros((n, mujoco.mj_stateSize(self.model, _FULL_STATE)))
        before[:, 1:end] = states  # the simulator's time comes first
        held = np.empty((n, self.substeps, self.control_dim))
        held[:] = controls[:, None]
        after = np.empty((n, self.substeps, before.shape[1]))
        self._stepper.rollout(
            [self.model] * n, [self._data], before, held,
            state=after, nstep=self.substeps, skip_checks=True,
        )  # fmt: skip
        self.simulator_steps += n * self.substeps
        return after[:, -1, 1:end]

    def _load(self, data: mujoco.MjData, state: Array, control: Array) -> None:
        """Puts state and control into `data`, and nothing of what was there before counts."""
        data.qpos[:] = state[: self.model.nv]
        data.qvel[:] = state[self.model.nv :]
        data.ctrl[:] = control
        data.qacc_warmstart[:] = 0.0


def _is_sound(rows: Array, bound: float) -> NDArray[np.bool_]:
    """Whether each row of (N, n) is inside the bound; NaN is not."""
    return np.logical_and.reduce(np.abs(rows) < bound, axis=1)
