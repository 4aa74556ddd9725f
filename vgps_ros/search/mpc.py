# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Model predictive control: plans over a receding horizon, and feedback along the newest plan.

A plan is a short motion from a state of the robot, improved by an iteration of DDP. Between two
plans the robot follows

    u = ū_t + K_t (x ⊖ x̄_t),

so that a plan which comes late is made up for by its gains. The next plan improves the cheapest of
some motions on the true dynamics from the new state: the old plan, followed with its gains and
continued by the tail; another motion with gains, where one is known; and the tail alone, which
brings back a robot that the plan has lost. The tail is the learned policy's motion, or no torques
where there is no policy.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.real_time_iteration import improve
from vgps_ros.core.ddp.solve import Status, solve
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.settings import setting
from vgps_ros.search.first_motion import first_motion
from vgps_ros.search.optimization_request import first_request
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class MpcSettings:
    """Settings of the plans."""

    horizon: float = setting(0.5, "length of a plan [s]", minimum=1e-3, maximum=1e3)
    first_iterations: int = setting(
        50,
        "largest number of DDP iterations of the first plan, which is made at start, from the "
        "task's initial state; the later ones have one each",
        minimum=1,
        maximum=10_000,
    )
    ddp: DdpSettings = field(default_factory=DdpSettings)
    policy_weight: float = setting(
        0.1,
        "weight w of the learned policy, where there is one, in the cost of a plan, "
        "c - w log pi_theta: it keeps a plan away from what only its end makes cheap; 0: the "
        "policy only continues plans",
        minimum=0.0,
        maximum=1e6,
    )
    plan_age_limit: float = setting(
        0.4,
        "age beyond which a plan must not drive any more; the horizon limits it too [s]",
        minimum=1e-3,
        maximum=1e3,
    )


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
        self._task, self._settings = task, settings
        self.cost = task.cost

    def first_plan(self, seed: int = 0) -> Plan:
        """Returns the plan from the task's initial state, which begins at step 0.

        Its solve starts from the motion from which a search of the task starts too.

        Raises:
            DivergenceError: that motion diverges, or its solve ends where Quu is indefinite.
        """
        settings = self._settings
        request = first_request(self._task, seed, settings.first_iterations)
        # No motion is made beyond the plan's end.
        motion = first_motion(replace(self._task, horizon=self.steps, lookahead=0), request)
        gaps = None if motion.gaps is None else motion.gaps[: self.steps]
        begun = motion.trajectory.first(self.steps)
        cost, iterations = self._cost(0, None), settings.first_iterations
        found = solve(self._task.dynamics, cost, begun, settings.ddp, iterations, gaps=gaps)
        return Plan(0, found.trajectory, found.policy.gains, found.cost, found.status)

    def next_plan(
        self,
        plan: Plan,
        state: Array,
        step: int,
        policy: GaussianPolicy | None = None,
        is_cancelled: Callable[[], bool] = lambda: False,
        known: Sequence[Plan] = (),
    ) -> Plan:
        """Returns a plan from a newer state, warm-started by an older plan.

        Args:
            plan: the older plan, which may be longer than the new one.
            state: x, shape (n_x,).
            step: control step of the state, not before the plan's start.
            policy: π_θ, which continues the plan.
            is_cancelled: asked between the parts of the iteration; true ends it.
            known: other plans, of any length, that may be better to begin with.

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
        cost = self._cost(step, policy)
        motions = [self._continued(old, state, step, policy) for old in (plan, *known)]
        motions.append(self._tail(state, policy))
        costs = [float(np.sum(cost.values(motion))) for motion in motions]
        # A motion that diverges costs NaN.
        best = int(np.argmin(np.nan_to_num(costs, nan=np.inf)))
        dynamics, ddp = self._task.dynamics, self._settings.ddp
        found = improve(dynamics, cost, motions[best], ddp, is_cancelled)
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
        self, plan: Plan, state: Array, step: int, policy: GaussianPolicy | None
    ) -> Trajectory:
        """Returns the old plan's motion from the state, continued by the tail."""
        passed = min(step - plan.start, len(plan.gains))
        end = passed + self.steps
        x, u = plan.trajectory.states[passed : end + 1], plan.trajectory.controls[passed:end]
        gains = np.ascontiguousarray(plan.gains[passed:end])
        nominal = Trajectory(np.ascontiguousarray(x), np.ascontiguousarray(u))
        (kept,) = self._task.dynamics.follow_each(state, [nominal], gains)
        tail = self._tail(kept.states[-1], policy, self.steps - len(u))
        return Trajectory(
            np.concatenate([kept.states, tail.states[1:]]),
            np.concatenate([kept.controls, tail.controls]),
        )

    def _tail(
        self, state: Array, policy: GaussianPolicy | None, steps: int | None = None
    ) -> Trajectory:
        """Returns the policy's motion from a state, or that of no torques."""
        task, count = self._task, self.steps if steps is None else steps
        zero = np.zeros((count, task.dynamics.control_dim))
        if policy is None:
            return task.dynamics.rollout(state, lambda t, _: zero[t], count)
        start, noise = state[None], zero[None]
        states, controls = task.dynamics.execute(policy, task.observation, start, noise)
        return Trajectory(states[0], controls[0])

    def _cost(self, step: int, policy: GaussianPolicy | None) -> TrajectoryCost:
        """Returns the cost of a plan that begins at a control step."""
        task, weight = self._task, self._settings.policy_weight
        cost = self.cost.starting_at(step, self.steps)
        if policy is None or not weight:
            return cost
        n_dx, n_u = task.dims["n_dx"], task.dims["n_u"]
        deviations, gains = np.zeros((1, self.steps, n_dx)), np.zeros((self.steps, n_u, n_dx))
        scaled = ScaledCost(cost, 1.0 / weight)
        return ScaledCost(PolicyCost(scaled, policy, task.observation, deviations, gains), weight)
