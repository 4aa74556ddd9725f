# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What the servos of a robot with contacts get under each fault, as a table.

A quadruped walks by the policy that is shipped, and a biped stands; both are driven with the
parameters of `config/robot.yaml`. The table of `docs/evidence/servos.md` is written by

    SERVOS=docs/evidence/servos.md python -m pytest -m '' tests/nodes/test_contact_faults.py
"""

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from tests.nodes.conftest import Graph, Process, open_graph
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import command_from_msg, nanoseconds
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import Task, make_task

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
LASTS = 1.5  # time of a fault, and again after it, by the robot's physics [s]
PACE = 0.5  # of real time, so that a busy machine keeps up


@dataclass(frozen=True)
class Row:
    """What came of a fault.

    Attributes:
        robot: which robot.
        fault: which fault.
        count: how many commands came from its begin on.
        jump: largest change of a servo's target between two of them [rad].
        apart: largest distance of a target from the pose in which the robot stands [rad].
        lowest: of the base [m].
        tilt: largest one [rad].
        touching: what but feet touched the floor, in words.
        said: what the executor said.
        are_sound: whether all targets were finite and within the ranges of the model's controls.
    """

    robot: str
    fault: str
    count: int
    jump: float
    apart: float
    lowest: float
    tilt: float
    touching: str
    said: str
    are_sound: bool


class Trial:
    """A robot's driver and its executor in a graph."""

    def __init__(self, graph: Graph, name: str, task: Task, model: Path, policy: Path):
        self.graph, self.name, self.task, self.policy = graph, name, task, policy
        command = [
            sys.executable,
            "-m",
            "tests.nodes.contact_robot",
            str(model),
            "--pace",
            str(PACE),
        ]
        graph.start_command("contact_robot", command)
        self.faults = graph.publisher(String, "fault")
        self.commands = graph.messages(JointState, "joint_command")
        self.truth = graph.messages(Odometry, "truth")
        if task.signals.commands:
            steering = graph.node.create_publisher(TwistStamped, "cmd_vel", 10)
            ahead = TwistStamped()
            ahead.twist.linear.x = 0.3
            graph.node.create_timer(0.1, lambda: steering.publish(ahead))
        self.executor = self.start()

    def start(self) -> Process:
        """Starts the executor; it drives once it is activated."""
        executable = self.graph.start(
            "policy_executor",
            "--ros-args",
            "--params-file",
            str(ROOT / "config" / "robot.yaml"),
            task=self.task.name,
            policy_file=self.policy,
            autostart=False,
            state_timeout=0.6,  # 0.3 s of physics: the machine may be busy
            stand_duration=0.5,
        )
        assert self.graph.change(Transition.TRANSITION_CONFIGURE)
        return executable

    def tell(self, fault: str) -> None:
        """Lets the driver have a fault."""
        self.faults.publish(String(data=fault))

    def last(self, seconds: float) -> None:
        """Spins for a time of the robot's physics [s]."""

        def now() -> float:
            return nanoseconds(self.truth[-1].header.stamp) * 1e-9 if self.truth else -1.0

        self.graph.spin_until(self.truth.__len__, what="the robot's driver")
        end = now() + seconds
        self.graph.spin_until(lambda: now() >= end, what=f"{seconds:g} s of physics")

    def drive(self) -> None:
        """Lets the robot stand as at first, and then drive."""
        self.tell("reset")
        self.last(0.5)
        self.tell("")
        assert self.graph.change(Transition.TRANSITION_ACTIVATE)
        self.last(1.0)  # of which it stands up for stand_duration
        self.graph.diagnosis("policy_executor", DiagnosticStatus.OK, "Running")
        self.last(1.0)

    def row(self, fault: str, begin: Callable[[], object], end: Callable[[], object]) -> Row:
        """Drives, has a fault, and says what came of it."""
        self.drive()
        self.truth[:-1] = []
        before = self.commands[-1:]
        self.commands.clear()
        begin()
        self.last(LASTS)
        said = self.said()
        end()
        self.last(LASTS)
        controls, own = self.task.controls, list(self.commands)
        targets = np.array([command_from_msg(m, controls) for m in (*before, *own)])
        low, high = controls.limits
        stands = controls.positions @ self.task.initial_state
        turned = np.array(
            [(m.pose.pose.orientation.x, m.pose.pose.orientation.y) for m in self.truth]
        )
        up = 1.0 - 2.0 * np.square(turned).sum(axis=1)
        touched = {name for m in self.truth for name in m.child_frame_id.split(",") if name}
        row = Row(
            self.name,
            fault,
            len(own),
            float(np.abs(np.diff(targets, axis=0)).max(initial=0.0)),
            float(np.abs(controls.at_joints(targets) - stands).max()),
            min(m.pose.pose.position.z for m in self.truth),
            float(np.arccos(np.clip(up, -1.0, 1.0)).max()),
            f"{len(touched)} bodies" if len(touched) > 2 else ", ".join(sorted(touched)) or "–",
            said,
            bool((np.isfinite(targets) & (targets >= low - 1e-9) & (targets <= high + 1e-9)).all()),
        )
        if self.executor.running:
            self.graph.change(Transition.TRANSITION_DEACTIVATE)
            self.graph.spin_for(1.2)  # settle_duration
        return row

    def said(self) -> str:
        """What is on /diagnostics, its first words."""
        if not self.executor.running:
            return "nothing: it is killed"
        message = self.graph.diagnosis("policy_executor", None).message
        words = message.removeprefix("Safe action active (stand): ")
        return words[0].upper() + words[1:].partition(";")[0].partition(". ")[0][:110]

    def rows(self) -> Iterator[Row]:
        """Yields a row for each fault."""

        def call(service: str) -> Callable[[], object]:
            return lambda: self.graph.call(Trigger, f"policy_executor/{service}")

        def nothing() -> None:
            pass

        def deactivate() -> None:
            self.graph.change(Transition.TRANSITION_DEACTIVATE)

        yield self.row("none", nothing, nothing)
        yield self.row("deactivated", deactivate, nothing)
        yield self.row("told to hold, does it sag", call("hold"), nothing)
        words = {
            "nan": "a position is NaN",
            "huge": "a position and a velocity are 1e300",
            "stall": "joint states stall for 1.5 s",
            "reorder": "joint states come in another order",
            "stale": "stamps are 5 s old",
            "flip": "it lies on its back",
        }
        for fault, said in words.items():
            yield self.row(said, lambda fault=fault: self.tell(fault), lambda: self.tell(""))
        yield self.row("killed", self.executor.kill, nothing)


