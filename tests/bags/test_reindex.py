# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Bags whose writer was killed: what was flushed is kept, and the bag is made whole again."""

import signal
import subprocess
import sys
from dataclasses import replace

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.bags.repair import repair
from vgps_ros.core.errors import InvalidInputError

KIND = "sensor_msgs/msg/JointState"
HASH = get_typestore(Stores.ROS2_JAZZY).hash_rihs01(KIND)
KILLED = """
import os, signal
from pathlib import Path
from vgps_ros.bags import BagWriter
writer = BagWriter(Path({path!r}), max_file_duration=10, compression="lz4")
writer.attach("parameters.yaml", "seed: 3", 1)
writer.add_topic("/a", {kind!r}, {hash!r}, [])
for i in range(1, 26):
    writer.write("/a", i, bytes([i] * 60))
writer.flush()
writer.write("/a", 26, bytes(60))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def killed(tmp_path):
    """A bag of three files, of which the last lacks its index, and all lack metadata.yaml."""
    path = tmp_path / "bag"
    program = KILLED.format(path=str(path), kind=KIND, hash=HASH)
    run = subprocess.run([sys.executable, "-c", program], check=False)
    assert run.returncode == -signal.SIGKILL
    return path


def test_what_is_missing_is_said_with_what_can_be_done(killed):
    sentence = rf"was not closed, .*it has no metadata\.yaml\); `vgps bag reindex {killed}` keeps"
    with pytest.raises(InvalidInputError, match=sentence):
        BagReader(killed)


@pytest.mark.parametrize("cut", [0, 1, 30])
def test_reindexing_keeps_every_whole_chunk_and_other_tools_open_the_bag(killed, cut):
    last = killed / "bag_2.mcap"
    whole = last.stat().st_size
    if cut:  # as a killed process or a full disk leaves it: half a chunk at the end
        last.write_bytes(last.read_bytes() + b"\x06" + (400).to_bytes(8, "little") + bytes(cut))
    before = last.read_bytes()
    assert repair(killed) == {
        last: [f"bag_2.mcap: it breaks off at byte {whole} of {len(before)}"],
        killed / "metadata.yaml": [],
    }
    assert (killed / "bag_2.mcap.unfinished").read_bytes() == before
    expected = [(i, bytes([i] * 60)) for i in range(1, 26)]
    with AnyReader([killed]) as reader:
        assert [(stamp, bytes(data)) for _, stamp, data in reader.messages()] == expected
    with BagReader(killed) as reader:
        assert reader.attachments() == {"parameters.yaml": "seed: 3"}
        assert reader.type_hashes == {"/a": HASH}
    files = {file: file.read_bytes() for file in killed.iterdir()}
    assert repair(killed) == {}  # nothing left to do
    assert {file: file.read_bytes() for file in killed.iterdir()} == files


def test_what_is_rebuilt_stands_there_as_it_did(tmp_path):
    file, found = tmp_path / "bag_0.mcap", []
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        writer.add_attachment(1, 2, "picture", "image/png", b"\x89PNG")
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        number = writer.register_schema("std_msgs/msg/Int32", "ros2idl", b"long data; \xff")
        for i, (encoding, schema) in enumerate((("cdr", text), ("cdr", number), ("json", 0))):
            channel = writer.register_channel("/a", encoding, schema, {"of": str(i)})
            writer.add_message(channel, 5 + i, bytes([i] * 12), 3 + i, sequence=7 + i)
        writer.finish()
    for _ in range(2):
        with file.open("rb") as stream:
            reader = make_reader(stream)
            messages = [
                (schema, replace(channel, id=0), replace(message, channel_id=0))
                for schema, channel, message in reader.iter_messages()
            ]
            found.append((messages, list(reader.iter_attachments())))
        if len(found) == 1:
            file.write_bytes(file.read_bytes()[:-20])
            assert list(repair(tmp_path)) == [file, tmp_path / "metadata.yaml"]
    assert found[0] == found[1]
    assert len(messages) == 3


def test_a_folder_in_the_place_of_metadata_is_named(killed):
    (killed / "metadata.yaml").mkdir()
    with pytest.raises(InvalidInputError, match=r"metadata\.yaml.*directory.*reindex"):
        BagReader(killed)
    with pytest.raises(IsADirectoryError, match=r"metadata\.yaml"):
        repair(killed)


def test_a_last_file_without_a_message_is_set_aside(killed):
    (killed / "bag_3.mcap").write_bytes((killed / "bag_2.mcap").read_bytes()[:40])
    repair(killed)
    assert (killed / "bag_3.mcap.unfinished").is_file()
    with AnyReader([killed]) as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == list(range(1, 26))


def test_a_bag_without_one_readable_message_is_refused_and_left_alone(tmp_path):
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP0\r\nbroken")
    with pytest.raises(InvalidInputError, match="not one of its messages can be read"):
        repair(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["bag.mcap"]


def test_a_bag_that_is_still_recorded_is_refused(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    with pytest.raises(InvalidInputError, match="is still being recorded"):
        repair(writer.path)
    with pytest.raises(InvalidInputError, match="is still being recorded"):
        BagReader(writer.path)
    writer.close()
    with BagReader(writer.path) as reader:
        assert list(reader.messages()) == []
