# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Edits of a model: locked and removed joints, removed bodies, what only shows, masses, motors."""

import mujoco
import numpy as np
import pytest

from vgps_ros.core.errors import InvalidEntryError, InvalidInputError
from vgps_ros.simulation.model_changes import changed_spec, self_contained

ARM = """
<mujoco><compiler angle="degree"/>
  <asset><mesh name="lost" file="lost.obj"/><texture name="t" type="2d" file="lost.png"/>
    <material name="m" texture="t"/></asset>
  <worldbody><body name="base"><freejoint name="root"/><geom size=".1" material="m"/>
    <body name="upper" pos=".1 0 0" euler="0 30 0">
      <joint name="yaw" axis="1 .2 0" pos="0 0 .3"/>
      <joint name="pitch" axis="0 1 0" pos="0 0 .1" ref="10"/>
      <joint name="roll" axis="1 0 0" pos="0 .1 .1"/>
      <geom name="upper" size=".1"/>
      <geom name="paint" type="box" size=".1 .1 .1" contype="0" conaffinity="0" mass="0"/>
      <body name="lower" pos="0 0 .3"><joint name="elbow" axis="1 1 0"/>
        <inertial pos="0 0 .1" mass="2" diaginertia=".1 .1 .05"/>
        <geom name="lower" pos=".1 .1 .3" size=".1"/>MESH</body></body></body></worldbody>
  <tendon><fixed name="cable"><joint joint="pitch" coef="1"/>
    <joint joint="elbow" coef="1"/></fixed></tendon>
  <equality><joint joint1="pitch" joint2="elbow"/></equality>
  <actuator><motor name="pitch" joint="pitch"/><motor name="elbow" joint="elbow"/>
    <motor name="cable" tendon="cable"/></actuator>
  <sensor><jointpos name="angle" joint="pitch"/><actuatorfrc name="pull" actuator="cable"/></sensor>
  <keyframe><key name="k" qpos="0 0 1 1 0 0 0 .4 .1 .3 .2" ctrl="1 2 3"/></keyframe>
</mujoco>"""
SHOWN = '<geom type="mesh" mesh="lost" contype="0" conaffinity="0"/>'


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM.replace("MESH", ""))
    return tmp_path / "arm.xml"


def changed(path, **changes):
    return mujoco.MjModel.from_xml_string(
        self_contained(changed_spec(path, {"drop": ["visual"], **changes}, {}))
    )


@pytest.mark.parametrize(
    "place", ["<body", '<frame pos=".1 .2 0" euler="0 0 70"><body'], ids=["in a body", "in a frame"]
)
@pytest.mark.parametrize(
    "locked",
    [{"pitch": 0.5}, {"roll": -0.4}, {"yaw": 0.3}, {"pitch": 0.5, "roll": 0.2}, {"elbow": 0.2}],
)
def test_a_locked_joint_leaves_the_rest_as_if_it_stood_there(arm, place, locked):
    text = arm.read_text().replace('<body name="upper"', f'{place} name="upper"')
    end = "</frame>" * ("frame" in place)
    arm.write_text(text.replace("</body></body></body>", f"</body></body>{end}</body>"))
    before, after = changed(arm), changed(arm, joints={j: {"lock": at} for j, at in locked.items()})
    assert after.njnt == before.njnt - len(locked)
    assert not {after.actuator(i).name for i in range(after.nu)} & set(locked)
    data = [mujoco.MjData(model) for model in (before, after)]
    for model, each in zip((before, after), data, strict=True):
        mujoco.mj_resetDataKeyframe(model, each, 0)
    for joint, at in locked.items():
        data[0].qpos[before.joint(joint).qposadr] = at
    for model, each in zip((before, after), data, strict=True):
        mujoco.mj_kinematics(model, each)
    for one, other in zip(*(each.geom("lower").xpos for each in data), strict=True):
        assert one == pytest.approx(other, abs=1e-6)
    turns = [each.body("lower").xmat for each in data]
    np.testing.assert_allclose(*turns, atol=1e-5)


def test_removing_a_joint_or_a_body_removes_all_that_is_of_it(arm):
    model = changed(arm, joints={"pitch": {"lock": 0.0}})
    assert [model.joint(i).name for i in range(model.njnt)] == ["root", "yaw", "roll", "elbow"]
    assert (model.nu, model.ntendon, model.neq, model.nsensor) == (1, 0, 0, 0)
    assert model.key_qpos[0] == pytest.approx([0, 0, 1, 1, 0, 0, 0, 0.4, 0.3, 0.2])
    model = changed(arm, remove_bodies=["lower"])
    assert [model.body(i).name for i in range(model.nbody)] == ["world", "base", "upper"]
    assert model.nu == 1


