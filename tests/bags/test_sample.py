# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The shipped bag, and one that is written now, as three independent readers have them."""

import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from tests.bags.altered import SAMPLE, copy


def same(ours, theirs) -> bool:
    """Whether a message of rosbags and one of mcap-ros2-support agree in every field."""
    if is_dataclass(ours):
        # Constants and the type's name are fields of rosbags' classes, too.
        names = [f.name for f in fields(ours) if f.name.islower() and f.name[0] != "_"]
        return all(same(getattr(ours, name), getattr(theirs, name)) for name in names)
    if isinstance(ours, list):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if isinstance(ours, np.ndarray):
        return np.array_equal(ours, np.array(list(theirs), dtype=ours.dtype), equal_nan=True)
    return bool(ours == theirs) or (ours != ours and theirs != theirs)


@pytest.fixture(params=["shipped", "written"])
def bag(request, tmp_path) -> Path:
    return SAMPLE if request.param == "shipped" else copy(tmp_path / "bag", lambda m: m.data)


def test_rosbags_and_mcap_ros2_support_read_the_same_messages(bag):
    [file] = bag.glob("*.mcap")
    compared: dict[str, int] = {}
    with AnyReader([bag]) as reader, file.open("rb") as stream:
        theirs = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = {
            (channel.topic, message.log_time, message.data): content
            for _, channel, message, content in theirs.iter_decoded_messages()
        }
        for connection, stamp, data in reader.messages():
            content = decoded.pop((connection.topic, stamp, bytes(data)))
            assert same(reader.deserialize(data, connection.msgtype), content), connection.topic
            compared[connection.topic] = compared.get(connection.topic, 0) + 1
    assert not decoded
    own = {"/policy", "/learning_progress", "/trajectory_distribution"}
    assert own < set(compared)


def test_rerun_finds_no_fault_in_it(bag):
    rerun = Path(sys.executable).with_name("rerun")
    [file] = bag.glob("*.mcap")
    checked = subprocess.run(
        [rerun, "mcap", "check", file], capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stderr
    rows = [line.split() for line in checked.stdout.splitlines() if " /" in line]
    assert {row[0] for row in rows} == {"ok"}
    assert "/trajectory_distribution" in {row[3] for row in rows}
