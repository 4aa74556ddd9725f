# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Publishes what an IMU in a robot's free base measures, on `imu`, with noise.

It has the axes and the origin of the base. The acceleration is the proper one, as REP-145 has it:
the mean over the control step before, less gravity.
"""

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import Imu

from vgps_ros.core.checks import finite_array
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import SEED, Stream, generator
from vgps_ros.core.settings import Range, Setting
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.messages.robot_state import IMU, StateMessages, put
from vgps_ros.nodes.simulation.robot import SimulatedRobot
from vgps_ros.robot.bodies import BACK, product, rotate
from vgps_ros.ros_runtime.parameters import declare
from vgps_ros.ros_runtime.qos import STATES, lively

_FIELDS, _AXES = ("orientation", "angular_velocity", "linear_acceleration"), ("wxyz", "xyz", "xyz")

IMU_NOISE = Setting(
    "imu_noise",
    (0.0, 0.0, 0.0),
    Range(0.0, 1e3),
    "standard deviations of the noise of the imu's orientation, angular velocity and "
    "linear acceleration [rad, rad/s, m/s²]",
)


class SimulatedImu:
    """Measures a robot with a free base; of any other there is no IMU.

    Raises:
        InvalidInputError: a parameter has another number of values than it must have.
    """

    def __init__(self, node: Node, states: StateMessages, gravity: Array):
        self._noise = finite_array("imu_noise", declare(node, IMU_NOISE), (3,)).repeat(3)
        self._seed = declare(node, SEED)
        self._gravity, self._base = gravity, states.base
        self._state, self._stamp = np.empty(0), -1  # of the newest measurement, with [ns]
        self._values = np.empty(10)  # orientation (w, x, y, z), angular velocity, acceleration
        if self._base:
            self._publisher = node.create_publisher(Imu, IMU, lively(STATES))
            self._message = Imu()
            self._message.header.frame_id = states.base_frame
            for name, three in zip(_FIELDS, (self._noise**2).reshape(3, 3), strict=True):
                setattr(self._message, f"{name}_covariance", np.diag(three).ravel())

    def send(self, robot: SimulatedRobot) -> None:
        """Publishes what is measured of a robot."""
        if not self._base:
            return
        self._measure(robot.state, robot.stamp)
        values = self._values
        if self._noise.any():
            errors = self._noise * generator(self._seed, Stream.IMU, robot.stamp).standard_normal(9)
            half = np.concatenate([[1.0], 0.5 * errors[:3]])
            turned = product(values[:4], half / np.linalg.norm(half))
            values = np.concatenate([turned, values[4:] + errors[3:]])
        self._message.header.stamp = stamp_of(robot.stamp)
        for name, axes, part in zip(_FIELDS, _AXES, np.split(values, [4, 7]), strict=True):
            put(getattr(self._message, name), axes, part)
        self._publisher.publish(self._message)

    def _measure(self, state: Array, stamp: int) -> None:
        """Measures a state; where the robot was put, nothing tells its acceleration."""
        assert self._base is not None
        if self._stamp == stamp and np.array_equal(self._state, state):
            return
        acceleration = -self._gravity
        if 0 <= self._stamp < stamp:
            _, _, earlier, _ = self._base.parts(self._state)
            acceleration = acceleration + (self._base.parts(state)[2] - earlier) * (
                1e9 / (stamp - self._stamp)
            )
        _, rotation, _, angular = self._base.parts(state)
        along = rotate(acceleration, rotation * BACK)
        self._values = np.concatenate([rotation, angular, along])
        self._state, self._stamp = state.copy(), stamp
