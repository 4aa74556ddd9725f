# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Damaged bags cost what was damaged; `make damages` runs the long campaign."""

import os
import shutil
import zlib
from pathlib import Path

import pytest
from mcap import records

from tests.bags.damage import KINDS, SAMPLE, campaign
from vgps_ros.bags import BagReader
from vgps_ros.bags.blocks import bytes_of
from vgps_ros.bags.mcap_bytes import MAGIC
from vgps_ros.bags.reindex import reindex, storage_files
from vgps_ros.bags.scan import scan
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.plain_yaml import read_yaml


@pytest.mark.parametrize("seed", range(7))
def test_no_damage_shows_a_traceback_or_costs_a_whole_chunk(seed):
    assert campaign(SAMPLE, len(KINDS), seed, tools=1) == []


@pytest.fixture
def bag(tmp_path) -> Path:
    shutil.copytree(SAMPLE, tmp_path / "bag")
    return tmp_path / "bag"


def test_one_flipped_bit_costs_one_chunk_which_is_named(bag):
    [file] = storage_files(bag)
    places = scan(file).places
    place = places[20]
    with BagReader(bag) as reader:
        before = list(reader.messages())
    data = bytearray(file.read_bytes())
    data[(place.begin + place.end) // 2] ^= 1
    file.write_bytes(data)
    with BagReader(bag) as reader:
        assert len(before) - len(list(reader.messages())) == place.counts.total()
        [sentence] = reader.damages
    which = f"chunk 21 of {len(places)}"
    assert sentence.startswith(f"bag_0.mcap: {which} is damaged, with messages of /")
    assert f"from {place.start * 1e-9:.3f} to {place.last * 1e-9:.3f} s" in sentence
    reindex(bag)
    with BagReader(bag) as reader:
        assert len(before) - len(list(reader.messages())) == place.counts.total()
        assert reader.damages == []


@pytest.mark.parametrize("before", range(1, 9))
def test_bytes_that_look_like_a_chunk_hide_none_that_begins_within_them(bag, before):
    [file] = storage_files(bag)
    places = scan(file).places
    data, begin = bytearray(file.read_bytes()), places[20].begin
    middle = (places[19].begin + places[19].end) // 2
    data[middle] ^= 1  # so that the next chunk has to be searched for
    data[begin - before : begin] = b"\x06" + bytes(before - 1)
    file.write_bytes(data)
    assert places[20].begin in [place.begin for place in scan(file).places]


@pytest.mark.parametrize("behind", range(10))
def test_a_chunk_is_found_wherever_a_searched_block_ends(bag, monkeypatch, behind):
    [file] = storage_files(bag)
    places = scan(file).places
    data = bytearray(file.read_bytes())
    data[(places[19].begin + places[19].end) // 2] ^= 1
    file.write_bytes(data)
    distance = places[20].begin + behind - places[18].end  # from where the search begins
    monkeypatch.setattr("vgps_ros.bags.whole_records._BLOCK", distance)
    assert scan(file).places == places[:19] + places[20:]


def test_a_chunk_without_messages_is_whole(tmp_path):
    content = bytes_of(records.Schema(1, b"string data", "ros2msg", "std_msgs/msg/String"))
    head = MAGIC + bytes_of(records.Header("ros2", "test"))
    chunk = bytes_of(records.Chunk("", content, 0, 0, zlib.crc32(content), len(content)))
    data = head + chunk + bytes_of(records.DataEnd(0))
    index = records.ChunkIndex(len(chunk), len(head), "", len(content), 0, 0, {}, 0, len(content))
    file = tmp_path / "bag_0.mcap"
    file.write_bytes(data + bytes_of(index, records.Footer(len(data), 0, 0)) + MAGIC)
    found = scan(file)
    assert found.is_complete
    assert found.indexes == [index]
    assert found.missing() == []


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


@pytest.mark.parametrize(
    "text",
    [
        "[" * 10_000,
        "- 1\n- ]",
        "a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9]\n"
        + "".join(
            f"{b}: &{b} [{', '.join(9 * ['*' + a])}]\n"
            for a, b in zip("abcdefgh", "bcdefghi", strict=True)
        ),
        "a: &a [*a]",
        "!!python/object/apply:os.system ['true']",
        "\x02",
    ],
)
def test_yaml_of_strangers_is_read_within_limits_or_refused(text):
    with pytest.raises(InvalidInputError, match=r"^It is no YAML that can be read: .*\.$"):
        read_yaml(text, "It")


def test_plain_yaml_is_read_with_its_aliases():
    assert read_yaml("a: &a [1, 2]\nb: *a", "It") == {"a": [1, 2], "b": [1, 2]}
    assert read_yaml("", "It") is None
