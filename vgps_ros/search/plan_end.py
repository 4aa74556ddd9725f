# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What comes after the end of a plan: a longer solution, followed with its gains.

A plan of half a second does not know that a walker which dives will fall. So the state in which it
ends costs what the rest of a solution over the task's whole horizon costs from there, V of its step
whose state is nearest, to second order. The gains of that step continue the plan, too.
"""

from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.core.cost import FeatureCost, TrajectoryCost
from vgps_ros.core.ddp.cost_to_go import CostToGo, cost_to_go
from vgps_ros.core.ddp.solve import Solution
from vgps_ros.core.policy_cost import ScaledCost
from vgps_ros.core.records import Array, CostExpansion, Trajectory
from vgps_ros.simulation.model import turning_hinges
from vgps_ros.tasks import Task

_ROUNDING = 1e-5  # share of the largest gain
_TURN = 2.0 * np.pi  # [rad]
_VELOCITY = 0.1  # time for which a difference of velocity counts like its way [s]


class PlanEnd:
    """A solution over a task's horizon, as what comes after the end of plans.

    Args:
        task: the task, where all steps are alike: neither its costs nor its dynamics know the time,
            and no base is free.
        solution: the solution.
        weight: of the cost of what comes after.
    """

    def __init__(self, task: Task, solution: Solution, weight: float):
        self._task, self._solution, self._weight = task, solution, weight
        # Near the solution's own end too little comes: it dives there, as plans would.
        self._last = -(-solution.trajectory.horizon // 2)
        self._priced: tuple[FeatureCost, CostToGo] | None = None
        largest = np.abs(solution.policy.gains).max(axis=(0, 1))
        # How far a walker has come makes no difference but for the rounding of derivatives.
        self._counts = largest > _ROUNDING * largest.max()
        self._gains = np.where(self._counts, solution.policy.gains, 0.0)
        is_velocity = np.arange(len(largest)) >= task.dynamics.model.nv
        self._unit = np.where(is_velocity, _VELOCITY, 1.0) * self._counts
        self._turning = [i for i in turning_hinges(task.dynamics.model) if self._turns(i)]

    def motion(self, state: Array, steps: int) -> Trajectory:
        """Returns the motion by the gains of the nearest step and the next ones.

        Where the solution ends, its last step's gains go on.
        """
        nominal, (first, turned) = self._solution.trajectory, self._nearest(state)
        ahead = first + np.arange(steps + 1)
        states = nominal.states[np.minimum(ahead, nominal.horizon)] + turned
        at = np.minimum(ahead[:-1], nominal.horizon - 1)
        followed = Trajectory(states, nominal.controls[at])
        (found,) = self._task.dynamics.follow_each(state, [followed], self._gains[at])
        return found

    def added(self, to: TrajectoryCost, cost: FeatureCost, plan: Trajectory) -> TrajectoryCost:
        """Returns the cost of plans that end near where one does, what comes after included.

        Args:
            to: the cost of the plan.
            cost: the cost of the steps after it.
            plan: the plan.
        """
        if self._priced is None or self._priced[0] is not cost:
            motion, solution = self._solution.trajectory, self._solution
            weighed = ScaledCost(cost.starting_at(0, motion.horizon), self._weight)
            v = cost_to_go(solution.linear_dynamics, weighed.expand(motion), self._gains)
            counts = self._counts.astype(float)
            self._priced = cost, CostToGo(v.v_x * counts, v.v_xx * np.outer(counts, counts))
        t, turned = self._nearest(plan.states[-2])
        return _EndedCost(to, self._solution.trajectory.states[t] + turned, self._priced[1], t)

    def _nearest(self, state: Array) -> tuple[int, Array]:
        """Returns the nearest step of those at which a plan may end, and whole turns up to there.

        These turns, shape (n_x,), are what is added to the solution's states.
        """
        away = state - self._solution.trajectory.states[: self._last]
        turned = np.zeros_like(away)
        turned[:, self._turning] = _TURN * np.round(away[:, self._turning] / _TURN)
        t = int(np.argmin(np.square(self._unit * (away - turned)).sum(axis=1)))
        return t, turned[t]

    def _turns(self, hinge: int) -> bool:
        """Returns whether a whole turn of a hinge changes no cost of the solution."""
        motion = self._solution.trajectory
        states = motion.states.copy()
        states[:, hinge] += _TURN
        cost = self._task.cost.starting_at(0, motion.horizon)
        values, turned = (cost.values(each) for each in (motion, replace(motion, states=states)))
        return np.allclose(turned, values, rtol=1e-6, atol=1e-9)


@dataclass(frozen=True)
class _EndedCost:
    """A plan's cost, with what comes after it as a cost of its last state."""

    cost: TrajectoryCost  # of the plan's steps
    origin: Array  # x̄_t, whole turns included, shape (n_x,)
    value: CostToGo  # V
    t: int  # the step of V

    def values(self, trajectory: Trajectory) -> Array:
        """Returns the cost of each step, shape (T,)."""
        values = self.cost.values(trajectory).copy()
        values[-1] += self.value(self.t, self._deviation(trajectory))
        return values

    def expand(self, trajectory: Trajectory) -> CostExpansion:
        """Returns values and derivatives of each step."""
        e, deviation = self.cost.expand(trajectory), self._deviation(trajectory)
        c, c_x, c_xx = e.c.copy(), e.c_x.copy(), e.c_xx.copy()
        c[-1] += self.value(self.t, deviation)
        c_x[-1] += self.value.v_x[self.t] + self.value.v_xx[self.t] @ deviation
        c_xx[-1] += self.value.v_xx[self.t]
        return CostExpansion(c, c_x, e.c_u, c_xx, e.c_uu, e.c_ux)

    def _deviation(self, trajectory: Trajectory) -> Array:
        return trajectory.states[-2] - self.origin
