# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""One iteration of DDP whose result may drive a robot at once.

Derivatives take most of an iteration's time. A solve needs them around each trajectory that it
finds, its last one too, since q has its covariances there. A plan that another one replaces within
moments does without: it is followed with gains from around the motion that was improved, and so
costs half as much. The scheme is that of Diehl, Bock and Schlöder (SIAM J. Control Optim. 2005).
"""

from collections.abc import Callable
from dataclasses import dataclass

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.ddp.forward_pass import Problem
from vgps_ros.core.ddp.solve import Status, StepSearch, centre_of_q
from vgps_ros.core.dynamics import Dynamics
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import Array, Trajectory


@dataclass(frozen=True)
class Improvement:
    """Result of one iteration.

    Attributes:
        trajectory: the improved motion, or the given one where no step was accepted.
        gains: K from around the given motion, shape (T, n_u, n_dx).
        cost: the trajectory's cost.
        status: `iteration_limit` where a step was accepted; else the reason why none was.
    """

    trajectory: Trajectory
    gains: Array
    cost: float
    status: Status


def improve(
    dynamics: Dynamics,
    cost: TrajectoryCost,
    motion: Trajectory,
    settings: DdpSettings,
    is_cancelled: Callable[[], bool] = lambda: False,
) -> Improvement:
    """Improves a motion by one iteration, with one expansion of the dynamics and the cost.

    Args:
        dynamics: x' = f(x, u).
        cost: c(x, u).
        motion: the motion, which satisfies the dynamics.
        settings: regularisation and line search.
        is_cancelled: asked between the parts of the iteration; true ends it.

    Raises:
        DivergenceError: the motion's cost or a derivative is not finite, or Quu is indefinite
            around it.
    """
    problem = Problem(dynamics, cost)
    around = problem.around(motion)
    step = StepSearch(problem, settings, is_cancelled).next_step(around)
    gains = centre_of_q(problem, around, settings.distribution_regularization).gains
    if isinstance(step, Status):
        return Improvement(motion, gains, around.cost, step)
    return Improvement(step.trajectory, gains, step.cost, Status.ITERATION_LIMIT)
