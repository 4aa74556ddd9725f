# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Model predictive control: plans over a receding horizon, and feedback along the newest plan.

A plan is a short motion from a state of the robot, improved by an iteration of DDP. Between two
plans the robot follows

    u = ū_t + K_t (x ⊖ x̄_t),

so that a plan which comes late is made up for by its gains. The next plan improves the cheapest of
some motions on the true dynamics from the new state: the old plan, followed with its gains and
continued by the tail; another motion with gains, where one is known; and the tail alone, which
brings back a robot that the plan has lost. The tail is the learned policy's motion; where there is
no policy, that of the task's first solution, whose cost to go a plan's last state then has, too
(`search.plan_end`); and where neither fits, that of controls at rest: motors without torque, servos
that hold their place.

`PlanFollower` answers states with feedback along the newest plan, and `AdjustableCost` has the
targets and weights that may be changed while plans are made.
"""

import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Event
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.cost import FeatureCost, TrajectoryCost
from vgps_ros.core.ddp.solve import Status, improve, solve
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.settings import Range
from vgps_ros.search.optimization_request import first_request, initial_motion
from vgps_ros.search.plan_end import PlanEnd
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class MpcSettings:
    """Settings of the plans."""

    horizon: Annotated[float, Range(1e-3, 1e3), "length of a plan [s]"] = 0.5
    first_iterations: Annotated[
        int,
        Range(1, 10_000),
        "largest number of DDP iterations of the first plan, which is made at start, from the "
        "task's initial state; the later ones have one each",
    ] = 50
    ddp: DdpSettings = field(default_factory=DdpSettings)
    policy_weight: Annotated[
        float,
        Range(0.0, 1e6),
        "weight w of the learned policy, where there is one, in the cost of a plan, "
        "c - w log pi_theta: it keeps a plan away from what only its end makes cheap; 0: the "
        "policy only continues plans",
    ] = 0.1
    end_weight: Annotated[
        float,
        Range(0.0, 1e6),
        "weight of what comes after a plan's end by the task's first solution, which is then found "
        "at start; 0: nothing comes after it. It counts where there is no policy, in tasks without "
        "commands whose cost does not change with time and whose robot has no free base",
    ] = 1.0
    plan_age_limit: Annotated[
        float,
        Range(1e-3, 1e3),
        "age beyond which a plan must not drive any more; the horizon limits it too [s]",
    ] = 0.4


@dataclass(frozen=True)
class Plan:
    """A motion with feedback around it.

    Attributes:
        start: control step at which it begins.
        trajectory: x̄, ū.
        gains: K, shape (T, n_u, n_dx).
        cost: Σ of the cost that was minimised, over the plan.
        status: the reason why its solve ended.
    """

    start: int
    trajectory: Trajectory
    gains: Array
    cost: float
    status: Status


class Planner:
    """Makes the plans of one task.

    Attributes:
        steps: T, the number of steps of a plan.
        age_limit: largest age of a plan that may drive, in steps.
        cost: the cost that the next plans minimise; the task's own at first.

    Args:
        task: the control problem.
        settings: settings of the plans.

    Raises:
        InvalidInputError: the horizon is shorter than a control period, or longer than the task's.
    """

    def __init__(self, task: Task, settings: MpcSettings):
        period, longest = task.dynamics.time_step, task.planned_horizon
        self.steps = round(settings.horizon / period)
        if not 1 <= self.steps <= longest:
            raise InvalidInputError(
                f"horizon is {settings.horizon:g} s, but a plan of the {task.name} must have "
                f"{period:g} to {longest * period:g} s."
            )
        self.age_limit = min(self.steps - 1, round(settings.plan_age_limit / period))
        self._settings = settings
        self._at_rest = task.signals.constant_context(task.signals.rest, self.steps)
        self._task = task.commanded(task.signals.rest)
        self.cost = task.cost
        # The first solution turns with no heading, follows no command, and knows no time.
        turns_or_is_told = bool(task.signals.names or task.dynamics.space.quaternions)
        is_alike = not turns_or_is_told and bool(_constant(task.cost).all())
        self._is_continued = settings.end_weight > 0.0 and is_alike
        self._end: PlanEnd | None = None

    def first_plan(self, seed: int = 0) -> Plan:
        """Returns the plan from the task's initial state, which begins at step 0.

        Its solve starts from the motion from which a search of the task starts too.

        Raises:
            DivergenceError: that motion diverges, or its solve ends where Quu is indefinite.
        """
        settings, task = self._settings, self._task
        request = first_request(task, seed, settings.first_iterations)
        if not self._is_continued:
            task = replace(task, horizon=self.steps, lookahead=0)
        begun = initial_motion(task, request)
        cost, iterations = self._cost(0, None, task.planned_context), settings.first_iterations
        found = solve(
            *(task.dynamics, cost, begun.trajectory, settings.ddp, iterations), gaps=begun.gaps
        )
        if self._is_continued:
            self._end = PlanEnd(task, found, settings.end_weight)
        plan, gains = found.trajectory.first(self.steps), found.policy.gains[: self.steps]
        return Plan(0, plan, gains, float(cost.values(plan).sum()), found.status)

    def next_plan(
        self,
        plan: Plan,
        state: Array,
        step: int,
        policy: GaussianPolicy | None = None,
        is_cancelled: Callable[[], bool] = lambda: False,
        known: Sequence[Plan] = (),
        context: Array | None = None,
    ) -> Plan:
        """Returns a plan from a newer state, warm-started by an older plan.

        Args:
            plan: the older plan, which may be longer than the new one.
            state: x, shape (n_x,).
            step: control step of the state, not before the plan's start.
            policy: π_θ, which continues the plan.
            is_cancelled: asked between the parts of the iteration; true ends it.
            known: other plans, of any length, that may be better to begin with.
            context: commands and clock over the plan, shape (T, n_z); None: commands at rest.

        Raises:
            InvalidInputError: the state is from before the plan.
            DivergenceError: all motions that may be improved diverge, or Quu is indefinite around
                the cheapest one.
        """
        if step < plan.start:
            raise InvalidInputError(
                f"The state is of control step {step}, but it must not be from before the plan, "
                f"which begins at step {plan.start}."
            )
        context = self._at_rest if context is None else context
        cost = self._cost(step, policy, context)
        motions = [self._continued(old, state, step, policy, context) for old in (plan, *known)]
        motions.append(self._tail(state, policy, context))
        costs = [self._with_end(cost, motion, policy) for motion in motions]
        sums = [float(np.sum(c.values(m))) for c, m in zip(costs, motions, strict=True)]
        # A motion that diverges costs NaN.
        best = int(np.argmin(np.nan_to_num(sums, nan=np.inf)))
        dynamics, ddp = self._task.dynamics, self._settings.ddp
        found = improve(dynamics, costs[best], motions[best], ddp, is_cancelled)
        return Plan(step, found.trajectory, found.gains, found.cost, found.status)

    def control(self, plan: Plan, state: Array, step: int) -> Array:
        """Returns u = ū + K (x ⊖ x̄), within the robot's limits, shape (n_u,), [N·m].

        The control step must be one of the plan.
        """
        t, dynamics = step - plan.start, self._task.dynamics
        deviation = dynamics.space.subtract(state, plan.trajectory.states[t])
        control = plan.trajectory.controls[t] + plan.gains[t] @ deviation
        return np.clip(control, *dynamics.control_limits)

    def _continued(
        self, plan: Plan, state: Array, step: int, policy: GaussianPolicy | None, context: Array
    ) -> Trajectory:
        """Returns the old plan's motion from the state, continued by the tail."""
        passed = min(step - plan.start, len(plan.gains))
        end = passed + self.steps
        x, u = plan.trajectory.states[passed : end + 1], plan.trajectory.controls[passed:end]
        gains = np.ascontiguousarray(plan.gains[passed:end])
        nominal = Trajectory(np.ascontiguousarray(x), np.ascontiguousarray(u))
        (kept,) = self._task.dynamics.follow_each(state, [nominal], gains)
        tail = self._tail(kept.states[-1], policy, context[len(u) :])
        return Trajectory(
            np.concatenate([kept.states, tail.states[1:]]),
            np.concatenate([kept.controls, tail.controls]),
        )

    def _tail(self, state: Array, policy: GaussianPolicy | None, context: Array) -> Trajectory:
        """Returns the motion of the tail from a state, over a context."""
        task, dynamics = self._task, self._task.dynamics
        if policy is None and self._end:
            return self._end.motion(state, len(context))
        if policy is None:
            controls = np.tile(task.controls.resting(state), (1, len(context), 1))
            states = dynamics.replay(state, controls)
        else:
            noise = np.zeros((1, len(context), dynamics.control_dim))
            observation = task.observation.within(context)
            states, controls = dynamics.execute(policy, observation, state[None], noise)
        return Trajectory(states[0], controls[0])

    def _with_end(
        self, cost: TrajectoryCost, motion: Trajectory, policy: GaussianPolicy | None
    ) -> TrajectoryCost:
        """Returns a plan's cost, what comes after a motion's end included."""
        if policy or not self._end:
            return cost
        return self._end.added(cost, self.cost, motion)

    def _cost(self, step: int, policy: GaussianPolicy | None, context: Array) -> TrajectoryCost:
        """Returns the cost of a plan that begins at a control step, in its context."""
        task, weight = self._task, self._settings.policy_weight
        cost = replace(self.cost, following=None, context=None).starting_at(step, len(context))
        cost = replace(cost, following=self.cost.following).in_context(context)
        if policy is None or not weight:
            return cost
        n_dx, n_u = task.dims["n_dx"], task.dims["n_u"]
        deviations, gains = np.zeros((1, self.steps, n_dx)), np.zeros((self.steps, n_u, n_dx))
        scaled = ScaledCost(cost, 1.0 / weight)
        observation = task.observation.within(context)
        return ScaledCost(PolicyCost(scaled, policy, observation, deviations, gains), weight)


