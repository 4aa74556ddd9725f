"""The forward pass: a backtracking line search along the local policy, on the true dynamics."""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.ddp.backward_pass import LocalPolicy
from vgps_ros.core.ddp.problem import Iterate, Problem
from vgps_ros.core.ddp.settings import DdpSettings
from vgps_ros.core.records import Trajectory


@dataclass(frozen=True)
class ForwardStep:
    """One step that the line search tried.

    Attributes:
        trajectory: the new trajectory, NaN from where it diverges.
        cost: its cost; NaN if it diverges.
        step_size: α.
        expected_reduction: the reduction of the cost that the quadratic model expects of α.
        is_accepted: whether the cost falls by enough of that; never where it is NaN.
    """

    trajectory: Trajectory
    cost: float
    step_size: float
    expected_reduction: float
    is_accepted: bool


def forward_pass(
    problem: Problem, around: Iterate, policy: LocalPolicy, settings: DdpSettings
) -> list[ForwardStep]:
    """Tries u = ū + α k + K (x − x̄) with falling α; returns all steps up to the accepted one."""
    nominal = around.trajectory
    step_sizes = settings.line_search_shrink ** np.arange(settings.line_search_steps)
    nominals = [
        Trajectory(nominal.states, nominal.controls + step_size * policy.feedforward)
        for step_size in step_sizes
    ]
    tried: list[ForwardStep] = []
    found = problem.dynamics.follow_each(nominal.states[0], nominals, policy.gains)
    for step_size, trajectory in zip(step_sizes.tolist(), found, strict=True):
        cost = float(np.sum(problem.cost.values(trajectory)))
        expected = policy.expected_reduction(step_size)
        enough = around.cost - cost > max(settings.acceptance_ratio * expected, 0.0)
        tried.append(ForwardStep(trajectory, cost, step_size, expected, enough))
        if enough:
            break
    return tried
