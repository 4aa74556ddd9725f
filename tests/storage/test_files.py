# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files appear in one piece, or not at all."""

import os

import pytest

from vgps_ros.storage import files
from vgps_ros.storage.files import part_of, read_json, replacing, write_json


def test_a_file_is_replaced_at_the_end_only(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("old")
    with replacing(path) as file:
        file.write(b"new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("text", ["[" * 10_000 + "]" * 10_000, "{", "\udcff"])
def test_text_that_cannot_be_read_as_json_is_one_kind_of_error(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text, errors="surrogateescape")
    with pytest.raises(ValueError, match=r"\w"):
        read_json(path)


def test_what_fails_leaves_the_old_file_and_no_part(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("old")

    def write_half() -> None:
        with replacing(path) as file:
            file.write(b"new")
            raise ValueError("midway")

    with pytest.raises(ValueError, match="midway"):
        write_half()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("old")
    part_of(path).symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left"), replacing(path) as file:
        file.write(b"new")
    assert path.read_text() == "old"


def test_a_missing_folder_is_named(tmp_path):
    path = tmp_path / "missing" / "a.json"
    with pytest.raises(FileNotFoundError, match=f"There is no folder '{path.parent}'; make it"):
        write_json(path, {})


def test_json_that_is_too_large_is_not_parsed(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    write_json(path, [1.5, None])
    size = path.stat().st_size
    monkeypatch.setattr(files, "_LARGEST_JSON", size)
    assert read_json(path) == [1.5, None]
    monkeypatch.setattr(files, "_LARGEST_JSON", size - 1)
    with pytest.raises(ValueError, match=r"it has 0 MB, but at most 0 MB are read"):
        read_json(path)


def test_a_named_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.json")
    with pytest.raises(ValueError, match=r"it is no plain file"):
        read_json(tmp_path / "a.json")
