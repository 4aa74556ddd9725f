# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Robots that are alike but for their size get the same task in their own units."""

import mujoco
import numpy as np
import pytest

from tests.tasks.solving import solved
from vgps_ros.programs.__main__ import main
from vgps_ros.tasks import make_task
from vgps_ros.wizard.legged_scale import legged_numbers, servo_reach
from vgps_ros.wizard.recognition import recognise_robot

FOUR = {"front_left": (1, 1), "front_right": (1, -1), "hind_left": (-1, 1), "hind_right": (-1, -1)}
TWO = {"left": (0, 1), "right": (0, -1)}


def robot(legs: dict[str, tuple[int, int]], s: float) -> str:
    """Returns an MJCF of which each length is s times as large, and all else by Froude's law."""
    force, rate = s**4, s**4.5  # [N m], [N m s]
    joint = f'damping="{0.5 * rate}" armature="{0.01 * s**5}"'
    turned = f"{8e-4 * s**5}"
    bodies, motors = "", ""
    for name, (x, y) in legs.items():
        bodies += f"""
        <body name="{name}_hip" pos="{0.18 * x * s} {0.06 * y * s} 0">
          <joint name="{name}_hip" axis="1 0 0" range="-.8 .8" {joint}/>
          <inertial pos="0 0 0" mass="{0.5 * s**3}" diaginertia="{turned} {turned} {turned}"/>
          <body name="{name}_thigh" pos="0 {0.05 * y * s} 0">
            <joint name="{name}_thigh" axis="0 1 0" range="-1 3" {joint}/>
            <geom type="capsule" fromto="0 0 0 0 0 {-0.18 * s}" size="{0.02 * s}"
                  mass="{0.8 * s**3}" contype="0" conaffinity="0"/>
            <body name="{name}_calf" pos="0 0 {-0.18 * s}">
              <joint name="{name}_calf" axis="0 1 0" range="-2.6 -.3" {joint}/>
              <geom type="capsule" fromto="0 0 0 0 0 {-0.18 * s}" size="{0.015 * s}"
                    mass="{0.2 * s**3}" contype="0" conaffinity="0"/>
              <geom name="{name}_foot" pos="0 0 {-0.18 * s}" size="{0.022 * s}"
                    mass="{0.05 * s**3}"/></body></body></body>"""
        for part in ("hip", "thigh", "calf"):
            joint_of = f"{name}_{part}"
            limits = f'ctrlrange="{-30 * force} {30 * force}"'
            motors += f'<motor name="{joint_of}" joint="{joint_of}" {limits}/>'
    pose = " ".join(len(legs) * ["0 .75 -1.5"])
    return f"""<mujoco><compiler angle="radian" autolimits="true"/>
    <option timestep="{0.005 * s**0.5}"/>
    <worldbody><geom name="floor" type="plane" size="0 0 1"/>
      <body name="trunk" pos="0 0 {0.3 * s}"><freejoint name="root"/>
        <geom type="box" size="{0.2 * s} {0.1 * s} {0.05 * s}" mass="{6 * s**3}" contype="0"
              conaffinity="0"/>{bodies}</body></worldbody>
    <actuator>{motors}</actuator>
    <keyframe><key name="stand" qpos="0 0 {0.29 * s} 1 0 0 0 {pose}"/></keyframe></mujoco>"""


@pytest.mark.parametrize("legs", [FOUR, TWO], ids=["four", "two"])
@pytest.mark.parametrize("size", [0.25, 0.5, 2.0, 4.0])
def test_the_numbers_of_a_task_are_the_same_in_the_robots_own_units(legs, size):
    one, other = (
        legged_numbers(recognise_robot(mujoco.MjModel.from_xml_string(robot(legs, s))))
        for s in (1.0, size)
    )
    time = size**0.5
    powers = {  # of time, of each number of the file
        **dict.fromkeys(("step", "period", "horizon", "lookahead", "motion", "selection"), 1),
        **dict.fromkeys(("soft", "soft_limit", "fall_lead"), 1),
        **dict.fromkeys(("contact_width", "swing"), 2),
        **dict.fromkeys(("ahead", "aside", "width"), 1),
        **dict.fromkeys(("about", "rate"), -1),
        "push": 7,
        **dict.fromkeys(("turning", "regularization"), 2),
        "tracking": -1,
        "slip": -2,
        **dict.fromkeys(("lifts", "stepping"), -4),
        **dict.fromkeys(("steadies", "iterations", "solves", "new_solves"), 0),
    }
    assert {*powers} == {*one} - {"std", "std_limit", "sensor_noise"}
    for name, power in powers.items():
        on_a_grid = power == 1 and name in ("step", "period", "horizon", "lookahead")
        near = 0.05 if on_a_grid or name in ("motion", "selection") else 1e-3
        wanted = np.multiply(one[name], time**power)
        assert other[name] == pytest.approx(wanted, rel=near), name
    for name in ("std", "std_limit"):
        assert other[name]["position"] == one[name]["position"]
        assert other[name]["velocity"] == pytest.approx(one[name]["velocity"] / time)
        places, speeds = (
            [spread[name]["overrides"][f"root/{part}"] for spread in (one, other)]
            for part in ("[xyz]", "v[xyz]")
        )
        assert places[1] == pytest.approx(places[0] * size, rel=1e-3)
        assert speeds[1] == pytest.approx(speeds[0] * time, rel=1e-3)


def test_a_small_robot_pays_for_its_motion_what_a_large_one_does(tmp_path, monkeypatch):
    """The control period is rounded, so that costs agree to some percent."""
    monkeypatch.chdir(tmp_path)
    found = []
    for size in (0.25, 1.0, 4.0):
        (tmp_path / "robot.xml").write_text(robot(FOUR, size))
        main(["new", "mine", "--model", "robot.xml", "--servos", "--overwrite"])
        result = solved(make_task("mine"), 20)
        first = result.iterations[0]
        found.append([first.cost + first.cost_reduction, result.modified_cost])
    for size, costs in enumerate(found):
        assert costs == pytest.approx(found[1], rel=0.15), size
    assert found[1][1] < 0.5 * found[1][0]


def test_a_soft_servo_leads_by_its_load_and_a_stiff_one_by_a_stride():
    four, two = (
        recognise_robot(mujoco.MjModel.from_xml_string(robot(legs, 1.0))) for legs in (FOUR, TWO)
    )
    assert servo_reach(four, 10.0, 0.0, 9.0) == pytest.approx(0.9)  # 9 N m of 10 N m/rad
    assert servo_reach(two, 10.0, 0.0, 9.0) == pytest.approx(1.8)  # one leg carries all
    assert servo_reach(two, 1.0, 0.0, 9.0) == np.pi
    stride = servo_reach(four, 1e4, 0.0, 9.0)
    assert stride == servo_reach(two, 1e4, 0.0, 9.0) == servo_reach(four, 1e6, 0.0, 9.0)
    assert servo_reach(four, 1e4, 1e3, 9.0) > stride  # a damped servo lags
