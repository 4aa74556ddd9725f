# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A bag of a robot that was told what to do: its clock and its controls are computed again."""

import re

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from vgps_msgs.msg import Signals as SignalsMsg

from tests.bags.altered import changed, write_bag
from tests.nodes.conftest import PATIENCE, graph, told  # noqa: F401
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task


def altered(change, time=None):
    """Returns what `changed` takes: the values of contexts at a time [s], or all, are changed."""

    def apply(message):
        if message.topic != "/context":
            return message.data
        context = deserialize_message(message.data, SignalsMsg)
        # A paused simulation repeats its state; that of 0.4 s comes once.
        if time is None or context.header.stamp == stamp_of(round(time * 1e9)):
            change(context.values)
        return serialize_message(context)

    return apply


def rechecked(bag, target, change):
    """Checks the bag whose messages are as `change` has them."""
    return check_bag(write_bag(target, changed(change, bag), bag))


def tells_what_was_commanded(found):
    """Whether all contexts agree."""
    whole = any(re.fullmatch(r"the clock of (\d+) of \1 contexts", w) for w in found.proved)
    return whole and not any("were not commanded" in words for words in found.missing)


@pytest.fixture(params=[1000.0])
def bag(graph, told, tmp_path, request):  # noqa: F811
    """A robot in lock-step that stands for 5 steps, and is then told an angle for 20.

    It is commanded once. The parameter is the time after which that is too old [s].
    """
    task = make_task(told)
    shape = Architecture(task.observation.names, (5,), 1)
    draw = np.random.default_rng(0).standard_normal
    policy = GaussianPolicy(shape, 0.2 * draw(shape.num_parameters), np.ones(1))
    save_policy(policy, told, tmp_path / "policy.json")
    recorder = graph.start("recorder", output=str(tmp_path / "bag"))
    executor = {"policy_file": str(tmp_path / "policy.json"), "command_timeout": request.param}
    graph.start("policy_executor", task=told, **executor)
    graph.diagnosis("policy_executor", None, "Waiting for joint_states")
    commands = graph.messages(JointState, "joint_command")
    cmd_vel = graph.publisher(TwistStamped, "cmd_vel")
    graph.start("simulation", task=told, start_paused=True, wait_timeout=PATIENCE)
    graph.step(5)
    graph.spin_for(1.0)  # until the recorder has found the topics
    message = TwistStamped()
    message.twist.angular.z = 0.5
    cmd_vel.publish(message)
    graph.spin_for(0.5)
    for _ in range(4):
        graph.step(5)
        graph.spin_for(0.5)
    graph.spin_until(lambda: len(commands) > 20, what="the controls")
    graph.spin_for(1.5)  # for the diagnostics
    assert recorder.end() == 0
    return tmp_path / "bag"


def test_the_clock_and_the_torques_agree_and_what_was_altered_is_found(bag, tmp_path):
    found = check_bag(bag)
    assert not found.wrong, found.wrong
    assert found.counts["mean"] >= 20
    assert tells_what_was_commanded(found), found

    def turn(values):
        values[2], values[3] = values[3], -values[2]  # a quarter of a turn

    wrong = rechecked(bag, tmp_path / "turned", altered(turn, 0.4)).wrong
    assert any("contexts are none that the executor tells" in words for words in wrong), wrong
    assert any("controls are not what the policy gives" in words for words in wrong), wrong

    def exceed(values):
        values[0] = 3.0

    missing = rechecked(bag, tmp_path / "exceeding", altered(exceed, 0.4)).missing
    assert any("angle is 3" in words for words in missing), missing

    def instead(values):
        if values[0]:
            values[0] = 0.25

    # Within its range, and with a clock and controls that somebody may have computed for it.
    missing = rechecked(bag, tmp_path / "other", altered(instead)).missing
    assert any("angle is 0.25" in words for words in missing), missing

    def without(message):
        return None if message.topic == "/cmd_vel" else message.data

    missing = rechecked(bag, tmp_path / "without", without).missing
    assert any("angle is 0.5" in words for words in missing), missing

    def to_map(message):
        if message.topic != "/cmd_vel":
            return message.data
        twist = deserialize_message(message.data, TwistStamped)
        twist.header.frame_id = "map"
        return serialize_message(twist)

    missing = rechecked(bag, tmp_path / "to_map", to_map).missing
    assert any("angle is 0.5" in words for words in missing), missing


@pytest.mark.slow
@pytest.mark.parametrize("bag", [1.2], indirect=True)
def test_a_command_that_was_too_old_is_at_rest_and_one_that_was_held_on_is_found(bag, tmp_path):
    found = check_bag(bag)
    assert not found.wrong, found.wrong
    assert tells_what_was_commanded(found), found
    with BagReader(bag) as reader:
        *_, (_, last) = reader.decoded("/context")
    assert not last.values[:2].any()

    def hold(values):
        values[0] = 0.5

    missing = rechecked(bag, tmp_path / "held", altered(hold)).missing
    assert any("angle is 0.5" in words for words in missing), missing