SIX = """<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
  <joint name="z" type="slide" axis="0 0 1"/><joint name="yaw" axis="0 0 1"/>
  <joint name="tilt" axis="0 1 0"/><joint name="list" axis="1 0 0"/>"""
BASE = f"""<mujoco><compiler angle="radian"/><worldbody>
  <body name="trunk" pos="0 0 .5" euler="0 0 .4">{SIX}<geom type="box" size=".2 .1 .05"/>
    <body pos=".2 0 0"><joint name="hip" axis="0 1 0"/><geom size=".1" pos="0 0 -.3"/></body></body>
  </worldbody><actuator><motor name="hip" joint="hip"/></actuator>
  <sensor><jointpos joint="tilt"/></sensor>
  <keyframe><key qpos=".3 .2 .1 .5 -.4 .3 .6" qvel="0 0 0 0 0 0 2" ctrl="1"/></keyframe></mujoco>"""


def test_a_free_joint_in_place_of_six_moves_the_body_as_they_did(tmp_path):
    (tmp_path / "robot.xml").write_text(BASE)
    before, after = (
        changed(tmp_path / "robot.xml"),
        changed(tmp_path / "robot.xml", free_bodies=["trunk", "*nk"]),
    )
    assert [after.joint(i).name for i in range(after.njnt)] == ["trunk_free", "hip"]
    assert (after.nu, after.nsensor) == (1, 0)
    data = [mujoco.MjData(model) for model in (before, after)]
    for model, each in zip((before, after), data, strict=True):
        mujoco.mj_resetDataKeyframe(model, each, 0)
        each.ctrl[0] = 3.0
        mujoco.mj_forward(model, each)
    for measure in ("xpos", "xquat"):
        one, other = (getattr(each, measure) for each in data)
        np.testing.assert_allclose(one, other, atol=1e-5)
    assert data[0].joint("hip").qacc == pytest.approx(data[1].joint("hip").qacc, rel=1e-4)


def test_a_free_joint_is_not_locked(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><worldbody><body><freejoint name="float"/><geom size=".1"/><body>'
        '<joint name="hip"/><geom size=".1"/></body></body></worldbody></mujoco>'
    )
    with pytest.raises(InvalidInputError, match="'float' matches no hinge or slide; there are hip"):
        changed(path, joints={"float": {"lock": 0.0}})
    assert changed(path, joints={"*": {"lock": 0.0}}).njnt == 1


def test_only_a_body_in_the_world_can_be_freed(arm):
    with pytest.raises(InvalidEntryError, match="'upper' is carried by 'base'"):
        changed(arm, free_bodies=["upper"])


def test_a_camera_on_a_body_that_is_removed_looks_ahead(arm):
    """As dm_control's dog has one on its ball."""
    seen = '<camera name="on" mode="targetbody" target="lower"/><light target="lower"/><body'
    arm.write_text(arm.read_text().replace("<body", seen, 1))
    model = changed(arm, remove_bodies=["lower"])
    assert model.cam_mode[0] == int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED)


def test_a_mass_is_set_and_inertia_grows_alike(arm):
    before, after = (
        changed(arm),
        changed(arm, bodies={"lower": {"mass": 6.0}, "upper": {"mass": 1}}),
    )
    assert after.body("lower").mass == pytest.approx(6.0)
    assert after.body("upper").mass == pytest.approx(1.0, rel=1e-5)
    assert after.body("lower").inertia == pytest.approx(3.0 * before.body("lower").inertia)


def test_what_only_shows_is_dropped_and_weighs_as_before(arm):
    arm.write_text(ARM.replace("MESH", SHOWN))
    with pytest.raises(InvalidEntryError, match=r"lost\.obj.*drop: \[visual\]"):
        changed_spec(arm, {}, {})
    model = changed(arm)
    assert {model.geom(i).name for i in range(model.ngeom)} == {"base_geom", "upper", "lower"}
    assert model.body("lower").mass == pytest.approx(2.0)
    arm.write_text(
        ARM.replace("MESH", SHOWN.replace("contype", "group").replace("conaff", "gro")).replace(
            'groinity="0"', ""
        )
    )
    assert changed(arm, drop=["meshes"]).nmesh == 0


def test_motors_take_a_list_of_joints_with_one_limit(arm):
    actuators = {
        "weak": {"joint": ["yaw", "roll"], "limit": 2.0},
        "servo": {"joint": "elbow", "stiffness": 30.0, "damping": 1.0, "limit": 5.0},
    }
    model = changed(arm, remove_actuators=["*"], actuators=actuators)
    assert [model.actuator(i).name for i in range(model.nu)] == ["yaw", "roll", "servo"]
    assert model.actuator("roll").ctrlrange == pytest.approx([-2.0, 2.0])
    assert model.actuator("servo").forcerange == pytest.approx([-5.0, 5.0])
