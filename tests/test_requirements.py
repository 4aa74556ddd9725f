# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The lock with hashes holds the versions that `make setup` installs."""

import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "requirements"
LOCKED = (FOLDER / "locked" / "setup.txt").read_text()
PINS = re.compile(r"^([\w.-]+)(?:\[\w+\])?==([\w.]+)", re.M)


def name_of(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()


def pins(text: str) -> set[tuple[str, str]]:
    return {(name_of(package), version) for package, version in PINS.findall(text)}


def pinned(file: str) -> set[tuple[str, str]]:
    text = (FOLDER / file).read_text()
    others = re.findall(r"^-r (\S+)", text, re.M)
    return pins(text).union(*map(pinned, others))


@pytest.mark.parametrize("file", ["runtime.txt", "dev.txt", "build_tools.txt", "ros_wheels.txt"])
def test_the_lock_holds_each_pinned_version(file):
    lacking = pinned(file) - pins(LOCKED)
    assert not lacking, "run scripts/lock_requirements.bash"


def test_each_locked_version_has_a_hash():
    entries = re.split(r"\n(?=\S)", LOCKED.strip())
    assert len(entries) > 200
    assert all("--hash=sha256:" in entry for entry in entries)


def test_each_package_of_the_run_time_is_justified():
    table = (FOLDER / "README.md").read_text()
    for package, _ in pinned("runtime.txt"):
        assert re.search(rf"^\| .*\b{re.escape(package)}\b.* \|", table, re.M), package