class PlanFollower:
    """Answers states with feedback along the newest plan, and makes the next one.

    A thread makes the plans. Its compiled loops and MuJoCo run without Python's lock, so an answer
    hardly waits for them. The first plan, begun anew, is the warm start where the newest plan is
    too old to drive.

    Args:
        planner: makes the plans; its task's dynamics must not be used by anybody else meanwhile.
        every: 0: plans are made one after another, each from the newest state; n: a plan is made
            from each n-th state, whose answer waits for it, so that a run repeats bit for bit.
        seed: seed of the first plan.
        on_plan: called with each new plan and the time that it took [s].

    Attributes:
        trouble: the reason why the latest solve found no plan, or None.

    Raises:
        DivergenceError: there is no first plan.
    """

    def __init__(
        self,
        planner: Planner,
        every: int,
        seed: int = 0,
        on_plan: Callable[[Plan, float], None] = lambda *_: None,
    ):
        self.trouble: str | None = None
        self._planner, self._every, self._on_plan = planner, every, on_plan
        self._worker = ThreadPoolExecutor(1, "plan")
        self._ending = Event()
        self._work: list[Future[tuple[Plan, float] | None]] = []  # plans under way, or to be begun
        self._newest: tuple[Array, int, GaussianPolicy | None, Array | None] | None = None
        self._used: object = None  # the newest state, as the last plan was begun
        self._plan = self._first = self._worker.submit(planner.first_plan, seed).result()
        self._made = [self._first]  # the newest plan of this time, taken or not
        self._step = sys.maxsize  # of the last state

    def stop(self) -> None:
        """Ends what is being planned."""
        self._ending.set()
        self._worker.shutdown(cancel_futures=True)

    def control(
        self,
        state: Array,
        step: int,
        policy: GaussianPolicy | None = None,
        context: Array | None = None,
    ) -> tuple[Array, int]:
        """Returns the control in a state, shape (n_u,), and the age of their plan in steps.

        Args:
            state: x, shape (n_x,).
            step: control step of the state; one before that of the last state starts a new time.
            policy: π_θ, which continues plans.
            context: commands and clock from this state on, shape (T, n_z); None: at rest.

        Raises:
            InvalidInputError: the newest plan is too old to drive.
        """
        is_new_time = step < self._step
        self._step = step
        if is_new_time:
            # What is being planned is of the old time, and will not be taken.
            self._plan, self._work = replace(self._first, start=step), []
            self._made = [self._plan]
        self._newest = state, step, policy, context
        if not self._every:
            while self._work and self._work[0].done():
                self._take_plan()
            while len(self._work) < 2:  # so that one begins as soon as another ends
                self._begin()
        elif is_new_time or step - self._plan.start >= self._every:
            self._begin()
            self._take_plan()
        age = step - self._plan.start
        if age > self._planner.age_limit:
            raise InvalidInputError(
                f"the newest plan is {age} steps old, but a plan may drive for "
                f"{self._planner.age_limit} steps only; "
                + (self.trouble or "choose a shorter horizon.")
            )
        return self._planner.control(self._plan, state, step), age

    def _begin(self) -> None:
        made = self._made

        def solve() -> tuple[Plan, float] | None:
            newest = self._newest
            if not newest or newest is self._used:
                return None
            began, self._used, (state, step, policy, context) = time.perf_counter(), newest, newest
            is_over = step - made[0].start > self._planner.age_limit
            old = replace(self._first, start=step) if is_over else made[0]
            cancelled = self._ending.is_set
            plan = self._planner.next_plan(old, state, step, policy, cancelled, context=context)
            made[0] = plan
            return plan, time.perf_counter() - began

        self._work.append(self._worker.submit(solve))

    def _take_plan(self) -> None:
        """Makes the plan that was begun first the newest; one that is under way is waited for."""
        try:
            found = self._work.pop(0).result()
        except VgpsError as error:
            self.trouble = f"no plan was found: {error}"
        else:
            if found:
                self._plan, self.trouble = found[0], None
                self._on_plan(*found)


