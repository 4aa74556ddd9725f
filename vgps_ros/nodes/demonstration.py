# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `demonstration`: torques from the walker's SIMBICON controller, in the executor's place."""

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from vgps_ros.core.dynamics import DIVERGENCE_BOUND
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.conversions import command_to_msg, nanoseconds, state_from_msg
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.qos import NEWEST, STATES, lively
from vgps_ros.ros_runtime.runner import Runnable
from vgps_ros.tasks import make_task
from vgps_ros.tasks.walker.simbicon import GAIT, FootLoads, Simbicon

_STATE = "joint_states from simulation"


class DemonstrationNode(Node):
    """Answers each state of the walker once; time that runs backwards starts the gait anew."""

    def __init__(self) -> None:
        super().__init__("demonstration")
        self._task = make_task("walker")
        self._loads = FootLoads(self._task.dynamics.model)
        self._health = Health(self, owns=("joint_command",))
        self._answer = JointState()
        self._restart()
        self._commands = self.create_publisher(JointState, "joint_command", lively(STATES))
        self.create_subscription(JointState, "joint_states", self._take_state, NEWEST)
        self._health.wait_for(_STATE)

    def _restart(self) -> None:
        self._controller = Simbicon(GAIT, self._task.dynamics.time_step)
        self._stamp = -1

    def _take_state(self, message: JointState) -> None:
        self._health.arrived(_STATE)
        stamp = nanoseconds(message.header.stamp)
        if stamp < self._stamp:
            self._restart()
        if stamp == self._stamp:  # the gait must not go on twice
            self._commands.publish(self._answer)
            return
        with self._health.judging("state", "Gave no torques"):
            state = state_from_msg(message, self._task.joint_names)
            if (largest := np.abs(state).max()) > DIVERGENCE_BOUND:
                raise InvalidInputError(
                    f"the state has a value of {largest:g}, but beyond {DIVERGENCE_BOUND:g} it has "
                    "diverged; reset the simulation."
                )
            torques = self._controller.torques(state, self._loads(state))
            self._stamp = stamp
            self._answer = command_to_msg(torques, self._task.controls, message.header.stamp)
            self._commands.publish(self._answer)


NODE = Runnable(DemonstrationNode)
