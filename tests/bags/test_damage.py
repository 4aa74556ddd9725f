# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Damaged bags cost what was damaged; `make damages` runs the long campaign."""

import os
import re
import shutil
from pathlib import Path

import pytest

from tests.bags.damage import KINDS, SAMPLE, campaign
from vgps_ros.bags import BagReader
from vgps_ros.bags.mcap_file import McapFile
from vgps_ros.bags.reader import storage_files
from vgps_ros.bags.writer import repair
from vgps_ros.core.errors import InvalidInputError


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(7))
def test_no_damage_shows_a_traceback_or_costs_a_whole_chunk(seed):
    assert campaign(SAMPLE, len(KINDS), seed, tools=1) == []


@pytest.fixture
def bag(tmp_path) -> Path:
    shutil.copytree(SAMPLE, tmp_path / "bag")
    return tmp_path / "bag"


def test_one_flipped_bit_costs_one_chunk_which_is_named(bag):
    [file] = storage_files(bag)
    content = McapFile(file)
    piece = content.pieces[20]
    lost = [message for _, message in content.messages([piece])]
    with BagReader(bag) as reader:
        before = list(reader.messages())
    data = bytearray(file.read_bytes())
    data[piece.begin + 200] ^= 1
    file.write_bytes(data)
    with BagReader(bag) as reader:
        assert len(before) - len(list(reader.messages())) == len(lost)
        [sentence] = reader.damages
    assert sentence.startswith(f"bag_0.mcap: the chunk at byte {piece.begin} is damaged, with ")
    stamps = [message.log_time * 1e-9 for message in lost]
    assert f"from {min(stamps):.3f} to {max(stamps):.3f} s" in sentence
    repair(bag)
    with BagReader(bag) as reader:
        assert len(before) - len(list(reader.messages())) == len(lost)
        assert reader.damages == []


def test_a_damaged_length_costs_one_chunk_where_the_index_names_the_next(bag):
    [file] = storage_files(bag)
    content = McapFile(file)
    piece = content.pieces[20]
    data = bytearray(file.read_bytes())
    data[piece.begin + 6] ^= 1  # in the length of its record
    file.write_bytes(data)
    damaged = McapFile(file)
    assert [p.begin for p in damaged.pieces] == [
        p.begin for p in content.pieces if p.begin != piece.begin
    ]
    assert f"bytes {piece.begin} to " in damaged.damages[0]


def test_a_damaged_attachment_is_named(bag):
    [file] = storage_files(bag)
    data = file.read_bytes()
    file.write_bytes(data.replace(b"mujoco: ", b"mujoco; ", 1))
    [sentence] = McapFile(file).damages
    assert re.search("the attachment at byte [0-9]+ is damaged", sentence)


def test_a_bag_whose_file_is_missing_is_not_whole(bag):
    shutil.copy(bag / "bag_0.mcap", bag / "bag_1.mcap")
    (bag / "bag_0.mcap").unlink()
    with pytest.raises(InvalidInputError, match=r"it lacks the file bag_0\.mcap"):
        BagReader(bag)


def test_a_pipe_and_a_device_are_no_files_of_a_bag(tmp_path):
    os.mkfifo(tmp_path / "bag_0.mcap")
    (tmp_path / "bag_1.mcap").symlink_to("/dev/zero")
    with pytest.raises(InvalidInputError, match="is not a bag"):
        BagReader(tmp_path)
