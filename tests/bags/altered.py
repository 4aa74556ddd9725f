# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Copies of the recorded sample in which messages are altered, for the program `bag`."""

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.bags.reader import BagMessage
from vgps_ros.messages.conversions import nanoseconds
from vgps_ros.programs.__main__ import main as vgps

_STORE = get_typestore(Stores.ROS2_JAZZY)
SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"
with BagReader(SAMPLE) as _bag:
    ALL = _bag.counts["/joint_command"]


def main(arguments):
    vgps(["bag", *arguments])


@cache
def definitions_of(bag: Path) -> dict[str, str]:
    """The definition of each type, as the bag holds it."""
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        schemas = make_reader(stream).get_summary().schemas.values()
    return {schema.name: schema.data.decode() for schema in schemas}


def copy(target: Path, change, attachments: bool = True, **parameters) -> Path:
    """Writes the sample again, each message as `change` has it; None leaves it out.

    Keyword arguments are added to the executor's recorded parameters, also where it speaks of them.
    """
    kept = changed(change)
    for i, message in enumerate(kept):
        if message.topic == "/parameter_events":
            kept[i] = replace(message, data=_with_values(message.data, parameters))
    return rewritten(target, kept, attachments, **parameters)


def changed(change, bag: Path = SAMPLE) -> list[BagMessage]:
    """The messages of a bag, each as `change` has it; None leaves it out."""
    found = ((message, change(message)) for message in messages_of(bag))
    return [replace(message, data=data) for message, data in found if data is not None]


def without(target: Path, topic: str, gone, bag: Path = SAMPLE) -> Path:
    """Writes a bag again, without the messages of these numbers on a topic."""
    count = itertools.count()
    kept = changed(lambda m: None if m.topic == topic and next(count) in gone else m.data, bag)
    return write_bag(target, kept, bag)


def time_of_state(number: int) -> float:
    """The stamp of a state of the sample [s]."""
    states = [m for m in messages_of() if m.topic == "/joint_states"]
    return nanoseconds(deserialize_message(states[number].data, JointState).header.stamp) * 1e-9


@cache
def messages_of(bag: Path = SAMPLE) -> tuple[BagMessage, ...]:
    """The messages of a bag."""
    with BagReader(bag) as reader:
        return tuple(reader.messages())


def rewritten(
    target: Path, messages, attachments: bool = True, definitions=None, texts=None, **parameters
) -> Path:
    """Writes the sample with other messages, in the order of their times.

    Keyword arguments are added to the executor's recorded parameters; `texts` changes the text of
    an attachment.
    """

    def told(name: str, text: str) -> str | None:
        if name == "parameters.yaml":
            content = yaml.safe_load(text)
            content["/policy_executor"]["ros__parameters"].update(parameters)
            text = yaml.safe_dump(content)
        return (texts(text) if texts else text) if attachments else None

    ordered = sorted(messages, key=lambda message: message.stamp)
    return write_bag(target, ordered, told=told, definitions=definitions)


def write_bag(
    target: Path, messages, bag: Path = SAMPLE, told=lambda _, text: text, definitions=None
) -> Path:
    """Writes messages as a bag that has the topics and the attachments of another one.

    `told` returns what an attachment of a name and a text becomes; None leaves it out. The
    definitions are that bag's and those given.
    """
    known, writer = definitions_of(bag) | (definitions or {}), BagWriter(target)
    writer._definitions = SimpleNamespace(find=known.__getitem__)
    with BagReader(bag) as old:
        for topic, kind in old.topics.items():
            writer.add_topic(topic, kind, old.type_hashes[topic], old.qos[topic])
        for name, text in old.attachments().items():
            if (content := told(name, text)) is not None:
                writer.attach(name, content, old.start)
    for topic, kind in {m.topic: m.kind for m in messages}.items():
        if topic not in writer.topics:
            writer.add_topic(topic, kind, "", [])
    for message in messages:
        writer.write(message.topic, message.stamp, message.data)
    writer.close()
    return target


def _with_values(data: bytes, parameters) -> bytes:
    """An event in which the executor says these values of its parameters."""
    kind = "rcl_interfaces/msg/ParameterEvent"
    event = _STORE.deserialize_cdr(data, kind)
    for parameter in event.new_parameters if event.node == "/policy_executor" else ():
        if parameter.name in parameters:
            value = Parameter(parameter.name, value=parameters[parameter.name])
            for field in (
                "type",
                "bool_value",
                "string_value",
                "double_value",
                "double_array_value",
            ):
                said = getattr(value.get_parameter_value(), field)
                said = np.array(said) if field.endswith("array_value") else said
                setattr(parameter.value, field, said)
    return bytes(_STORE.serialize_cdr(event, kind))


def fails(arguments: list[str], sentence: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert sentence in str(stop.value.code)
