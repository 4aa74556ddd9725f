# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The layout for Foxglove names panels, topics and fields that exist."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String

from vgps_ros.messages.names import message_type
from vgps_ros.simulation.frames import ROOT
from vgps_ros.views.graph_scene import DRAWN

LAYOUT = json.loads(Path(__file__).parents[1].joinpath("config/foxglove_layout.json").read_text())
TYPES = {f"/{topic}": message_type(kind) for topic, kind in DRAWN.items()}
TYPES |= {"/diagnostics": DiagnosticArray, "/robot_description": String}


def leaves(node: Any) -> Iterator[str]:
    """Yields the panels of the tree of splits."""
    if isinstance(node, str):
        yield node
        return
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    yield from leaves(node["first"])
    yield from leaves(node["second"])


def paths(node: Any) -> Iterator[str]:
    """Yields every text that names a topic, or fields of its messages."""
    if isinstance(node, str) and node.startswith("/"):
        yield node
    elif isinstance(node, dict):
        for value in [*node, *node.values()]:
            yield from paths(value)
    elif isinstance(node, list):
        for value in node:
            yield from paths(value)


def kind_of(path: str) -> str:
    """Returns the type of a field, as `double`."""
    topic, *fields = path.split(".")
    message, kind = TYPES[topic], ""
    for field in fields:
        name, elements = re.fullmatch(r"(\w+)(\[:\])?", field).groups()
        kind = message.get_fields_and_field_types()[name]
        assert bool(elements) == kind.startswith("sequence<"), path
        if "/" in kind:
            message = type(getattr(message(), name))
    return kind


def test_every_panel_has_its_place():
    panels = list(leaves(LAYOUT["layout"]))
    assert sorted(panels) == sorted(LAYOUT["configById"])
    assert {panel.partition("!")[0] for panel in panels} == {"3D", "Plot", "DiagnosticSummary"}


def test_every_topic_and_field_exists_and_plots_show_numbers():
    named = set(paths(LAYOUT))
    assert {"/robot_description", "/diagnostics", "/joint_states.position[:]"} <= named
    for path in named:
        kind = kind_of(path)
        assert not kind or "double" in kind, path


def test_the_robot_is_seen_in_its_root_frame():
    scene = LAYOUT["configById"]["3D!robot"]
    assert {scene["fixedFrame"], scene["layers"]["grid"]["frameId"]} == {ROOT}
