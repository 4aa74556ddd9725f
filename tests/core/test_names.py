# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Names that are found by patterns, and refusals that list the names that there are."""

import pytest

from vgps_ros.core.checks import known, listed, matching
from vgps_ros.core.errors import InvalidInputError

JOINTS = ("left_hip", "left_knee", "right_hip", "left_*")


def test_a_pattern_finds_all_that_match_in_their_order_and_a_name_itself_alone():
    assert matching("joint", "*_hip", JOINTS) == ["left_hip", "right_hip"]
    assert matching("joint", "[lr]*t_k?ee", JOINTS) == ["left_knee"]
    assert matching("joint", "left_*", JOINTS) == ["left_*"]
    assert matching("joint", "*", ()) == []


def test_what_matches_nothing_is_refused_with_the_names_and_the_nearest():
    with pytest.raises(InvalidInputError) as refusal:
        matching("joint", "left_nee", JOINTS)
    assert str(refusal.value) == (
        "'left_nee' matches no joint; there are left_hip, left_knee, right_hip, left_*. Did you "
        "mean 'left_knee'?"
    )
    assert known("joint", "left_hip", JOINTS) == "left_hip"
    with pytest.raises(InvalidInputError, match=r"there is no joint 'wheel'; there are left_hip"):
        known("joint", "wheel", JOINTS)


def test_many_names_are_listed_in_part_and_none_as_none():
    assert listed([f"n{i}" for i in range(14)]).endswith(", n11 and others")
    assert listed([f"n{i}" for i in range(12)]).endswith(", n11")
    assert listed(()) == "none"
