# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The URDF of any robot, as an independent reader has it: kinematics, names, shapes, limits."""

from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.motors import robot
from tests.simulation.robots import everything
from tests.simulation.urdf_kinematics import largest_difference, read
from vgps_ros.simulation.frames import ROOT, MovingLinks, body_joints, frame_names, links
from vgps_ros.simulation.urdf import urdf
from vgps_ros.tasks import BUILT_IN, make_task

ODD = """
<mujoco>
  <asset><mesh name="tetra" vertex="0 0 0  .1 0 0  0 .2 0  0 0 .3"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="odom" pos="1 2 3" euler="0 90 0">
      <joint name="a" axis="1 1 0" pos=".1 0 .2" ref="30" range="-10 100"/>
      <joint name="b" type="slide" axis="0 1 0" ref=".3" damping="2" frictionloss="3"/>
      <joint name="c" axis="0 0 1" pos=".3 .1 0" ref="20" actuatorfrcrange="-5 7"/>
      <geom name="capsule" type="capsule" size=".1 .2" pos="0 1 0" euler="90 0 0"/>
      <body euler="10 20 90">
        <joint type="ball" pos=".1 .2 .3"/>
        <geom name="egg" type="ellipsoid" size=".1 .2 .3"/>
        <body name="tip" pos="0 0 1">
          <geom name="rock" type="mesh" mesh="tetra" rgba="1 0 0 1"/>
          <geom name="shadow" size=".1" group="3"/>
          <geom name="paint" size=".1" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
    <body><freejoint name="second"/><geom size=".1"/></body>
    <body name="third"><freejoint/><geom size=".1"/></body>
  </worldbody>
</mujoco>
"""


def odd() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ODD)


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_kinematics_of_each_built_in_robot_are_mujocos(name, rng):
    assert largest_difference(make_task(name).dynamics.model, rng) < 1e-12


@pytest.mark.parametrize("model", [everything, odd])
def test_free_bodies_balls_and_several_joints_about_points_of_a_body_are_too(model, rng):
    assert largest_difference(model(), rng) < 1e-12


def test_every_frame_has_a_name_of_its_own():
    model = odd()
    assert frame_names(model) == [ROOT, "odom_", "body_2", "tip", "second", "third"]
    names = [link.name for link in links(model)]
    assert len({ROOT, *names}) == len(names) + 1
    bases = [joint.name for joint in body_joints(model) if joint.is_free]
    assert bases == ["second", "third"]  # so that each child frame of odom is a link
    assert set(read(model).link_map) == {ROOT, *names}


def test_a_model_without_bodies_is_a_link():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='.1'/></worldbody></mujoco>"
    )
    assert list(read(model).link_map) == [ROOT]
    assert [len(part) for part in MovingLinks(model).poses(np.empty(0))] == [0, 0]


def test_joints_have_their_limits():
    joints = read(odd()).joint_map
    assert [joints[name].type for name in "abc"] == ["revolute", "prismatic", "continuous"]
    assert_allclose([joints["a"].limit.lower, joints["a"].limit.upper], np.radians([-10, 100]))
    assert (joints["b"].dynamics.damping, joints["b"].dynamics.friction) == ("2.0", "3.0")
    assert joints["c"].limit.effort == 7.0


def interfaces(model: mujoco.MjModel) -> dict[str, tuple[dict[str, list[float]], list[str]]]:
    """What each joint in <ros2_control> takes, with the least and the most, and what it tells."""
    (system,) = ElementTree.fromstring(urdf(model)).findall("ros2_control")
    assert system.get("type") == "system"
    topics = {each.get("name"): each.text for each in system.findall("hardware/param")}
    assert topics == {"joint_commands_topic": "joint_command", "joint_states_topic": "joint_states"}
    return {
        joint.get("name"): (
            {
                taken.get("name"): [float(each.text) for each in taken.findall("param")]
                for taken in joint.findall("command_interface")
            },
            [told.get("name") for told in joint.findall("state_interface")],
        )
        for joint in system.findall("joint")
    }


def test_ros2_control_has_each_joints_interfaces_with_their_limits():
    driven = robot(
        '<motor joint="{}" gear="-50" ctrlrange="-.1 .2" ctrllimited="true"/>',
        '<position joint="{}" kp="60" kv="4" ctrlrange="-1 2" ctrllimited="true"/>',
        '<velocity joint="{}" kv="5"/>',
        '<muscle joint="{}" lengthrange="0 1"/>',
    )
    told = ["position", "velocity", "effort"]
    commands = [{"effort": [-10.0, 5.0]}, {"position": [-1.0, 2.0]}, {"velocity": []}, {}]
    assert list(interfaces(driven).values()) == [(taken, told) for taken in commands]
    assert interfaces(odd()) == {name: ({}, told) for name in "abc"}
    for name in BUILT_IN:
        task = make_task(name)
        found = interfaces(task.dynamics.model)
        assert list(found) == task.joint_names
        assert {each for each in found if found[each][0]} == set(task.controls.names)


def test_masses_and_moments_of_inertia_are_the_models():
    model, robot = everything(), read(everything())
    for body in range(1, model.nbody):
        inertial = robot.link_map[model.body(body).name].inertial
        assert inertial.mass == model.body_mass[body]
        assert_allclose(np.diag(inertial.inertia), model.body_inertia[body], rtol=1e-15)
        assert_allclose(inertial.origin[:3, 3], model.body_ipos[body])
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, model.body_iquat[body])
        assert_allclose(inertial.origin[:3, :3].ravel(), turned, atol=1e-12)


def test_shapes_stand_where_mujocos_do():
    robot = read(odd())
    tube, *ends = robot.link_map["odom_"].visuals
    assert (tube.geometry.cylinder.radius, tube.geometry.cylinder.length) == (0.1, 0.4)
    assert_allclose([end.origin[:3, 3] for end in ends], [[0, 0.8, 0], [0, 1.2, 0]], atol=1e-15)
    assert [end.geometry.sphere.radius for end in ends] == [0.1, 0.1]
    (egg,) = robot.link_map["body_2"].visuals
    assert_allclose(egg.geometry.box.size, [0.2, 0.4, 0.6])
    tip = robot.link_map["tip"]
    rock, paint = tip.visuals
    assert_allclose(np.abs(rock.origin[:3, :3] @ rock.geometry.box.size), [0.1, 0.2, 0.3], atol=0.2)
    assert_allclose(rock.material.color.rgba, [1, 0, 0, 1])
    assert paint.geometry.sphere.radius == 0.1
    assert len(tip.collisions) == 2  # the rock and what MuJoCo's viewer hides
    assert robot.link_map[ROOT].visuals == []  # a plane is no shape of URDF
