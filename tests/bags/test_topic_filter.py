# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Topics by regular expressions."""

import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.ros_runtime.parameters import TopicFilter


def test_a_topic_is_wanted_if_a_pattern_includes_it_and_none_excludes_it():
    topics = TopicFilter(["joint", "^/clock$"], ["_command$"])
    names = ["/joint_states", "/joint_command", "/clock", "/clock_2", "/policy"]
    assert [name for name in names if topics.wants(name)] == ["/joint_states", "/clock"]


@pytest.mark.parametrize(("include", "exclude", "name"), [("(", "a", "include"), ("a", "*", "exc")])
def test_what_is_no_regular_expression_is_refused_by_name(include, exclude, name):
    with pytest.raises(InvalidInputError, match=f"^{name}.*must be a regular expression"):
        TopicFilter([include], [exclude])
