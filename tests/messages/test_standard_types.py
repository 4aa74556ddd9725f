# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Interface packages of ROS that set-up builds where the installation lacks them."""

import json
from pathlib import Path

import pytest
from ament_index_python import get_package_share_directory
from catkin_pkg.package import parse_package

ROOT = Path(__file__).parents[2]
# Hashes of types of simulation_interfaces 1.5.1 and geometry2 0.36, which Jazzy has. DDS lets
# a server and a client talk only if they agree.
HASHES = json.loads((Path(__file__).parent / "standard_types.json").read_text())


@pytest.mark.parametrize("name", HASHES)
def test_a_type_has_the_hash_of_the_standard(name):
    package, _, type_of_package = name.partition("/")
    file = Path(get_package_share_directory(package)) / f"{type_of_package}.json"
    hashes = {h["type_name"]: h["hash_string"] for h in json.loads(file.read_text())["type_hashes"]}
    assert hashes[name] == HASHES[name]


def test_the_package_depends_on_each_interface_package_that_set_up_may_build():
    folders = {folder.name: folder for folder in (ROOT / "requirements" / "interfaces").iterdir()}
    assert {parse_package(folder).name for folder in folders.values()} == folders.keys()
    assert folders.keys() <= {depend.name for depend in parse_package(ROOT).exec_depends}
    assert folders.keys() == {name.partition("/")[0] for name in HASHES}
