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
from vgps_ros.core.dynamics import ControlLaw
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, LinearDynamics, Trajectory
from vgps_ros.simulation.compiled_loops import Simulator
from vgps_ros.simulation.warnings import warnings_of

# Parts of the work for each thread: a thread whose core others use too then does fewer of them.
_PARTS = 4

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
        self._simulators = [Simulator(model, substeps, cyclic) for _ in range(self.threads)]
        self._idle = SimpleQueue[Simulator]()  # the simulators that no thread is using
        for simulator in self._simulators:
            self._idle.put(simulator)
        self._pool = ThreadPoolExecutor(self.threads)  # it starts no thread before the first work

    def warnings(self) -> Counter[str]:
        """Returns how often MuJoCo has warned in these dynamics so far, by kind."""
        return warnings_of(simulator.data for simulator in self._simulators)

    def step(self, state: Array, control: Array) -> Array:
        """Returns f(x, u), shape (n_x,)."""
        after = np.empty((1, self.state_dim))
        pair = np.array(state[None], float), np.array(control[None], float)
        self._with_simulator(Simulator.advance, *pair, after, (np.inf, np.inf))
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
            count, sound = self._with_simulator(
                Simulator.advance, states[t], controls[t], states[t + 1]
            )
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

    def follow(self, start: Array, nominal: Trajectory, gains: Array) -> Trajectory:
        """Runs one rollout of u = ū + K (x − x̄), many times faster than under a Python law.

        Args:
            start: x_1, shape (n_x,).
            nominal: x̄, ū.
            gains: K, shape (T, n_u, n_x).
        """
        return next(self.follow_each(start, [nominal], gains))

    def follow_each(
        self, start: Array, nominals: Sequence[Trajectory], gains: Array
    ) -> Iterator[Trajectory]:
        """Does the same for several nominal trajectories, as many at once as there are threads."""
        for first in range(0, len(nominals), self.threads):
            batch = nominals[first : first + self.threads]

            def work(
                simulator: Simulator, part: slice, batch: Sequence[Trajectory] = batch
            ) -> list[Trajectory]:
                return [simulator.follow(start, nominal, gains) for nominal in batch[part]]

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
            n, lambda s, part: s.execute(network, noise[part], states[part], controls[part])
        )
        return states, controls

    def linearize(self, trajectory: Trajectory) -> tuple[LinearDynamics, int]:
        """Returns f_x, f_u along a trajectory, by finite differences, and their simulator steps."""
        horizon, n_x, n_u = trajectory.horizon, self.state_dim, self.control_dim
        f_x, f_u = np.empty((horizon, n_x, n_x)), np.empty((horizon, n_x, n_u))
        states, controls = trajectory.states[:-1], trajectory.controls
        steps = self._in_threads(
            horizon,
            lambda simulator, part: simulator.differentiate(
                states[part], controls[part], self.eps, f_x[part], f_u[part]
            ),
        )
        return LinearDynamics(f_x, f_u), sum(steps)

    def _in_threads(self, count: int, work: Callable[[Simulator, slice], T]) -> list[T]:
        """Divides `count` pieces of work into parts; each thread takes the next part."""
        if min(self.threads, count) == 1:
            return [self._with_simulator(work, slice(0, count))]
        ends = np.linspace(0, count, min(count, _PARTS * self.threads) + 1).astype(int)
        parts = map(slice, ends[:-1], ends[1:])
        return list(self._pool.map(partial(self._with_simulator, work), parts))

    def _with_simulator(self, work: Callable[..., T], *arguments: Any) -> T:
        simulator = self._idle.get()
        try:
            return work(simulator, *arguments)
        finally:
            self._idle.put(simulator)
