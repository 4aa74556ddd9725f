# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot's driver, as a vendor writes one: MuJoCo's physics with contacts, in its own process.

It has nothing of this project but the robot's model. It publishes `joint_states` and `imu` by best
effort, each at a rate of its own, with stamps that begin by the wall clock and go with the physics,
and gives its servos the newest targets on `joint_command`. Before the first one, or with --sway, a
controller of its own drives. Where the base is, and as its child frame what but feet touches the
floor, is on `truth`. A word on the topic `fault` changes what it sends from then on; an empty one
ends this.

    python -m tests.nodes.contact_robot robot.xml --rate 200 --sway 0.1
"""

import argparse
import signal
import time

import mujoco
import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String

STEP = 0.002  # of the physics [s]
UPSIDE_DOWN = np.array([0.0, 1.0, 0.0, 0.0])


class ContactRobot:
    """The physics, and the messages of the driver."""

    def __init__(self, given: argparse.Namespace):
        self.given, self.fault = given, ""
        self.model = mujoco.MjModel.from_xml_path(given.model)
        self.model.opt.timestep = STEP
        on_robot = self.model.geom_bodyid > 0
        self.model.geom_contype[:] = ~on_robot  # the floor bears trunk and hips, too
        self.model.geom_conaffinity[:] = on_robot
        self.model.body_contype[:] = np.arange(self.model.nbody) == 0  # those of its geoms
        self.model.body_conaffinity[:] = np.arange(self.model.nbody) > 0
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        joints = self.model.actuator_trnid[:, 0]
        self.names = [self.model.joint(j).name for j in joints]
        self.places = self.model.jnt_qposadr[joints]
        self.speeds = self.model.jnt_dofadr[joints]
        self.pose = self.data.qpos[self.places].copy()
        self.held = self.pose.copy()  # targets by which its own controller carries the weight
        self.is_driven = False
        self.node = rclpy.create_node("vendor_driver")
        make = self.node.create_publisher
        self.joints = make(JointState, "joint_states", qos_profile_sensor_data)
        self.imu = make(Imu, "imu", qos_profile_sensor_data)
        self.truth = make(Odometry, "truth", 100)
        self.own = make(JointState, "joint_command", 10) if given.sway else None
        self.node.create_subscription(JointState, "joint_command", self.take, 10)
        self.node.create_subscription(String, "fault", self.take_fault, 10)
        self.late: list[JointState] = []
        self.began, self.ticks = time.time(), 0

    def take(self, message: JointState) -> None:
        self.is_driven = True
        for name, target in zip(message.name, message.position, strict=False):
            if name in self.names and np.isfinite(target):
                self.data.ctrl[self.names.index(name)] = target

    def take_fault(self, message: String) -> None:
        self.fault = message.data
        if self.fault == "flip":
            self.data.qpos[2] += 0.1
            self.data.qpos[3:7] = UPSIDE_DOWN
            self.data.qvel[:] = 0.0
        if self.fault == "reset":  # it stands in its own controller's hold
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
            self.is_driven = False

    def advance(self, ticks: int) -> None:
        """Advances the physics by some steps."""
        for _ in range(ticks):
            if self.own or not self.is_driven:
                self.held += 2.0 * STEP * (self.pose - self.data.qpos[self.places])
                phase = np.pi * self.data.time + np.arange(len(self.names))
                self.data.ctrl[:] = self.held + self.given.sway * np.sin(phase)
            mujoco.mj_step(self.model, self.data)

    def stamp(self, message: object) -> None:
        seconds = self.began + self.ticks * STEP - 5.0 * (self.fault == "stale")
        header = message.header.stamp
        header.sec, header.nanosec = int(seconds), int(seconds % 1.0 * 1e9)

    def send_joints(self) -> None:
        order = self.given.order.split(",") if self.given.order else self.names
        index = [self.names.index(name) for name in order]  # whose values stand in these places
        message = JointState(name=list(self.names))
        message.position = self.data.qpos[self.places[index]].tolist()
        message.velocity = self.data.qvel[self.speeds[index]].tolist()
        if self.fault == "nan":
            message.position[1] = float("nan")
        if self.fault == "huge":
            message.velocity[1] = message.position[1] = 1e300
        self.stamp(message)
        for name in self.given.missing.split(","):
            if name in message.name:
                at = message.name.index(name)
                for values in (message.name, message.position, message.velocity):
                    del values[at]
        if self.fault == "stall":
            return
        self.late.append(message)
        if self.fault != "reorder" or len(self.late) == 3:  # then the newest comes first
            for each in reversed(self.late):
                self.joints.publish(each)
            self.late = []
        if self.own:
            command = JointState(name=self.names, position=self.data.ctrl.tolist())
            self.own.publish(command)

    def send_imu(self) -> None:
        turn, rate, up = np.empty(4), self.data.qvel[3:6].copy(), np.zeros(3)
        mount = UPSIDE_DOWN if self.given.upside_down else np.array([1.0, 0.0, 0.0, 0.0])
        mujoco.mju_mulQuat(turn, self.data.qpos[3:7], mount)
        back, level = mount * [1, -1, -1, -1], turn * [1, -1, -1, -1]
        mujoco.mju_rotVecQuat(rate, rate, back)
        mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 9.81]), level)
        message = Imu()
        message.header.frame_id = "imu"
        self.stamp(message)
        to = message.orientation
        to.w, to.x, to.y, to.z = turn.tolist()
        for target, values in ((message.angular_velocity, rate), (message.linear_acceleration, up)):
            target.x, target.y, target.z = values.tolist()
        self.imu.publish(message)

    def touching(self) -> list[int]:
        """The geoms but feet that touch the floor."""
        geoms = {int(g) for g in self.data.contact.geom.ravel() if self.model.geom_bodyid[g] > 0}
        return [g for g in geoms if not self.model.geom(g).name.endswith("foot")]

    def send_truth(self) -> None:
        message = Odometry()
        seconds = self.ticks * STEP  # of physics since the begin
        message.header.stamp.sec = int(seconds)
        message.header.stamp.nanosec = int(seconds % 1.0 * 1e9)
        at, to = message.pose.pose.position, message.pose.pose.orientation
        at.x, at.y, at.z = self.data.qpos[:3].tolist()
        to.w, to.x, to.y, to.z = self.data.qpos[3:7].tolist()
        bodies = {self.model.body(self.model.geom_bodyid[g]).name for g in self.touching()}
        message.child_frame_id = ",".join(sorted(bodies))
        self.truth.publish(message)

    def run(self) -> None:
        """Runs at its pace, or slower where the machine cannot, until a signal comes."""
        ending: list[int] = []
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda n, _: ending.append(n))
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        due = {
            self.send_joints: 1.0 / self.given.rate,
            self.send_imu: 1.0 / self.given.imu_rate,
            self.send_truth: 0.02,
        }
        next_of, began, step = dict.fromkeys(due, 0.0), time.monotonic(), STEP / self.given.pace
        while not ending:
            executor.spin_once(timeout_sec=step / 2)
            behind = int((time.monotonic() - began) / step) - self.ticks
            if behind > 5:  # a busy machine: its time stands still for what is beyond
                began += (behind - 5) * step
                self.began += (behind - 5) * STEP  # its stamps do not fall behind the wall clock
                behind = 5
            for _ in range(behind):
                self.advance(1)
                self.ticks += 1
                for send, period in due.items():
                    if self.ticks * STEP >= next_of[send]:
                        next_of[send] += period
                        send()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("model")
    parser.add_argument("--rate", type=float, default=200.0)
    parser.add_argument("--imu-rate", type=float, default=200.0)
    parser.add_argument("--pace", type=float, default=1.0)  # of real time
    parser.add_argument("--order", default="")
    parser.add_argument("--missing", default="")
    parser.add_argument("--upside-down", action="store_true")
    parser.add_argument("--sway", type=float, default=0.0)
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    robot = ContactRobot(parser.parse_args())
    robot.run()
    robot.node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