def write_biped_policy(path: Path, task: Task) -> None:
    """Writes a policy that always gives the targets by which the biped stands."""
    shape = Architecture(task.observation.names, (1,), len(task.controls.names))
    parameters = np.zeros(shape.num_parameters)
    parameters[-len(task.controls.names) :] = task.initial_state[7:13]
    save_policy(GaussianPolicy(shape, parameters, np.ones(6)), task.name, path)


def rows_of(robot: str, folder: Path) -> list[Row]:
    """Returns the rows of a robot."""
    task = make_task("quadruped" if robot == "quadruped" else str(HERE / "biped" / "task.yaml"))
    if robot == "quadruped":
        model = ROOT / "vgps_ros" / "tasks" / "quadruped"
        model, policy = model / "quadruped.xml", model / "policy.json"
    else:
        model, policy = HERE / "biped" / "biped.xml", folder / "policy.json"
        write_biped_policy(policy, task)
    with open_graph(folder) as graph:
        trial = Trial(graph, robot, task, model, policy)
        rows = list(trial.rows())
        graph.processes.remove(trial.executor)  # which was killed
        return rows


def table(rows: list[Row]) -> str:
    """Returns the rows as a table of a page."""
    heading = (
        "| robot | fault | commands in 3 s | largest step of a target [rad] | farthest target from "
        "the stand [rad] | base at least at [m] | largest tilt [rad] | touches the floor, but feet "
        "| what the executor says |\n|" + " --- |" * 9
    )
    lines = [
        f"| {r.robot} | {r.fault} | {r.count} | {r.jump:.2f} | {r.apart:.2f} | {r.lowest:.3f} | "
        f"{r.tilt:.2f} | {r.touching} | {r.said} |"
        for r in rows
    ]
    return "\n".join([heading, *lines])


@pytest.mark.slow
def test_faults_leave_the_servos_with_targets_that_hold_the_robot(tmp_path):
    rows: list[Row] = []
    for robot in ("quadruped", "biped"):
        (tmp_path / robot).mkdir()
        rows += rows_of(robot, tmp_path / robot)
    print(table(rows))
    if name := os.environ.get("SERVOS"):
        before, _, after = Path(name).read_text().partition("| robot | fault |")
        Path(name).write_text(before + table(rows) + "\n\n" + after.partition("\n\n")[2])
    for row in rows:
        assert row.are_sound, row
        # Where nothing comes for state_timeout, a robot that walks has feet in the air meanwhile.
        is_silent = "stall" in row.fault or "stamps" in row.fault
        if not is_silent and row.fault not in ("it lies on its back", "killed"):
            assert row.tilt < 0.8, row
            assert row.touching == "–", row
        if row.fault == "killed":
            assert row.count <= 2, row
        elif "1e300" in row.fault or "NaN" in row.fault:
            assert row.jump < 1.0, row