LARGEST_ADJUSTMENT = 1e6  # of a target, in its unit, and of a weight


@dataclass(frozen=True)
class AdjustableCost:
    """A task's cost, of which those readings can be changed whose target and weight are constant.

    A reference that changes with time, what follows a command or the clock, and what counts at the
    end of the horizon alone stay.

    Attributes:
        names: names of these readings.
        targets: their targets, shape (m,), in the units of the readings.
        weights: their weights, shape (m,).
    """

    names: tuple[str, ...]
    targets: Array
    weights: Array
    _cost: FeatureCost
    _columns: NDArray[np.intp]

    def __call__(self, targets: Sequence[float], weights: Sequence[float]) -> FeatureCost:
        """Returns the task's cost with other targets and weights.

        Raises:
            InvalidInputError: there is not one value for each reading.
        """
        cost, found = self._cost, {}
        for key, values in (("targets", targets), ("weights", weights)):
            self.check_count(values)
            found[key] = getattr(cost, key).copy()
            found[key][..., self._columns] = values
        return replace(cost, **found)

    def check_count(self, values: Sequence[float]) -> None:
        """Checks that there is one value for each reading.

        Raises:
            InvalidInputError: there is not.
        """
        if len(values) != len(self.names):
            raise InvalidInputError(
                f"{len(values)} values are given, but the cost has {len(self.names)} readings that "
                f"can be changed: {', '.join(self.names)}."
            )


def adjustable(cost: FeatureCost) -> AdjustableCost:
    """Returns what of a cost can be changed; nothing of one whose readings have no names."""
    names = cost.features.names if isinstance(cost.features, Readings) else ()
    follows = cost.following.follows if cost.following else np.zeros(len(names), bool)
    targets, weights = (np.atleast_2d(values) for values in (cost.targets, cost.weights))
    constant = np.flatnonzero(_constant(cost) & ~follows) if names else np.empty(0, np.intp)
    return AdjustableCost(
        names=tuple(names[i] for i in constant),
        targets=targets[0, constant],
        weights=weights[0, constant],
        _cost=cost,
        _columns=constant,
    )


def _constant(cost: FeatureCost) -> NDArray[np.bool_]:
    """Tells of each reading whether its target and weight do not change with time, (m,)."""
    both = (np.atleast_2d(values) for values in (cost.targets, cost.weights))
    return np.logical_and(*((values == values[0]).all(axis=0) for values in both))
