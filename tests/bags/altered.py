# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Copies of the recorded sample in which messages are altered, for the program `bag`."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from mcap.reader import make_reader

from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.programs.__main__ import main as vgps

SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"
with BagReader(SAMPLE) as _bag:
    ALL = _bag.counts["/joint_command"]


def main(arguments):
    vgps(["bag", *arguments])


def definitions(bag: Path) -> dict[str, str]:
    """The definition of each type, as the bag holds it."""
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        schemas = make_reader(stream).get_summary().schemas.values()
    return {schema.name: schema.data.decode() for schema in schemas}


def copy(target: Path, change, attachments: bool = True, **parameters) -> Path:
    """Writes the sample again, each message as `change` has it; None leaves it out.

    Keyword arguments are added to the executor's recorded parameters.
    """
    writer = BagWriter(target)
    # The sample's definitions, since it may be older than the installed ones.
    writer._definitions = SimpleNamespace(find=definitions(SAMPLE).__getitem__)
    with BagReader(SAMPLE) as bag:
        for topic, kind in bag.topics.items():
            writer.add_topic(topic, kind, bag.type_hashes[topic], bag.qos[topic])
        if attachments:
            for name, text in bag.attachments().items():
                content = yaml.safe_load(text) if name == "parameters.yaml" else {}
                if content:
                    content["/policy_executor"]["ros__parameters"].update(parameters)
                writer.attach(name, yaml.safe_dump(content) if content else text, bag.start)
        for message in bag.messages():
            if (data := change(message)) is not None:
                writer.write(message.topic, message.stamp, data)
    writer.close()
    return target


def fails(arguments: list[str], sentence: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert sentence in str(stop.value.code)
