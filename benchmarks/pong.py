# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The peer of a controller: a bare node that answers each state at once with the same torques."""

from contextlib import suppress

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState

from vgps_ros.messages.conversions import pack
from vgps_ros.ros_runtime.qos import NEWEST, STREAM
from vgps_ros.tasks import make_task


def main() -> None:
    """Runs the node until INT or TERM."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        _serve()
    rclpy.try_shutdown()


def _serve() -> None:
    node = rclpy.create_node("pong")
    names = make_task("swimmer").actuated_joint_names
    answer = JointState(name=names, effort=pack(np.zeros(len(names))))
    publisher = node.create_publisher(JointState, "joint_command", STREAM)

    def reply(state: JointState) -> None:
        answer.header.stamp = state.header.stamp
        publisher.publish(answer)

    node.create_subscription(JointState, "joint_states", reply, NEWEST)
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()


if __name__ == "__main__":
    main()
