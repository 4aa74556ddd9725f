# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A controller in real time under pushes: `python -m benchmarks.pushes TASK CONTROLLER --help`.

The robot is simulated here, in the place of the node `simulation`, since it is pushed: at each push
the velocity of its base changes at once, in a random direction. After a fall it starts anew.
"""

import argparse
import json
import os
import time
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from vgps_msgs.msg import Plan

from benchmarks.processes import Bench, bench
from benchmarks.pushed import add_arguments, push
from vgps_ros.core.errors import DivergenceError
from vgps_ros.messages.conversions import command_from_msg, nanoseconds
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.nodes.simulation.robot import SimulatedRobot
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.simulation.frames import state_layout
from vgps_ros.tasks import make_task

_TIMEOUT = 0.5  # after which a command no longer holds, as in the node simulation [s]


class PushedRobot:
    """A robot in real time, driven by a controller's commands.

    Args:
        graph: the graph in which the controller is.
        task: the robot's task.
        seed: seed of the pushes' directions.
    """

    def __init__(self, graph: Bench, task: str, seed: int):
        self._task = make_task(task)
        self._states = StateMessages(state_layout(self._task.dynamics.model))
        self._robot = SimulatedRobot(self._task, self._states, self._task.initial_state)
        self._rng = np.random.default_rng(seed)
        self._publishers = {
            topic: graph.node.create_publisher(kind, topic, STREAM)
            for topic, kind in self._states.topics.items()
        }
        self._command: tuple[int, Any, float] = (-1, np.zeros(self._task.dims["n_u"]), 0.0)
        self.delays: list[float] = []  # of the answers [s]
        self._sent: dict[int, float] = {}
        qos = QoSProfile(depth=1000)
        graph.node.create_subscription(JointState, "joint_command", self._take, qos)
        self.plans: list[float] = []  # the time that each took [s]
        graph.node.create_subscription(Plan, "plan", self._take_plan, qos)
        self.graph, self.missed, self.steps = graph, 0, 0
        self.pushes, self.falls = 0, 0
        self.costs: list[float] = []

    def _take(self, message: JointState) -> None:
        stamp = nanoseconds(message.header.stamp)
        torques = command_from_msg(message, self._task.controls)
        now = time.monotonic()
        self._command = stamp, torques, now
        if stamp in self._sent:
            self.delays.append(now - self._sent.pop(stamp))

    def _take_plan(self, message: Any) -> None:
        self.plans.append(message.solve_time)

    def wait_for_controller(self) -> None:
        """Publishes the first state until it is answered."""
        while self._command[0] < 0:
            self._publish()
            self.graph.spin_to(time.monotonic() + 0.5)

    def _publish(self) -> None:
        self._sent[self._robot.stamp] = time.monotonic()
        for topic, message in self._robot.messages.items():
            self._publishers[topic].publish(message)

    def run(self, seconds: float, push: float, every: float) -> None:
        """Lets time pass, with a push of this change of velocity [m/s] at every so many seconds."""
        period = self._task.dynamics.time_step
        due = time.monotonic()
        for step in range(round(seconds / period)):
            self._publish()
            due += period
            self.graph.spin_to(due)
            stamp, torques, came = self._command
            self.steps += 1
            self.missed += stamp != self._robot.stamp
            if time.monotonic() - came > _TIMEOUT:
                torques = np.zeros_like(torques)
            self._advance(torques)
            if push and (step + 1) % round(every / period) == 0:
                self._push(push)

    def _advance(self, torques: Any) -> None:
        state = self._robot.state
        self.costs.append(float(self._task.cost(state[None], torques[None])[0]))
        try:
            self._robot.advance(torques)
            has_fallen = bool(self._task.fallen(self._robot.state[None])[0])
        except DivergenceError:
            has_fallen = True
        if has_fallen:
            self.falls += 1
            self._sent.clear()
            self._robot.reset(self._task.initial_state, time=True)

    def _push(self, size: float) -> None:
        pushed = push(self._task, self._robot.state, size, self._rng)
        self._robot.reset(pushed, time=False)
        self.pushes += 1


def main() -> None:
    """Measures one controller, and prints its figures as a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task")
    parser.add_argument("controller", choices=("mpc", "policy_executor"))
    add_arguments(parser)
    given = parser.parse_args()
    parameters: dict[str, Any] = {"task": given.task}
    if given.policy:
        parameters["policy_file"] = given.policy
    if given.controller == "mpc":
        parameters |= {"plan_every": 0, "horizon": given.horizon}
    with bench() as graph:
        graph.start(given.controller, **parameters)
        robot = PushedRobot(graph, given.task, seed=0)
        robot.wait_for_controller()
        robot.run(2.0, 0.0, 1.0)  # what a start costs does not count
        for counted in (robot.delays, robot.plans, robot.costs):
            counted.clear()
        robot.steps = robot.missed = robot.falls = 0
        robot.run(given.seconds, given.push, given.every)
    delays = 1e3 * np.array(robot.delays)
    figures = {
        "plans a second": len(robot.plans) / given.seconds,
        "median plan [ms]": 1e3 * float(np.median(robot.plans)) if robot.plans else None,
        "missed deadlines": robot.missed / robot.steps,
        "answer p50, p99 [ms]": np.percentile(delays, [50, 99]).round(2).tolist(),
        "pushes": robot.pushes,
        "falls": robot.falls,
        "median cost a step": float(np.median(robot.costs)),
        "mean cost a step": float(np.mean(robot.costs)),
        "load average": os.getloadavg()[0],
    }
    print(json.dumps({**vars(given), "policy": bool(given.policy)} | figures))


if __name__ == "__main__":
    main()
