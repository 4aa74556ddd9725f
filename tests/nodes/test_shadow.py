# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A look before it moves: the executor in shadow beside a robot with contacts that runs."""

import sys
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from tests.nodes.conftest import values_of
from vgps_ros import tasks

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
FOLDER = Path(tasks.__file__).parent / "quadruped"
LEGS = [f"{end}_{side}" for end in ("front", "hind") for side in ("left", "right")]
JOINTS = [f"{leg}_{part}" for leg in LEGS for part in ("hip", "thigh", "shin")]


def start(graph, *words, **parameters):
    """Starts a driver with some flags, and the shadow of the quadruped's shipped policy."""
    command = [sys.executable, "-m", "tests.nodes.contact_robot", str(FOLDER / "quadruped.xml")]
    graph.start_command("contact_robot", [*command, *words])
    given = {"task": "quadruped", "policy_file": FOLDER / "policy.json", "shadow": True}
    given |= {"state_qos": "sensor_data", "state_timeout": 5.0}
    return graph.start("policy_executor", **given | parameters)


def steer(graph):
    """Commands rest, again and again, so that the policy is told all that it reads."""
    publisher = graph.node.create_publisher(TwistStamped, "cmd_vel", 10)
    graph.node.create_timer(0.1, lambda: publisher.publish(TwistStamped()))


def test_nothing_is_wrong_with_a_robot_that_stands_and_nothing_is_commanded(graph):
    commands = graph.messages(JointState, "joint_command")
    steer(graph)
    start(graph)

    def is_well():
        values = values_of(graph.diagnosis("policy_executor", OK))
        return values.get("look") == "nothing is wrong" and values

    values = graph.spin_until(is_well, what="a look that finds nothing")
    assert not commands
    assert values["joints"] == "12 known"
    assert values["up in the axes of the base"].endswith(" 1.00")
    assert values["policy reads"].startswith("24 of joint_states; up/x, up/y, up/z, turning/x")
    assert "Hz" in values["imu"]
    assert not graph.call(Trigger, "policy_executor/stand").success


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--upside-down"], "rad tilted from how the robot starts: if it stands upright"),
        (["--rate", "25"], "but the policy learned 50 controls a second"),
        (["--missing", JOINTS[4]], f"joint_states lack {JOINTS[4]}: let the driver name"),
        (
            ["--order", ",".join(sorted(JOINTS, key=lambda name: name.rpartition("_")[2]))],
            "the driver's order is not that of its names; it sends front_left_thigh as",
        ),
    ],
)
def test_what_is_wrong_with_a_robot_is_said_in_a_sentence_and_on_diagnostics(
    graph, words, sentence
):
    steer(graph)
    shadow = start(graph, *words)
    graph.diagnosis("policy_executor", None, sentence)
    graph.spin_until_output(shadow, sentence)


def test_the_answers_stand_beside_what_drives_and_swapped_legs_are_seen_by_their_motion(graph):
    """A controller of the driver's own lets it sway; left and right are measured the wrong way."""
    swapped = [
        n.replace("left", "?").replace("right", "left").replace("?", "right") for n in JOINTS
    ]
    start(graph, "--sway", "0.04", "--order", ",".join(swapped))
    status = graph.diagnosis("policy_executor", None, "is commanded: the driver's order or signs")
    graph.diagnosis("policy_executor", None, "Nobody publishes cmd_vel or command, so that forward")
    assert values_of(status)["rms of answers − commands"].startswith("0.")
