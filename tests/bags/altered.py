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
from rosbags.typesys import Stores, get_typestore

from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.bags.reader import BagMessage
from vgps_ros.programs.__main__ import main as vgps

_STORE = get_typestore(Stores.ROS2_JAZZY)
SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"
with BagReader(SAMPLE) as _bag:
    ALL = _bag.counts["/joint_command"]


def main(arguments):
    vgps(["bag", *arguments])


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
    changed = ((message, change(message)) for message in sample())
    kept = [replace(message, data=data) for message, data in changed if data is not None]
    for i, message in enumerate(kept):
        if message.topic == "/parameter_events":
            kept[i] = replace(message, data=_with_values(message.data, parameters))
    return rewritten(target, kept, attachments, **parameters)


def without_some(target: Path, topic: str, gone) -> Path:
    """Writes the sample without the messages of these numbers on a topic."""
    count = itertools.count()
    return copy(target, lambda m: None if m.topic == topic and next(count) in gone else m.data)


@cache
def sample() -> tuple[BagMessage, ...]:
    """The messages of the sample."""
    with BagReader(SAMPLE) as bag:
        return tuple(bag.messages())


@cache
def _schemas() -> dict[str, str]:
    return definitions_of(SAMPLE)


def rewritten(
    target: Path, messages, attachments: bool = True, definitions=None, texts=None, **parameters
) -> Path:
    """Writes the sample with other messages, in the order of their times.

    Keyword arguments are added to the executor's recorded parameters; `texts` changes the text of
    an attachment.
    """
    writer = BagWriter(target)
    # The sample's definitions, since it may be older than the installed ones.
    known = _schemas() | (definitions or {})
    writer._definitions = SimpleNamespace(find=known.__getitem__)
    with BagReader(SAMPLE) as bag:
        for topic, kind in bag.topics.items():
            writer.add_topic(topic, kind, bag.type_hashes[topic], bag.qos[topic])
        if attachments:
            for name, text in bag.attachments().items():
                content = yaml.safe_load(text) if name == "parameters.yaml" else {}
                if content:
                    content["/policy_executor"]["ros__parameters"].update(parameters)
                written = yaml.safe_dump(content) if content else text
                writer.attach(name, texts(written) if texts else written, bag.start)
    for topic, kind in {m.topic: m.kind for m in messages}.items():
        if topic not in writer.topics:
            writer.add_topic(topic, kind, "", [])
    for message in sorted(messages, key=lambda message: message.stamp):
        writer.write(message.topic, message.stamp, message.data)
    writer.close()
    return target


def without(bag: Path, target: Path, topic: str, count: int) -> Path:
    """Writes a bag again, without its first messages on a topic."""
    definitions, writer = definitions_of(bag), BagWriter(target)
    writer._definitions = SimpleNamespace(find=definitions.__getitem__)
    with BagReader(bag) as given:
        for name, kind in given.topics.items():
            writer.add_topic(name, kind, given.type_hashes[name], given.qos[name])
        for name, text in given.attachments().items():
            writer.attach(name, text, given.start)
        for message in given.messages():
            count -= (is_left_out := message.topic == topic and count > 0)
            if not is_left_out:
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
