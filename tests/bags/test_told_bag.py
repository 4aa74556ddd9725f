# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A bag of a robot that was told what to do: its clock and its controls are computed again."""

import re

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import StepSimulation
from vgps_msgs.msg import Signals as SignalsMsg

from tests.nodes.conftest import PATIENCE, graph, told  # noqa: F401
from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task


def rewritten(bag, target, change):
    """Writes a bag again, each message as `change` has it, or without it."""
    writer = BagWriter(target)
    with BagReader(bag) as old:
        for topic, kind in old.topics.items():
            writer.add_topic(topic, kind, old.type_hashes[topic], old.qos[topic])
        for name, text in old.attachments().items():
            writer.attach(name, text, old.start)
        for message in old.messages():
            if (data := change(message)) is not None:
                writer.write(message.topic, message.stamp, data)
    writer.close()
    return target


def altered(change, time=None):
    """Returns what `rewritten` takes: the values of contexts at a time [s], or all, are changed."""

    def apply(message):
        if message.topic != "/context":
            return message.data
        context = deserialize_message(message.data, SignalsMsg)
        # A paused simulation repeats its state; that of 0.4 s comes once.
        if time is None or context.header.stamp == stamp_of(round(time * 1e9)):
            change(context.values)
        return serialize_message(context)

    return apply


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
    steps = StepSimulation.Request(steps=5)
    graph.call(StepSimulation, "simulation/step_simulation", steps)
    graph.spin_for(1.0)  # until the recorder has found the topics
    message = TwistStamped()
    message.twist.angular.z = 0.5
    cmd_vel.publish(message)
    graph.spin_for(0.5)
    for _ in range(4):
        graph.call(StepSimulation, "simulation/step_simulation", steps)
        graph.spin_for(0.5)
    graph.spin_until(lambda: len(commands) > 20, what="the controls")
    graph.spin_for(1.5)  # for the diagnostics
    assert recorder.end() == 0
    return tmp_path / "bag"


def test_the_clock_and_the_torques_agree_and_what_was_altered_is_found(bag, tmp_path):
    found = check_bag(bag)
    assert not found.wrong, found.wrong
    assert found.counts["mean"] >= 20
    assert any(re.fullmatch(r"the clock of (\d+) of \1 contexts", w) for w in found.proved), found

    def turn(values):
        values[2], values[3] = values[3], -values[2]  # a quarter of a turn

    wrong = check_bag(rewritten(bag, tmp_path / "turned", altered(turn, 0.4))).wrong
    assert any("contexts are none that the executor tells" in words for words in wrong), wrong
    assert any("controls are not what the policy gives" in words for words in wrong), wrong
