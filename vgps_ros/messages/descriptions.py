# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The topics that describe the robot: MJCF for this project's nodes, URDF for all others."""

import io
from xml.etree import ElementTree

MJCF, URDF = "mjcf_description", "robot_description"


def is_mjcf(topic: str, text: str) -> bool:
    """Returns whether a text on one of the two topics is the robot's MJCF.

    Bags of old versions have it on `robot_description`.
    """
    if topic.rpartition("/")[2] == MJCF:
        return True
    try:
        _, root = next(ElementTree.iterparse(io.StringIO(text), ("start",)))
    except (ElementTree.ParseError, StopIteration):
        return False
    return root.tag == "mujoco"
