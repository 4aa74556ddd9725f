# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings for the safe execution of a policy."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from vgps_ros.core.checks import finite_array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range
from vgps_ros.robot.controls import CONTROL_BOUND, Controls


@dataclass(frozen=True)
class SafetySettings:
    """Limits of torques, conditions under which a state is unusable, and the safe action."""

    torque_limits: Annotated[
        tuple[float, ...],
        Range(0.0, CONTROL_BOUND),
        "largest torque of each control on its joint, behind the gear, in both directions, in the "
        "order of the MJCF's actuators; the target of a servo is kept where the servo asks for no "
        "more; the model's own limits hold in any case; one may stand for all; 1e9 for no other "
        "[N·m, N]",
    ] = (CONTROL_BOUND,)
    torque_rate_limit: Annotated[
        float,
        Range(0.0, 1e12),
        "largest change over time of the torque on its joint that each of the policy's controls "
        "asks for, by the stamps of the states; a servo's target moves by this over its stiffness; "
        "the first control starts from rest; the safe action is not limited; 0: no limit [N·m/s]",
    ] = 0.0
    state_timeout: Annotated[
        float,
        Range(0.01, 86400.0),
        "wall-clock time without joint_states after which the safe action takes over; a paused "
        "simulation repeats its state within 2 s; on a robot, choose some control periods [s]",
    ] = 2.5
    max_state_age: Annotated[
        float,
        Range(0.0, 86400.0),
        "largest difference between a state's stamp and the node's clock; set use_sim_time for a "
        "simulation in real time; 0: no check, which lock-step needs [s]",
    ] = 0.0
    tilt_limit: Annotated[
        float,
        Range(0.0, 3.2),
        "tilt of a free base, from how it starts, beyond which the safe action drives in place of "
        "the policy; 0: no limit; of a real robot 1.2 by default [rad]",
    ] = 0.0
    joint_margin: Annotated[
        float,
        Range(0.0, 1e3),
        "distance beyond a joint's range at which its measured position is not believed; 0: no "
        "limit; of a real robot 0.5 by default [rad, m]",
    ] = 0.0
    joint_speed_limit: Annotated[
        float,
        Range(0.0, 1e6),
        "speed beyond which a joint's measured velocity is not believed; 0: no limit; of a real "
        "robot 100 by default [rad/s, m/s]",
    ] = 0.0
    safe_action: Annotated[
        Literal["zero", "damping", "stand", "feedback"],
        "action that replaces the policy after a fault: zero torque; damping, which brakes the "
        "joints of motors; in both, servos hold the measured positions, or brake if their targets "
        "are velocities; stand, as damping, but the servos of a robot on a free base go at once to "
        "the pose in which it stands, unless it is tilted beyond tilt_limit or there is an "
        "emergency stop; feedback, the DDP solution's law around its nearest state, which needs a "
        "trajectory_distribution; of a real robot stand by default",
    ] = "zero"
    damping: Annotated[
        float,
        Range(0.0, 1e6),
        "torque on a joint per velocity of the joint, of the action damping [N·m·s/rad]",
    ] = 5.0
    recovery: Annotated[
        Literal["automatic", "manual"],
        "automatic: the policy drives again from the next good state on; manual: the safe action "
        "stays until the node is deactivated and activated",
    ] = "automatic"
    distance_warning: Annotated[
        float,
        Range(0.0, 1e9),
        "Mahalanobis distance of the state from the training marginals above which the node "
        "warns; it needs a trajectory_distribution; 95 suits the shipped tasks; 0: off",
    ] = 0.0
    distance_limit: Annotated[
        float,
        Range(0.0, 1e9),
        "the same distance above which the safe action takes over; 120 suits the shipped tasks, "
        "where good runs stayed below 93 and runs that fell exceeded 130; 0: off",
    ] = 0.0

    def torques_of(self, controls: Controls) -> Array:
        """Returns the largest torque of each control on its joint, shape (n_u,) [N·m, N].

        Raises:
            InvalidInputError: there is another number of them, or the model's own limits exclude
                them.
        """
        given, n = self.torque_limits, len(controls.names)
        largest = finite_array("torque_limits", given * n if len(given) == 1 else given, (n,))
        least = controls.least
        for i in np.flatnonzero(least > largest):
            raise InvalidInputError(
                f"torque_limits[{i}] is {largest[i]:g}, but the model's own limits of "
                f"{controls.names[i]} demand a torque of {least[i]:g} at least: allow more."
            )
        return largest

    def check_suits(self, controls: Controls) -> None:
        """Checks that there is a safe action.

        Raises:
            InvalidInputError: these controls have none of this name.
        """
        for name in controls.restless:
            raise InvalidInputError(
                f"The control of {name} has no safe action, since nothing tells which of its "
                "values leaves the robot at rest; use a motor or a servo of a joint there."
            )
        if self.safe_action == "damping" and not controls.are_braked.all():
            name = controls.names[int(np.argmin(controls.are_braked))]
            raise InvalidInputError(
                f"safe_action is damping, but no state tells the velocity that the control of "
                f"{name} could brake; choose zero or feedback."
            )

    @property
    def needs_distribution(self) -> bool:
        """True if these settings use a trajectory distribution."""
        return bool(self.safe_action == "feedback" or self.distance_warning or self.distance_limit)
