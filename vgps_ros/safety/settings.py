# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings for the safe execution of a policy."""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.checks import finite_array
from vgps_ros.core.dynamics import CONTROL_BOUND
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import setting


@dataclass(frozen=True)
class SafetySettings:
    """Limits of torques, conditions under which a state is unusable, and the safe action."""

    torque_limits: tuple[float, ...] = setting(
        (CONTROL_BOUND,),
        "largest torque of each actuated joint in both directions, in the order of the MJCF's "
        "actuators, within the MJCF's own limits, which hold in any case; 1e9 for no other [N·m]",
        minimum=0.0,
        maximum=CONTROL_BOUND,
    )
    torque_rate_limit: float = setting(
        0.0,
        "largest change of each of the policy's torques over time, by the stamps of the states; "
        "the first torques start from zero; the safe action is not limited; 0: no limit [N·m/s]",
        minimum=0.0,
        maximum=1e12,
    )
    state_timeout: float = setting(
        2.5,
        "wall-clock time without joint_states after which the safe action takes over; a paused "
        "simulation repeats its state within 2 s; on a robot, choose some control periods [s]",
        minimum=0.01,
        maximum=86400.0,
    )
    max_state_age: float = setting(
        0.0,
        "largest difference between a state's stamp and the node's clock; set use_sim_time for a "
        "simulation in real time; 0: no check, which lock-step needs [s]",
        minimum=0.0,
        maximum=86400.0,
    )
    safe_action: str = setting(
        "zero",
        "action that replaces the policy after a fault: zero torque; damping, which brakes the "
        "actuated joints; feedback, the DDP solution's law around its nearest state, which needs a "
        "trajectory_distribution",
        choices=("zero", "damping", "feedback"),
    )
    damping: float = setting(
        5.0, "torque per joint velocity of the action damping [N·m·s/rad]", minimum=0.0, maximum=1e6
    )
    recovery: str = setting(
        "automatic",
        "automatic: the policy drives again from the next good state on; manual: the safe action "
        "stays until the node is deactivated and activated",
        choices=("automatic", "manual"),
    )
    distance_warning: float = setting(
        0.0,
        "Mahalanobis distance of the state from the training marginals above which the node "
        "warns; it needs a trajectory_distribution; 95 suits the shipped tasks; 0: off",
        minimum=0.0,
        maximum=1e9,
    )
    distance_limit: float = setting(
        0.0,
        "the same distance above which the safe action takes over; 120 suits the shipped tasks, "
        "where good runs stayed below 93 and runs that fell exceeded 130; 0: off",
        minimum=0.0,
        maximum=1e9,
    )

    def torque_range(self, control_limits: tuple[Array, Array]) -> tuple[Array, Array]:
        """Returns the lowest and the highest torques, shapes (n_u,), within the robot's own limits.

        Raises:
            InvalidInputError: no torque is within both.
        """
        largest = finite_array("torque_limits", self.torque_limits, control_limits[0].shape)
        low, high = np.maximum(control_limits[0], -largest), np.minimum(control_limits[1], largest)
        for i in np.flatnonzero(low > high):
            raise InvalidInputError(
                f"torque_limits[{i}] is {largest[i]:g} N·m, but the robot's own limits of this "
                f"torque are {control_limits[0][i]:g} and {control_limits[1][i]:g} N·m: allow more."
            )
        return low, high

    @property
    def needs_distribution(self) -> bool:
        """True if these settings use a trajectory distribution."""
        return bool(self.safe_action == "feedback" or self.distance_warning or self.distance_limit)
