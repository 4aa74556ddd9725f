# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files appear in one piece, or not at all."""

import os
from pathlib import Path
from socket import AF_UNIX, socket

import pytest

from vgps_ros.bags.metadata import check_digests
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.deployment_file import read_deployment
from vgps_ros.policies.foreign import read_contract, read_leapp
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.storage.files import (
    part_of,
    read_archive,
    read_file,
    read_json,
    replacing,
    write_json,
)
from vgps_ros.storage.run_folder import load_distributions
from vgps_ros.tasks import make_task
from vgps_ros.tasks.course import course_of
from vgps_ros.tasks.motion_table import load_demonstration


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


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, [1.5, None])
    size = path.stat().st_size
    assert read_file(path, size) == path.read_bytes()
    with pytest.raises(OSError, match=r"it has 0 MB, and at most 0 MB are read"):
        read_file(path, size - 1)
    with path.open("wb") as file:
        file.truncate(1 << 40)  # of which the disk holds nothing
    with pytest.raises(OSError, match=r"it has 1099512 MB, and at most 268 MB are read"):
        read_json(path)


ROTOR = make_task("rotor")
READERS = {
    "json": read_json,
    "archive": read_archive,
    "policy": open_policy,
    "network": lambda path: open_policy(path.rename(path.with_suffix(".onnx"))),
    "deployment": read_deployment,
    "distributions": load_distributions,
    "contract": lambda path: read_contract(path, ["rotor"]),
    "bundle": lambda path: read_leapp(path, ["rotor"], [0.0]),
    "motion": lambda path: load_demonstration(ROTOR, path),
    "course": lambda path: course_of(str(path)),
    "task": lambda path: make_task(str(path.rename(path.with_suffix(".yaml")))),
    "digests": lambda path: check_digests(path.rename(path.with_name("SHA256SUMS")).parent),
}


@pytest.mark.parametrize("kind", ["pipe", "/dev/zero", "/dev/full", "folder", "socket"])
@pytest.mark.parametrize("reader", READERS)
def test_only_plain_files_are_read(tmp_path, monkeypatch, reader, kind):
    """A pipe would be waited for, a device never ends."""
    monkeypatch.chdir(tmp_path)
    path = Path("a")
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "socket":
        socket(AF_UNIX).bind(str(path))
    else:
        path.symlink_to(kind)
    with pytest.raises((OSError, InvalidInputError), match="a") as refused:
        READERS[reader](path)
    is_known = any(
        sentence in str(refused.value)
        for sentence in ("it is no plain file", "There is no file", "Is a directory", "No such dev")
    )
    assert is_known, refused.value
