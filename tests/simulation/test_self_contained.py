# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A model in one text, and positions on which nothing depends."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.simulation.robots import EVERYTHING
from vgps_ros.simulation.model import compile_model, cyclic_positions
from vgps_ros.simulation.model_changes import self_contained

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESH = """
<mujoco>
  <asset><mesh name="rock" file="rock.obj" scale=".1 .1 .2"/></asset>
  <worldbody>
    <body name="rock">
      <freejoint name="rock"/>
      <geom name="rock" type="mesh" mesh="rock" pos=".3 0 0" euler="10 20 30"/>
      <site name="top" pos="0 0 1"/>
    </body>
  </worldbody>
  <actuator><motor site="top" gear="0 0 1 0 0 0"/></actuator>
</mujoco>
"""


def test_a_mesh_stands_in_the_text_as_its_file_had_it(tmp_path):
    (tmp_path / "rock.obj").write_text(TETRAHEDRON)
    (tmp_path / "rock.xml").write_text(MESH)
    path = str(tmp_path / "rock.xml")
    expected = mujoco.MjModel.from_xml_path(path)
    found = compile_model(self_contained(mujoco.MjSpec.from_file(path)))
    for name in ("body_mass", "body_inertia", "body_ipos", "geom_pos", "mesh_vert"):
        assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("", "", [0, 1]),
        ('type="plane" size="5 5 .1"', 'type="plane" size="5 5 .1" euler="0 10 0"', [1]),
        ('type="plane" size="5 5 .1"', 'type="box" size="5 5 .1" pos="0 0 -.1"', []),
        ('<freejoint name="base"/>', '<joint name="x" type="slide" stiffness="1"/>', []),
    ],
)
def test_positions_along_a_level_floor_are_cyclic_and_no_others(old, new, expected):
    text = EVERYTHING[: EVERYTHING.index("  <tendon>")] + "</mujoco>"
    model = mujoco.MjModel.from_xml_string(text.replace(old, new) if old else text)
    assert cyclic_positions(model) == expected


@pytest.mark.parametrize(
    ("tendon", "expected"),
    [
        ('<fixed><joint joint="hip" coef="1"/><joint joint="knee" coef="-.5"/></fixed>', [0, 1]),
        ('<spatial><site site="imu"/><site site="foot"/></spatial>', [0, 1]),
        ('<spatial><site site="imu"/><site site="post"/></spatial>', []),
        ('<fixed><joint joint="x" coef="1"/><joint joint="hip" coef="1"/></fixed>', []),
    ],
)
def test_a_tendon_that_is_tied_to_the_world_leaves_no_position_cyclic(tendon, expected):
    text = EVERYTHING[: EVERYTHING.index("  <tendon>")] + f"<tendon>{tendon}</tendon></mujoco>"
    text = text.replace("<worldbody>", '<worldbody><site name="post" pos="1 0 1"/>')
    if 'joint="x"' in tendon:
        text = text.replace('<freejoint name="base"/>', '<joint name="x" type="slide"/>')
    assert cyclic_positions(mujoco.MjModel.from_xml_string(text)) == expected


def test_where_a_robot_stands_on_the_floor_does_not_change_how_it_moves(rng):
    text = EVERYTHING[: EVERYTHING.index("  <tendon>")] + "</mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    motions = []
    for offset in ([0, 0], [3.0, -2.0]):
        data = mujoco.MjData(model)
        data.qpos[:2] += offset
        data.qvel[:] = np.linspace(-1, 1, model.nv)
        mujoco.mj_step(model, data, 50)
        data.qpos[:2] -= offset
        motions.append(np.r_[data.qpos, data.qvel])
    assert cyclic_positions(model) == [0, 1]
    assert_allclose(motions[0], motions[1], atol=1e-9)
