# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A MuJoCo model as discrete dynamics, with a simulation of it for each thread.

A control is held for a number of simulator steps:

    x_{t+1} = f(x_t, u_t),    x = (qpos, qvel, act),

with f_x, f_u on the tangent space (`core.dynamics`), in closed form or from finite differences.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from functools import partial
from itertools import chain
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar, cast

import mujoco
import numpy as np

from vgps_ros.core.cores import count_cores
from vgps_ros.core.dynamics import DIVERGENCE_BOUND, ControlLaw
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, ControlBounds, LinearDynamics, Trajectory
from vgps_ros.robot.controls import CONTROL_BOUND, ControlKind
from vgps_ros.robot.unrest import Unrest
from vgps_ros.simulation import compiled_derivatives, compiled_loops
from vgps_ros.simulation.compiled_closed_form import tangents
from vgps_ros.simulation.compiled_mechanism import mechanism_of
from vgps_ros.simulation.compiled_states import NO_PUSH, BodyPush, CompiledSimulation
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.forces import AppliedForce
from vgps_ros.simulation.model import (
    check_supported,
    control_range,
    cyclic_positions,
    damping_varies,
    state_space,
    step_structure,
)
from vgps_ros.simulation.warnings import warnings_of

if TYPE_CHECKING:
    from vgps_ros.simulation.readings import Readings

# Parts of the work for each thread: a thread whose core others use too then does fewer of them.
_PARTS = 4

T = TypeVar("T")

_others_use_the_cores = False


def use_one_thread() -> None:
    """Lets simulations of this process use one thread each, since others use the other cores."""
    global _others_use_the_cores  # noqa: PLW0603
    _others_use_the_cores = True


