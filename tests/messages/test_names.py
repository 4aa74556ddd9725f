# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Types by names that may come from a bag or from another host."""

import re
import sys
from pathlib import Path

import pytest
from sensor_msgs.msg import JointState
from vgps_msgs.msg import GaussianPolicy

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.names import message_type


def test_standard_types_and_the_projects_own_are_found():
    assert message_type("sensor_msgs/msg/JointState") is JointState
    assert message_type("vgps_msgs/msg/GaussianPolicy") is GaussianPolicy


def test_a_package_that_is_no_interface_package_is_not_imported(tmp_path, monkeypatch):
    (tmp_path / "trap").mkdir()
    (tmp_path / "trap" / "__init__.py").write_text("raise RuntimeError('imported')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidInputError, match="trap/msg/Thing is not installed"):
        message_type("trap/msg/Thing")
    assert "trap" not in sys.modules


@pytest.mark.parametrize(
    "kind",
    [
        "", "/msg/", "sensor_msgs", "sensor_msgs/msg/", "sensor_msgs/msg/Nope",
        ".sensor_msgs/msg/JointState", "../sensor_msgs/msg/JointState",
        "sensor_msgs/msg/../JointState", "\0/msg/JointState", "sensor_msgs/msg/JointState.msg",
        "std_srvs/srv/Trigger",
    ],
)  # fmt: skip
def test_a_name_that_is_no_type_is_refused_with_a_sentence(kind):
    with pytest.raises(InvalidInputError, match="is not installed; build or source its package"):
        message_type(kind)


def test_comments_stand_above_the_fields_where_nested_types_show_them_as_written():
    root = Path(__file__).parents[2]
    ours = [*(root / "msg_schemas").glob("*/*")]
    definitions = [*ours, *(root / "requirements" / "interfaces").glob("*/*/*.*")]
    assert ours
    assert len(definitions) > len(ours)
    for file in definitions:
        assert not re.search(r"^[^#\n]+#", file.read_text(), re.MULTILINE), file
