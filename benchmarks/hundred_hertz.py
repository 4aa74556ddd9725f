# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Control at 100 Hz in real time under pushes: policies, plans, and plans that a policy continues.

    python -m benchmarks.hundred_hertz --output recordings/hundred_hertz

It trains the policies that are missing, and writes a line of figures to runs.jsonl as each run ends
and the table of all to table.md. Runs that have a line are not run again. All of it takes a quarter
of an hour on two cores, and needs them for itself: on a busy machine deadlines are missed.

The robot is simulated here, in the place of the node `simulation`, since it is pushed: at each push
the velocity of its base changes at once, in a random direction. After a fall it starts anew.
"""

import argparse
import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from vgps_msgs.msg import Plan

from benchmarks.processes import Bench, bench
from vgps_ros.core.errors import DivergenceError
from vgps_ros.messages.conversions import command_from_msg, nanoseconds
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.nodes.simulation.robot import SimulatedRobot
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.simulation.frames import state_layout
from vgps_ros.tasks import make_task, task_file_of

PERIOD = "0.01"  # of control [s]
ROBOTS = ("swimmer", "walker", "quadruped")
CONTROLLERS = ("policy", "mpc", "mpc with policy")
_COLUMNS = (
    *("plans a second", "median plan [ms]", "missed deadlines", "answer p50, p99 [ms]"),
    *("pushes", "falls", "median cost a step", "mean cost a step", "load average"),
)


def at_hundred_hertz(robot: str, folder: Path) -> str:
    """Returns what the robot's task at 100 Hz is called by; writes its file where that is new."""
    file = task_file_of(robot)
    assert file is not None
    text = file.read_text()
    if f"control_period: {PERIOD} " in text:
        return robot
    model = f"package://vgps_ros/tasks/{robot}/{robot}.xml"
    text = text.replace(f"model: {robot}.xml", f"model: {model}")
    text = text.replace("control_period: 0.02 ", f"control_period: {PERIOD} ")
    if robot == "swimmer":  # its own time step is that of its control
        text += f"changes: {{option: {{timestep: {PERIOD}}}}}\n"
    path = folder / f"{robot}.yaml"
    path.write_text(text)
    return str(path.resolve())


def trained(robot: str, task: str, folder: Path, iterations: int | None) -> Path:
    """Returns the folder of the robot's policy, which is trained if it is missing."""
    run = folder / robot
    words = [*("vgps", "train", "--task", task, "--output", str(run))]
    if iterations:
        words += ["--iterations", str(iterations)]
    if not (run / "distribution.npz").exists():  # the last file that a training writes
        print(f"{robot}: training its policy ...", flush=True)
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return run / "policy.json"


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
        change, first = np.zeros(self._task.dims["n_dx"]), self._task.velocities.start
        angle = self._rng.uniform(0, 2 * np.pi)
        change[first : first + 2] = size * np.array([np.cos(angle), np.sin(angle)])
        pushed = self._task.dynamics.space.add(self._robot.state, change)
        self._robot.reset(pushed, time=False)
        self.pushes += 1


def measure(task: str, controller: str, policy: Path, given: argparse.Namespace) -> dict[str, Any]:
    """Drives the robot by one controller; returns its figures."""
    parameters: dict[str, Any] = {"task": task, "base_from": "odom"}
    if controller != "mpc":
        parameters["policy_file"] = policy
    if controller != "policy":
        parameters |= {"plan_every": 0, "horizon": given.horizon}
    with bench() as graph:
        graph.start("policy_executor" if controller == "policy" else "mpc", **parameters)
        robot = PushedRobot(graph, task, seed=0)
        robot.wait_for_controller()
        robot.run(2.0, 0.0, 1.0)  # what a start costs does not count
        for counted in (robot.delays, robot.plans, robot.costs):
            counted.clear()
        robot.steps = robot.missed = robot.falls = 0
        robot.run(given.seconds, given.push, given.every)
    answers = np.percentile(1e3 * np.array(robot.delays), [50, 99])
    return {
        "plans a second": len(robot.plans) / given.seconds,
        "median plan [ms]": 1e3 * float(np.median(robot.plans)) if robot.plans else None,
        "missed deadlines": robot.missed / robot.steps,
        "answer p50, p99 [ms]": answers.round(2).tolist(),
        "pushes": robot.pushes,
        "falls": robot.falls,
        "median cost a step": float(np.median(robot.costs)),
        "mean cost a step": float(np.mean(robot.costs)),
        "load average": os.getloadavg()[0],
    }


def table(lines: list[dict[str, Any]]) -> str:
    """Returns the figures as a table of Markdown."""
    head = ("robot", "controller", *_COLUMNS)
    rows = [head, ("---",) * len(head)]
    rows += [
        (line["robot"], line["controller"], *(_cell(line[name]) for name in _COLUMNS))
        for line in lines
    ]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def main() -> None:
    """Runs what is missing, and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("recordings/hundred_hertz"))
    parser.add_argument("--robots", nargs="+", default=ROBOTS, choices=ROBOTS)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each run")
    parser.add_argument("--push", type=float, default=0.3, help="change of velocity [m/s]")
    parser.add_argument("--every", type=float, default=2.0, help="between two pushes [s]")
    parser.add_argument("--horizon", type=float, default=0.5, help="of plans [s]")
    parser.add_argument("--iterations", type=int, help="of trainings; the task's own if left out")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    runs = given.output / "runs.jsonl"
    lines = [json.loads(line) for line in runs.read_text().splitlines()] if runs.exists() else []
    for robot in given.robots:
        task = at_hundred_hertz(robot, given.output)
        policy = trained(robot, task, given.output, given.iterations)
        for controller in CONTROLLERS:
            if any((one["robot"], one["controller"]) == (robot, controller) for one in lines):
                continue
            print(f"{robot}, {controller}: {given.seconds:g} s ...", flush=True)
            figures = measure(task, controller, policy, given)
            lines.append({**figures, "robot": robot, "controller": controller})
            with runs.open("a") as file:
                file.write(json.dumps(lines[-1]) + "\n")
            (given.output / "table.md").write_text(table(lines))
    print(table(lines))


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(f"{each:.3g}" for each in value)
    return "–" if value is None else f"{value:.3g}"


if __name__ == "__main__":
    main()
