# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""How names say what is left and what is right."""

import pytest

from vgps_ros.tasks.builder import swap_parts


@pytest.mark.parametrize(
    ("name", "pair", "image"),
    [
        ("front_left_foot/x", ("left", "right"), "front_right_foot/x"),
        ("leftThigh", ("left", "right"), "rightThigh"),
        ("l_hip", ("l", "r"), "r_hip"),
        ("ankle_r/position", ("l", "r"), "ankle_l/position"),
        ("torso", ("l", "r"), "torso"),
        ("pelvis_l", ("l", "r"), "pelvis_r"),
        ("lThigh", ("l", "r"), "rThigh"),
        ("HipL", ("L", "R"), "HipR"),
        ("Left", ("L", "R"), "Left"),
        ("FR_calf", ("FL", "FR"), "FL_calf"),
        ("leg2/velocity", ("1", "2"), "leg1/velocity"),
        ("leg12/velocity", ("1", "2"), "leg12/velocity"),
        ("left_x", ("left", "left_x"), "left"),
    ],
)
def test_parts_of_a_name_are_exchanged_and_back(name, pair, image):
    assert swap_parts(name, [pair]) == image
    assert swap_parts(image, [pair]) == name


def test_several_pairs_are_exchanged_one_after_another():
    assert swap_parts("l_front", [("l", "r"), ("front", "hind")]) == "r_hind"
