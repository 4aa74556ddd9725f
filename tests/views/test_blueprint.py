# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The layout of a recording: the lines that stand for the floor lie where the floor is."""

import mujoco
import numpy as np
import pytest

from vgps_ros.tasks import make_task
from vgps_ros.views.blueprint import ground
from vgps_ros.views.robot_shape import RobotShape

SLOPE = """
<mujoco>
  <worldbody>
    <geom type="plane" size="0 0 1" pos="0 0 0.5" euler="0 30 0"/>
    <body pos="0 0 3"><freejoint/><geom size="0.1"/></body>
  </worldbody>
</mujoco>
"""


def plane(model):
    """Returns the unit normal and the distance d of the plane of the lines: normal · p = d."""
    (found,) = ground(model, RobotShape(model)).plane.as_arrow_array().to_pylist()
    return np.array(found[:3]), found[3]


@pytest.mark.parametrize("task", ["quadruped", "walker"])
def test_the_lines_lie_on_the_floor(task):
    normal, distance = plane(make_task(task).dynamics.model)
    np.testing.assert_array_equal(normal, [0.0, 0.0, 1.0])
    assert distance == 0.0


def test_the_lines_lie_on_a_slope_that_is_not_at_the_origin():
    normal, distance = plane(mujoco.MjModel.from_xml_string(SLOPE))
    np.testing.assert_allclose(normal, [0.5, 0.0, np.sqrt(0.75)], rtol=1e-6)
    assert distance == pytest.approx(0.5 * np.sqrt(0.75))


def test_the_lines_lie_below_a_robot_that_moves_in_a_horizontal_plane():
    normal, distance = plane(make_task("swimmer").dynamics.model)
    assert normal[2] == 1.0
    assert distance < -0.1  # the swimmer's limbs are at height zero
