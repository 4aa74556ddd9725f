# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Bags of several robots, and bags that lack what is asked for."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.bags.altered import messages_of, write_bag
from vgps_ros.bags import BagReader, MessageDefinitions
from vgps_ros.core.errors import InvalidInputError


def copied(path: Path, namespaces: tuple[str, ...], wanted: tuple[str, ...]) -> Path:
    """Writes some topics of the sample once for each namespace, which may be empty."""
    messages = [m for m in messages_of() if m.topic.rpartition("/")[2] in wanted]
    return write_bag(path, [replace(m, topic=ns + m.topic) for m in messages for ns in namespaces])


def test_of_several_robots_one_must_be_chosen_by_its_namespace(tmp_path):
    robots = copied(tmp_path / "bag", ("/left", "/right"), ("joint_states", "mjcf_description"))
    with BagReader(robots) as bag, pytest.raises(InvalidInputError) as refusal:
        bag.mjcf()
    topics = "/left/joint_states, /left/mjcf_description, /right/joint_states, /right/mjcf_desc"
    assert f"has several robots ({topics}" in str(refusal.value)
    assert "choose one with --namespace, which is one of /left, /right." in str(refusal.value)
    with BagReader(robots, "/right") as bag:
        assert bag.needed_topic("joint_states") == "/right/joint_states"
        assert "<mujoco" in bag.mjcf()
    nothing = "no messages on joint_states for /middle; "
    with BagReader(robots, "/middle") as bag, pytest.raises(InvalidInputError, match=nothing):
        bag.needed_topic("joint_states")


def test_a_robot_may_share_the_nodes_above_its_namespace(tmp_path):
    shared = copied(tmp_path / "bag", ("", "/left"), ("joint_states",))
    with BagReader(shared, "/left") as bag:
        assert bag.of_robot(["/recorder", "/left/executor", "/right/executor"]) == [
            "/left/executor",
            "/recorder",
        ]
        assert bag.needed_topic("joint_states") == "/left/joint_states"


def test_a_bag_without_the_robots_model_says_so(tmp_path):
    states = copied(tmp_path / "bag", ("",), ("joint_states",))
    nothing = "has no messages on mjcf_description; `vgps bag info"
    with BagReader(states) as bag, pytest.raises(InvalidInputError, match=nothing):
        bag.mjcf()


def test_a_message_of_another_definition_than_today_is_refused(tmp_path):
    kind = "vgps_msgs/msg/GaussianPolicy"
    messages = [message for message in messages_of() if message.topic == "/policy"]
    other = MessageDefinitions().find(kind).replace("float64[] noise_std", "float64[] noise")
    assert "float64[] noise\n" in other
    with BagReader(write_bag(tmp_path / "bag", messages, definitions={kind: other})) as bag:
        sentence = f"a valid {kind}: it was recorded with another definition .* `vgps bag info"
        with pytest.raises(InvalidInputError, match=sentence):
            next(bag.decoded("/policy"))


def test_a_message_that_its_definition_does_not_fit_is_named_with_its_time(tmp_path):
    bag_of_states = copied(tmp_path / "bag", ("",), ("joint_states",))
    with BagReader(bag_of_states) as bag:
        message = next(iter(bag.messages()))
        short = replace(message, data=message.data[:30])
        sentence = f"A message on {message.topic} at {message.stamp} ns is not a valid sensor_msgs"
        with pytest.raises(InvalidInputError, match=sentence):
            bag.decode(short)