class Simulations:
    """A model with as many simulations of it as there are threads.

    Attributes:
        model: a copy of the model in which MuJoCo does not reset a state that it finds bad; here
            such a state counts as diverged.
        space: space of its states.
        threads: threads that share the work; their number changes no result.
        closed_forms: what derivatives in closed form need of each simulation, by its address.

    Args:
        model: the robot.
        substeps: simulator steps for which one control is held.
        threads: number of threads; None for as many as there are processors.

    Raises:
        InvalidInputError: a state of the model is more than (qpos, qvel, act).
    """

    def __init__(self, model: mujoco.MjModel, substeps: int = 1, threads: int | None = None):
        check_supported(model)
        self.model = model = copy(model)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.space = state_space(model)
        self.substeps = substeps
        cores = 1 if _others_use_the_cores else count_cores()
        self.threads = threads or cores
        self._push = NO_PUSH
        self._data = [mujoco.MjData(model) for _ in range(self.threads)]
        self._idle = SimpleQueue[CompiledSimulation]()  # those that no thread is using
        for data in self._data:
            self._idle.put(_compiled_simulation(model, data, substeps))
        sizes = model.nv, model.nbody, model.na, model.nu
        self.closed_forms = {
            data._address: (mechanism_of(model, data), tangents(*sizes)) for data in self._data
        }
        self._pool = ThreadPoolExecutor(self.threads)  # it starts no thread before the first work

    def pushed(self, push: BodyPush) -> "Simulations":
        """Returns the same simulations, which push the robot when they are used through it."""
        pushed = copy(self)
        pushed._push = push
        return pushed

    def warnings(self) -> Counter[str]:
        """Returns how often MuJoCo has warned in these simulations so far, by kind."""
        return warnings_of(self._data)

    def in_threads(
        self, count: int, work: Callable[[CompiledSimulation, slice], T], least: int = 1
    ) -> list[T]:
        """Divides `count` pieces of work into parts; each thread takes the next part.

        A part has `least` pieces, where they are so small that handing one over takes longer.
        """
        parts = min(max(count // least, 1), _PARTS * self.threads)
        if min(self.threads, parts) == 1:
            return [self.in_one(work, slice(0, count))]
        ends = np.linspace(0, count, parts + 1).astype(int)
        return list(self._pool.map(partial(self.in_one, work), map(slice, ends[:-1], ends[1:])))

    def in_one(self, work: Callable[..., T], *arguments: Any) -> T:
        """Does a piece of work in this thread."""
        simulation = self._idle.get()
        try:
            return work(simulation._replace(push=self._push), *arguments)
        finally:
            self._idle.put(simulation)


def _compiled_simulation(
    model: mujoco.MjModel, data: mujoco.MjData, substeps: int
) -> CompiledSimulation:
    """Returns the arrays of a simulation, and the addresses of its records, for the loops."""
    arrays = (
        *(data.qpos, data.qvel, data.act, data.ctrl, data.qacc_warmstart, data.sensordata),
        *control_range(model),
        *(data.qacc, data.qfrc_actuator),
    )
    rates = data.qDeriv, model.D_rownnz, model.D_rowadr, model.D_colind
    rest = substeps, step_structure(model), *rates, data.xfrc_applied, NO_PUSH
    return CompiledSimulation(model._address, data._address, *arrays, *rest)


_EPS = 1e-7  # perturbation of the finite differences
# Drag has a kink at zero velocity: differences are centred within so many perturbations of it.
KINK = 10.0
# A rollout whose states or controls leave these bounds has diverged.
_BOUNDS = (DIVERGENCE_BOUND, CONTROL_BOUND)
_WAY = 0.5  # way of a joint in a step, as a share of what brings its servo from 0 to its limit
_ANSWERING = 0.999  # share of a servo's greatest force up to which it answers to another target


class Dynamics:
    """x' = f(x, u) for a MuJoCo model, with rollouts and derivatives.

    Attributes:
        simulations: the model with a simulation for each thread.
        model: a copy of the model; see `Simulations`.
        space: space of the states.
        control_dim: n_u.
        controls: what its controls are.
        control_limits: see `core.dynamics`.
        time_step: time for which one control is held [s].

    Args:
        model: the robot.
        substeps: simulator steps for which one control is held.
        threads: threads that share finite differences and rollouts; their number changes no result.

    Raises:
        InvalidInputError: a state of the model is more than (qpos, qvel, act).
    """

    def __init__(self, model: mujoco.MjModel, substeps: int = 1, threads: int | None = None):
        self.simulations = Simulations(model, substeps, threads)
        self.model, self.space = self.simulations.model, self.simulations.space
        self.substeps = substeps
        self.control_dim = model.nu
        self.controls = controls_of(model)
        self.control_limits = self.controls.limits
        self.time_step = model.opt.timestep * substeps
        n_dx, n_v, n_u = 2 * model.nv + model.na, model.nv, model.nu
        positions = np.setdiff1d(np.arange(n_v), cyclic_positions(model))
        # Servos of positions whose force ends, and how the targets at which it does move with δ.
        c, at_once = self.controls, model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE
        rates = c.stiffness[:, None] * c.positions + c.damping[:, None] * c.velocities
        is_limited = c.servo_forces < CONTROL_BOUND
        holds = c.are(ControlKind.POSITION) & c.positions.any(axis=1)
        self._give_way = holds & is_limited & at_once
        self._servo_slopes = np.zeros((n_u, n_dx))
        in_x, in_dx = self.space.plain
        self._servo_slopes[:, in_dx] = rates[:, in_x] / c.strength[:, None]
        # Controls and activations, velocities, positions: see `compiled_derivatives.differentiate`.
        self._kink = KINK * _EPS if damping_varies(self.model) else 0.0
        self._columns = np.r_[n_dx : n_dx + n_u, 2 * n_v : n_dx, n_v : 2 * n_v, positions]

    @property
    def state_dim(self) -> int:
        """n_x."""
        return self.space.state_dim

    def pushed(self, push: BodyPush) -> "Dynamics":
        """Returns these dynamics under a push, by which f depends on the step too, as f_t."""
        pushed = copy(self)
        pushed.simulations = self.simulations.pushed(push)
        return pushed

    def warnings(self) -> Counter[str]:
        """Returns how often MuJoCo has warned in these dynamics so far, by kind."""
        return self.simulations.warnings()

    def bounds_along(self, states: Array) -> ControlBounds:
        """Returns the controls that act in each of T steps from states (T+1, n_x).

        A servo at its greatest force does not answer to a target that is farther away, in the first
        of a control's simulator steps. So targets end a little before that, where a finite
        difference still finds an answer; this bound moves with the joint. Within the control the
        joint moves on, and a farther target would keep up the force that falls meanwhile. That is
        given up, since trainings were worse with it. A servo so stiff that one control takes it
        through much of the range in which it answers keeps the limits of the model in that control.
        """
        controls, (low, high) = self.controls, self.control_limits
        if not self._give_way.any():
            shape = (len(states) - 1, self.control_dim)
            return ControlBounds(np.broadcast_to(low, shape), np.broadcast_to(high, shape))
        forces = np.where(self._give_way, _ANSWERING * controls.servo_forces, controls.largest)
        ends = np.stack(controls.bounds(states[:-1], forces))
        way = np.abs(np.diff(states @ controls.positions.T, axis=0))
        is_slow = controls.stiffness * way < _WAY * controls.servo_forces
        ends = np.where(self._give_way & is_slow, ends, np.array([low, high])[:, None])
        is_moving = self._give_way & is_slow & (ends > low) & (ends < high)
        slopes = np.where(is_moving[..., None], self._servo_slopes, 0.0)
        return ControlBounds(ends[0], ends[1], slopes)

    def step(self, state: Array, control: Array, applied: AppliedForce | None = None) -> Array:
        """Returns f(x, u) without the dynamics' own push, shape (n_x,).

        Args:
            state: x, shape (n_x,).
            control: u, shape (n_u,).
            applied: what acts on a body meanwhile.
        """
        after = np.empty((1, self.state_dim))
        pair = np.array(state[None], float), np.array(control[None], float)
        never = np.array([-1])

        def work(sim: CompiledSimulation) -> None:
            if applied:
                sim.applied[applied.body] = applied.wrench
            compiled_loops.advance(sim, (np.inf, np.inf), never, *pair, after)
            sim.applied[:] = 0.0

        self.simulations.in_one(work)
        return after[0]

    def rollouts(
        self, initial_states: Array, control_law: ControlLaw, horizon: int
    ) -> tuple[Array, Array, int]:
        """Runs several rollouts in closed loop, side by side, with controls within their limits.

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
            step = np.full(n, t), states[t], controls[t], states[t + 1]
            count, sound = self.simulations.in_one(compiled_loops.advance, _BOUNDS, *step)
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
        self,
        start: Array,
        nominals: Sequence[Trajectory],
        gains: Array,
        gaps: Sequence[Array | None] | None = None,
    ) -> Iterator[Trajectory]:
        """Yields rollouts of u = ū + K (x ⊖ x̄), many times faster than under a Python law.

        As many run at once as there are threads. See `core.dynamics` for the arguments.
        """
        threads = self.simulations.threads
        pairs = list(zip(nominals, gaps or [None] * len(nominals), strict=True))
        none = np.empty((0, self.space.tangent_dim))
        for first in range(0, len(pairs), threads):
            batch = pairs[first : first + threads]

            def work(
                sim: CompiledSimulation,
                part: slice,
                batch: Sequence[tuple[Trajectory, Array | None]] = batch,
            ) -> list[Trajectory]:
                """Follows a part of the batch."""
                found = []
                for nominal, gap in batch[part]:
                    x, u = (np.full_like(a, np.nan) for a in (nominal.states, nominal.controls))
                    x[0] = start
                    short = none if gap is None else gap
                    given = nominal.states, nominal.controls, gains, short
                    compiled_loops.follow(sim, _BOUNDS, *given, x, u)
                    found.append(Trajectory(x, u))
                return found

            yield from chain.from_iterable(self.simulations.in_threads(len(batch), work))

    def replay(self, start: Array, controls: Array) -> Array:
        """Runs rollouts of given controls from one state over several threads.

        Args:
            start: x_1, shape (n_x,).
            controls: shape (N, T, n_u).

        Returns:
            States, shape (N, T+1, n_x); NaN from the step after which a rollout has diverged.
        """
        states = np.full((len(controls), controls.shape[1] + 1, self.state_dim), np.nan)
        states[:, 0] = start
        controls = np.ascontiguousarray(controls)
        self.simulations.in_threads(
            len(controls),
            lambda sim, part: compiled_loops.replay(sim, _BOUNDS, controls[part], states[part]),
        )
        return states

    def gaps(self, trajectory: Trajectory) -> Array:
        """Returns f(x̄_t, ū_t) ⊖ x̄_{t+1}, shape (T, n_dx), NaN where f diverges.

        A trajectory that was executed has none but rounding's; a guess of states has some.
        """
        states, controls = trajectory.states[:-1].copy(), trajectory.controls.copy()
        after = np.empty_like(states)
        step = np.arange(len(states)), states, controls, after
        self.simulations.in_one(compiled_loops.advance, _BOUNDS, *step)
        return self.space.subtract(after, trajectory.states[1:])

    def execute(
        self,
        policy: GaussianPolicy,
        observation: Observation,
        initial_states: Array,
        noise: Array,
        *,
        lag: int = 0,
        sensor_noise: Array | None = None,
        unrest: Unrest | None = None,
        calm: Array | None = None,
    ) -> tuple[Array, Array]:
        """Runs rollouts of u = μ_θ(o) + noise, within the limits, over several threads.

        A rollout that diverges is NaN from the step after which it did.

        Args:
            policy: π_θ.
            observation: o, what the policy reads, of this model; its context may differ by rollout,
                (N, T, n_z).
            initial_states: shape (N, n_x).
            noise: of the controls, shape (N, T, n_u), [N·m].
            lag: steps by which the policy reads the state too late.
            sensor_noise: what is added to each reading of the state, shape (N, T, r).
            unrest: when the robot is restless; None: it always is.
            calm: the context of each step while it is not, (N, T, n_z).

        Returns:
            States, shape (N, T+1, n_x), and controls, shape (N, T, n_u).

        Raises:
            InvalidInputError: the policy is one of another robot.
        """
        policy.check_fits(observation.names, self.control_dim)  # compiled loops check no index
        n, horizon, _ = noise.shape
        states = np.full((n, horizon + 1, self.state_dim), np.nan)
        controls = np.full((n, horizon, self.control_dim), np.nan)
        states[:, 0] = initial_states
        readings = cast("Readings", observation.readings)
        network, plan = compiled_loops.compiled_network(policy), readings.plan
        told = observation.values_told()[..., :horizon, :] if observation.told else np.empty((1, 0))
        told = np.ascontiguousarray(np.broadcast_to(told, (n, horizon, told.shape[-1])))
        felt, at_rest = (0, 0, np.zeros(3), np.zeros(3), 0), told
        if unrest and calm is not None:
            felt = unrest.rotation, unrest.rate, unrest.up, unrest.vertical, unrest.steps
            at_rest = np.ascontiguousarray(observation.within(calm).values_told()[:, :horizon])
        misread = np.empty((n, horizon, 0)) if sensor_noise is None else sensor_noise
        past = observation.past
        history, resting = (past.history, past.resting) if past else (0, np.empty(0))
        resting = resting if past and past.actions else np.empty(0)
        self.simulations.in_threads(
            n,
            lambda sim, part: compiled_loops.execute(
                *(sim, _BOUNDS, network, plan, history, resting, felt, lag, misread[part]),
                *(told[part], at_rest[part], noise[part], states[part], controls[part]),
            ),
        )
        return states, controls

    def linearize(
        self, trajectory: Trajectory, *, centred: bool = False
    ) -> tuple[LinearDynamics, int]:
        """Returns f_x, f_u along a trajectory, and their simulator steps.

        Steps without a closed form take finite differences, of which few are centred, where it
        matters. All steps take differences, all of them centred, if that is asked for.
        """
        horizon, n_x, n_u = trajectory.horizon, self.space.tangent_dim, self.control_dim
        f_x, f_u = np.empty((horizon, n_x, n_x)), np.empty((horizon, n_x, n_u))
        states, controls = trajectory.states[:-1], trajectory.controls
        kink = np.inf if centred else self._kink

        def differentiate(sim: CompiledSimulation, part: slice) -> int:
            """Writes the derivatives of some steps, and returns their simulator steps."""
            steps: int = compiled_derivatives.differentiate(
                *(sim, *self.simulations.closed_forms[sim.data]),
                *(self._columns, _EPS, kink, part.start),
                *(states[part], controls[part], f_x[part], f_u[part]),
            )
            return steps

        return LinearDynamics(f_x, f_u), sum(self.simulations.in_threads(horizon, differentiate))
