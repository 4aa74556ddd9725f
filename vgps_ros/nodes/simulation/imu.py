# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Publishes what an IMU in a robot's free base measures, on `imu`, with errors and latency.

It has the axes and the origin of the base. The acceleration is the proper one, as REP-145 has it:
the mean over the control step before, less gravity.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import Imu

from vgps_ros.core.checks import finite_array
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import SEED, Stream, generator
from vgps_ros.core.settings import setting
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.messages.robot_state import IMU, StateMessages, put
from vgps_ros.robot.bodies import BACK, product, rotate
from vgps_ros.ros_runtime.parameters import declare, declare_settings
from vgps_ros.ros_runtime.qos import STATES, lively

_FIELDS, _AXES = ("orientation", "angular_velocity", "linear_acceleration"), ("wxyz", "xyz", "xyz")


@dataclass(frozen=True)
class ImuSettings:
    """The errors of the simulated IMU."""

    imu_noise: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0),
        "standard deviations of the noise of the imu's orientation, angular velocity and linear "
        "acceleration [rad, rad/s, m/s²]",
        minimum=0.0,
        maximum=1e3,
    )
    imu_bias: tuple[float, ...] = setting(
        (0.0,) * 9,
        "constant errors of the imu about or along x, y and z: three of its orientation, of its "
        "angular velocity and of its linear acceleration [rad, rad/s, m/s²]",
        minimum=-1e3,
        maximum=1e3,
    )
    imu_latency: float = setting(
        0.0,
        "simulated time from the imu's measurement, whose time its stamp is, to the message; it is "
        "rounded up to control steps [s]",
        minimum=0.0,
        maximum=1.0,
    )


class _Sample(NamedTuple):
    stamp: int  # [ns]
    state: Array
    values: Array  # orientation (w, x, y, z), angular velocity, linear acceleration, shape (10,)


class SimulatedImu:
    """Measures a robot with a free base; of any other there is no IMU.

    Raises:
        InvalidInputError: a parameter has another number of values than it must have.
    """

    def __init__(self, node: Node, states: StateMessages, gravity: Array):
        settings = declare_settings(node, ImuSettings())
        self._seed = declare(node, SEED)
        deviations = finite_array("imu_noise", settings.imu_noise, (3,))
        self._noise = deviations.repeat(3)
        self._bias = finite_array("imu_bias", settings.imu_bias, (9,))
        self._latency = round(settings.imu_latency * 1e9)
        self._gravity, self._base = gravity, states.base
        self._samples: deque[_Sample] = deque()
        if self._base:
            self._publisher = node.create_publisher(Imu, IMU, lively(STATES))
            self._message = Imu()
            self._message.header.frame_id = states.base_frame
            variances = self._noise**2 + self._bias**2
            for name, three in zip(_FIELDS, variances.reshape(3, 3), strict=True):
                setattr(self._message, f"{name}_covariance", np.diag(three).ravel())

    def send(self, state: Array, stamp: int) -> None:
        """Publishes the newest measurement at the time `stamp` [ns], at which the state is x."""
        if not self._base:
            return
        self._take(state, stamp)
        at, values = self._samples[0].stamp, self._samples[0].values
        errors = self._bias
        if self._noise.any():
            draws = generator(self._seed, Stream.IMU, at).standard_normal(9)
            errors = errors + self._noise * draws
        if errors.any():
            half = np.concatenate([[1.0], 0.5 * errors[:3]])
            turned = product(values[:4], half / np.linalg.norm(half))
            values = np.concatenate([turned, values[4:] + errors[3:]])
        self._message.header.stamp = stamp_of(at)
        for name, axes, part in zip(_FIELDS, _AXES, np.split(values, [4, 7]), strict=True):
            put(getattr(self._message, name), axes, part)
        self._publisher.publish(self._message)

    def _take(self, state: Array, stamp: int) -> None:
        """Keeps a state for as long as the latency needs it; all go where the robot was put."""
        assert self._base is not None
        before = self._samples[-1] if self._samples else None
        if before and before.stamp == stamp and np.array_equal(before.state, state):
            return
        acceleration = -self._gravity
        if before and before.stamp < stamp:
            _, _, earlier, _ = self._base.parts(before.state)
            acceleration = acceleration + (self._base.parts(state)[2] - earlier) * (
                1e9 / (stamp - before.stamp)
            )
        else:
            self._samples.clear()
        _, rotation, _, angular = self._base.parts(state)
        along = rotate(acceleration, rotation * BACK)
        values = np.concatenate([rotation, angular, along])
        self._samples.append(_Sample(stamp, state.copy(), values))
        while len(self._samples) > 1 and self._samples[1].stamp <= stamp - self._latency:
            self._samples.popleft()
