# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Damaged bags cost what was damaged; `make damages` runs the long campaign."""

import os
import shutil
from pathlib import Path

import pytest

from tests.bags.damage import KINDS, SAMPLE, campaign, chunks
from vgps_ros.bags import BagReader
from vgps_ros.bags.metadata import storage_files
from vgps_ros.bags.repair import repair
from vgps_ros.core.errors import InvalidInputError


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(7))
def test_no_damage_shows_a_traceback_or_costs_a_whole_chunk(seed):
    assert campaign(SAMPLE, len(KINDS), seed, tools=1) == []


@pytest.fixture
def bag(tmp_path) -> Path:
    shutil.copytree(SAMPLE, tmp_path / "bag")
    return tmp_path / "bag"


def test_one_flipped_bit_is_named_and_costs_one_chunk(bag):
    [file] = storage_files(bag)
    chunk = chunks(file)[20]
    with BagReader(bag) as reader:
        before = list(reader.messages())
    data = bytearray(file.read_bytes())
    data[chunk.begin + 200] ^= 1
    file.write_bytes(data)
    sentence = r"was not closed, or is damaged \(.*\); `vgps bag reindex"
    with BagReader(bag) as reader, pytest.raises(InvalidInputError, match=sentence):
        list(reader.messages())
    [fault] = repair(bag)[file]
    assert fault.startswith(f"bag_0.mcap: the chunk at byte {chunk.begin} is damaged, with messa")
    stamps = [message.log_time * 1e-9 for message in chunk.messages]
    assert f"from {min(stamps):.3f} to {max(stamps):.3f} s" in fault
    with BagReader(bag) as reader:
        assert len(before) - len(list(reader.messages())) == len(chunk.messages)
    assert repair(bag) == {}


def test_a_damaged_length_costs_the_rest_of_its_file(bag):
    [file] = storage_files(bag)
    whole = chunks(file)
    data = bytearray(file.read_bytes())
    data[whole[20].begin + 6] ^= 1  # in the length of its record
    file.write_bytes(data)
    assert f"it breaks off at byte {whole[20].begin} of {len(data)}" in repair(bag)[file][0]
    with BagReader(bag) as reader:
        kept = sum(len(chunk.messages) for chunk in whole[:20])
        assert len(list(reader.messages())) == kept


def test_a_bag_whose_file_is_missing_is_not_whole(bag):
    shutil.copy(bag / "bag_0.mcap", bag / "bag_1.mcap")
    (bag / "bag_0.mcap").unlink()
    with pytest.raises(InvalidInputError, match=r"files are missing: .*bag_0\.mcap"):
        BagReader(bag)


def test_a_pipe_and_a_device_are_no_files_of_a_bag(tmp_path):
    os.mkfifo(tmp_path / "bag_0.mcap")
    (tmp_path / "bag_1.mcap").symlink_to("/dev/zero")
    with pytest.raises(InvalidInputError, match="is not a bag"):
        BagReader(tmp_path)
