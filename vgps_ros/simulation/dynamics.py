"""A MuJoCo model as discrete dynamics.

A control is held for a number of simulator steps:

    x_{t+1} = f(x_t, u_t),    x = (qpos, qvel),

with f_x, f_u from finite differences. The model must have as many positions as velocities (hinges
and slides only), so that states can be subtracted.
"""

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from functools import partial
from itertools import chain
from queue import SimpleQueue
from typing import Any, TypeVar

import mujoco
import numpy as np

from vgps_ros.core.compiled_network import compiled_network
from vgps_ros.core.dynamics import CONTROL_BOUND, DIVERGENCE_BOUND, ControlLaw
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, LinearDynamics, Trajectory
from vgps_ros.simulation import compiled_loops
from vgps_ros.simulation.compiled_loops import Memory, memory_of
from vgps_ros.simulation.warnings import warnings_of

# Parts of the work for each thread: a thread whose core others use too then does fewer of them.
_PARTS = 4
# A rollout whose states or controls leave these bounds has diverged.
_BOUNDS = (DIVERGENCE_BOUND, CONTROL_BOUND)

T = TypeVar("T")


class Dynamics:
    """x' = f(x, u) for a MuJoCo model, with rollouts and derivatives.

    Attributes:
        model: a copy of the model in which MuJoCo does not reset a state that it finds bad; here
            such a state counts as diverged.

    Args:
        model: the robot; positions and velocities must have the same dimension.
        substeps: simulator steps for which one control is held.
        eps: perturbation of the finite differences.
        threads: threads that share finite differences and rollouts; their number changes no result.
        cyclic_joints: names of joints on whose position nothing depends but that position itself,
            such as a slide along a level floor; no difference is taken along it.

    Raises:
        InvalidInputError: the model has quaternions or actuator states.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        substeps: int = 1,
        eps: float = 1e-7,
        threads: int | None = None,
        cyclic_joints: Sequence[str] = (),
    ):
        if model.nq != model.nv or model.na:
            raise InvalidInputError(
                f"The model has nq={model.nq}, nv={model.nv}, na={model.na}, but nq must equal nv "
                "and na must be 0: use hinge and slide joints and motors only."
            )
        self.model = model = copy(model)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.substeps = substeps
        self.eps = eps
        self.state_dim = 2 * model.nv
        self.control_dim = model.nu
        self.time_step = model.opt.timestep * substeps
        self.threads = threads or len(os.sched_getaffinity(0))
        self.cyclic_joints = tuple(cyclic_joints)
        cyclic = np.array([model.joint(name).qposadr[0] for name in cyclic_joints], dtype=int)
        n_x, n_v, n_u = self.state_dim, model.nv, model.nu
        positions = np.setdiff1d(np.arange(n_v), cyclic)
        self._columns = np.r_[n_x : n_x + n_u, n_v:n_x, positions]
        self._simulations = [mujoco.MjData(model) for _ in range(self.threads)]
        self._idle = SimpleQueue[Memory]()  # the simulations that no thread is using
        for data in self._simulations:
            self._idle.put(memory_of(model, data, substeps))
        self._pool = ThreadPoolExecutor(self.threads)  # it starts no thread before the first work

    def warnings(self) -> Counter[str]:
        """Returns how often MuJoCo has warned in these dynamics so far, by kind."""
        return warnings_of(self._simulations)

    def step(self, state: Array, control: Array) -> Array:
        """Returns f(x, u), shape (n_x,)."""
        after = np.empty((1, self.state_dim))
        pair = np.array(state[None], float), np.array(control[None], float)
        self._simulate(compiled_loops.advance, (np.inf, np.inf), *pair, after)
        return after[0]

    def rollouts(
        self, initial_states: Array, control_law: ControlLaw, horizon: int
    ) -> tuple[Array, Array, int]:
        """Runs several rollouts in closed loop, side by side.

        A rollout that diverges is NaN from the step after which it did.

        Args:
            initial_states: shape (N, n_x).
            control_law: maps t and the states (N, n_x) to controls (N, n_u), or to one for all.
            horizon: T.

        Returns:
            States, shape (N, T+1, n_x), controls, shape (N, T, n_u), and how many simulator steps
            they took.
        """
        n, executed = len(initial_states), 0
        states = np.full((horizon + 1, n, self.state_dim), np.nan)
        controls = np.full((horizon, n, self.control_dim), np.nan)
        states[0] = initial_states
        x = np.nan_to_num(states[0])  # the law sees zeros where a rollout has diverged
        for t in range(horizon):
            controls[t] = control_law(t, x)
            step = states[t], controls[t], states[t + 1]
            count, sound = self._simulate(compiled_loops.advance, _BOUNDS, *step)
            executed += count
            if not sound:
                break
            x = states[t + 1] if sound == n else np.nan_to_num(states[t + 1])
        states, controls = (np.ascontiguousarray(a.swapaxes(0, 1)) for a in (states, controls))
        return states, controls, executed * self.substeps

    def rollout(self, initial_state: Array, control_law: ControlLaw, horizon: int) -> Trajectory:
        """Runs one rollout; `control_law` still sees states of shape (1, n_x)."""
        states, controls, _ = self.rollouts(initial_state[None], control_law, horizon)
        return Trajectory(states[0], controls[0])

    def follow_each(
        self, start: Array, nominals: Sequence[Trajectory], gains: Array
    ) -> Iterator[Trajectory]:
        """Yields rollouts of u = ū + K (x − x̄), many times faster than under a Python law.

        As many run at once as there are threads. See `core.dynamics` for the arguments.
        """
        for first in range(0, len(nominals), self.threads):
            batch = nominals[first : first + self.threads]

            def work(
                memory: Memory, part: slice, batch: Sequence[Trajectory] = batch
            ) -> list[Trajectory]:
                found = []
                for nominal in batch[part]:
                    x, u = (np.full_like(a, np.nan) for a in (nominal.states, nominal.controls))
                    x[0] = start
                    given = nominal.states, nominal.controls, gains
                    compiled_loops.follow(memory, _BOUNDS, *given, x, u)
                    found.append(Trajectory(x, u))
                return found

            yield from chain.from_iterable(self._in_threads(len(batch), work))

    def execute(
        self, policy: GaussianPolicy, initial_states: Array, noise: Array
    ) -> tuple[Array, Array]:
        """Runs rollouts of u = μ_θ(x) + noise over several threads.

        A rollout that diverges is NaN from the step after which it did.

        Args:
            policy: π_θ.
            initial_states: shape (N, n_x).
            noise: shape (N, T, n_u), [N·m].

        Returns:
            States, shape (N, T+1, n_x), and controls, shape (N, T, n_u).

        Raises:
            InvalidInputError: the policy is one of another robot.
        """
        policy.check_fits(self.state_dim, self.control_dim)  # compiled loops check no index
        n, horizon, _ = noise.shape
        states = np.full((n, horizon + 1, self.state_dim), np.nan)
        controls = np.full((n, horizon, self.control_dim), np.nan)
        states[:, 0] = initial_states
        network = compiled_network(policy)
        self._in_threads(
            n,
            lambda memory, part: compiled_loops.execute(
                memory, _BOUNDS, network, noise[part], states[part], controls[part]
            ),
        )
        return states, controls

    def linearize(self, trajectory: Trajectory) -> tuple[LinearDynamics, int]:
        """Returns f_x, f_u along a trajectory, by finite differences, and their simulator steps."""
        horizon, n_x, n_u = trajectory.horizon, self.state_dim, self.control_dim
        f_x, f_u = np.empty((horizon, n_x, n_x)), np.empty((horizon, n_x, n_u))
        states, controls = trajectory.states[:-1], trajectory.controls
        steps = self._in_threads(
            horizon,
            lambda memory, part: compiled_loops.differentiate(
                memory, self._columns, self.eps, states[part], controls[part], f_x[part], f_u[part]
            ),
        )
        return LinearDynamics(f_x, f_u), sum(steps)

    def _in_threads(self, count: int, work: Callable[[Memory, slice], T]) -> list[T]:
        """Divides `count` pieces of work into parts; each thread takes the next part."""
        if min(self.threads, count) == 1:
            return [self._simulate(work, slice(0, count))]
        ends = np.linspace(0, count, min(count, _PARTS * self.threads) + 1).astype(int)
        parts = map(slice, ends[:-1], ends[1:])
        return list(self._pool.map(partial(self._simulate, work), parts))

    def _simulate(self, work: Callable[..., T], *arguments: Any) -> T:
        memory = self._idle.get()
        try:
            return work(memory, *arguments)
        finally:
            self._idle.put(memory)
