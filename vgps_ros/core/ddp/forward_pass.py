"""The forward pass: a backtracking line search along the local policy, on the true dynamics."""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.backward_pass import LocalPolicy
from vgps_ros.core.dynamics import Dynamics
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import Trajectory


@dataclass(frozen=True)
class ForwardStep:
    """An accepted step.

    Attributes:
        trajectory: the new trajectory.
        cost: its cost.
        step_size: the step size that was accepted.
        expected_reduction: what the quadratic model expected of it.
    """

    trajectory: Trajectory
    cost: float
    step_size: float
    expected_reduction: float


def forward_pass(
    dynamics: Dynamics,
    cost: TrajectoryCost,
    nominal: Trajectory,
    nominal_cost: float,
    policy: LocalPolicy,
    settings: DdpSettings,
) -> ForwardStep | None:
    """Returns the first step of u = ū + α k + K (x − x̄) that lowers the cost as it should, or None.

    A trajectory that diverges has the cost NaN and is never accepted.
    """
    step_sizes = settings.line_search_shrink ** np.arange(settings.line_search_steps)
    nominals = [
        Trajectory(nominal.states, nominal.controls + step_size * policy.feedforward)
        for step_size in step_sizes
    ]
    found = dynamics.follow_each(nominal.states[0], nominals, policy.gains)
    for step_size, trajectory in zip(step_sizes.tolist(), found, strict=True):
        new_cost = float(np.sum(cost.values(trajectory)))
        expected = policy.expected_reduction(step_size)
        if nominal_cost - new_cost > max(settings.acceptance_ratio * expected, 0.0):
            return ForwardStep(trajectory, new_cost, step_size, expected)
    return None
