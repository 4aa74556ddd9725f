# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Robots whose truth is known are found again, within what the fit says of its own errors."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.search.identification import MeasuredMotion, identify
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import compile_model

PERIOD, STEPS = 0.02, 2
ARM = """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <default>
    <joint axis="0 1 0" damping="{damping}" armature="{armature}" frictionloss="{friction}"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="upper"><joint name="shoulder"/><geom mass="1"/>
      <body name="lower" pos="0 0 -.3"><joint name="elbow"/><geom mass="{mass}"/></body></body>
  </worldbody>
  <actuator>
    <position joint="shoulder" kp="{gain}" kv="{kv}" forcerange="-{most} {most}"/>
    <position joint="elbow" kp="{gain}" kv="{kv}" forcerange="-{most} {most}"/>
  </actuator>
</mujoco>"""
KNOWN = {
    "damping": 0.5,
    "armature": 0.05,
    "friction": 0,
    "mass": 1.0,
    "gain": 40,
    "kv": 1.0,
    "most": 30,
}
# A trunk on four sprung legs, which only an IMU and encoders measure.
LEG = """<body pos="{x} {y} 0"><joint name="{name}" axis="0 1 0"/>
  <geom fromto="0 0 0 {x} 0 -.15" mass=".3"/>
  <geom type="sphere" pos="{x} 0 -.15" size=".03" mass=".05" contype="1"/></body>"""
STOOL = (
    """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <default><joint damping="{damping}" armature=".03"/><geom type="capsule" size=".02" contype="0"
    conaffinity="0" solref=".04 1" solimp="0 .95 .02 .5 2"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" conaffinity="1"/>
    <body name="trunk" pos="0 0 .17"><freejoint name="root"/>
      <geom type="box" size=".2 .15 .05" mass="{mass}"/>"""
    + "".join(
        LEG.format(x=x, y=y, name=f"leg{i}")
        for i, (x, y) in enumerate([(0.15, 0.15), (0.15, -0.15), (-0.15, 0.15), (-0.15, -0.15)])
    )
    + "</body></worldbody><actuator>"
    + "".join(f'<position joint="leg{i}" kp="30" kv="1" forcerange="-30 30"/>' for i in range(4))
    + "</actuator></mujoco>"
)


def task_of(mjcf):
    dynamics = Dynamics(compile_model(mjcf), STEPS)
    return SimpleNamespace(name="robot", mjcf=mjcf, dynamics=dynamics, controls=dynamics.controls)


def moved(mjcf, rng, *, seconds=9.0, size=0.8, latency=0.0, mount=(0.0, 0.0, 0.0), blind=False):
    """What a robot with noisy sensors measures under sines that its controller sends."""
    m = compile_model(mjcf)
    data, layout, mount = mujoco.MjData(m), state_layout(m), Rotation.from_rotvec(mount)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    rates, leads = rng.uniform(1.0, 12.0, (3, m.nu)), rng.uniform(0.0, 6.0, (3, m.nu))
    controls = size / 3 * np.sin(time[:, None, None] * rates + leads).sum(axis=1)
    joints, states = layout.joint_places.reshape(2, -1), []
    for k in range(len(time)):
        x = np.r_[data.qpos, data.qvel]
        for part, std in zip(joints, (0.002, 0.05), strict=True):
            x[part] += std * rng.standard_normal(len(part))
        if blind:
            place, q, velocity, rate = layout.base.parts(x)
            place[:], velocity[:] = 0.0, 0.0
            shake = Rotation.from_rotvec(0.005 * rng.standard_normal(3))
            turned = Rotation.from_quat(q, scalar_first=True) * mount * shake
            q[:] = turned.as_quat(scalar_first=True)
            rate[:] = rate @ mount.as_matrix() + 0.02 * rng.standard_normal(3)
        states.append(x)
        for j in range(STEPS):
            late = int(np.floor(k + (j + 1e-6) / STEPS - latency / PERIOD))
            data.ctrl[:] = controls[max(late, 0)]
            mujoco.mj_step(m, data)
    return MeasuredMotion(time, np.array(states), time, controls, blind)


def test_what_differs_of_an_arm_is_found_within_its_uncertainty(rng):
    true = {"damping": 0.8, "armature": 0.08, "friction": 0.3, "mass": 1.4, "gain": 32, "kv": 0.8}
    motion = moved(ARM.format(**KNOWN | true), rng, latency=0.01)
    found = identify(task_of(ARM.format(**KNOWN)), [motion], "lower").parameters
    expected = {
        "damping": 0.8, "armature": 0.08, "friction_loss": 0.3, "gain": 32, "mass": 1.4,
        "latency": 0.01,
    }  # fmt: skip
    for name, value in expected.items():
        assert found[name].is_told, name
        assert abs(found[name].value - value) < 5.0 * found[name].std + 0.03 * value, name
    # No servo came near its limit, of which the motion then says nothing.
    assert not found["strength"].is_told
    assert found["strength"].value == 30.0


def test_a_limit_that_is_reached_is_found_and_drawn_from(rng):
    motion = moved(ARM.format(**KNOWN | {"most": 8}), rng, size=2.5)
    found = identify(task_of(ARM.format(**KNOWN)), [motion])
    assert found.parameters["strength"].value == pytest.approx(8.0, rel=0.05)
    highest, loss = found.model.actuator_forcerange[0, 1], found.ranges["disturb.strength"]
    assert (1.0 - loss) * highest < 8.0 < highest


def test_the_ranges_hold_the_truth_and_predictions_improve(rng):
    true = KNOWN | {"damping": 0.7, "armature": 0.07, "friction": 0.2, "gain": 34, "kv": 0.85}
    found = identify(task_of(ARM.format(**KNOWN)), [moved(ARM.format(**true), rng)], "lower")
    m, joints, gain = found.model, 1 + found.ranges["disturb.joints"], found.ranges["disturb.gain"]
    for low, high, value in (
        (m.dof_damping[0] / joints, m.dof_damping[0] * joints, 0.7),
        (m.dof_armature[0] / joints, m.dof_armature[0] * joints, 0.07),
        (m.actuator_gainprm[0, 0] / (1 + gain), m.actuator_gainprm[0, 0] * (1 + gain), 34),
        (m.dof_frictionloss[0], m.dof_frictionloss[0] + found.ranges["disturb.friction_loss"], 0.2),
        (m.body("lower").mass[0], m.body("lower").mass[0] + found.ranges["disturb.payload"], 1.0),
    ):
        assert low < value < high
    (before, _), (after, _) = found.errors
    assert after < 0.5 * before


def test_a_base_that_nobody_measures_is_estimated_and_the_imu_found_turned(rng):
    mount = (0.05, -0.08, 0.04)
    true = moved(
        STOOL.format(damping=1.2, mass=6.0), rng, seconds=5.0, size=0.3, mount=mount, blind=True
    )
    found = identify(task_of(STOOL.format(damping=0.8, mass=4.5)), [true]).parameters
    assert found["damping"].value == pytest.approx(1.2, rel=0.1)
    assert found["mass"].value == pytest.approx(6.0, rel=0.1)
    for name, angle in zip(("imu_roll", "imu_pitch"), mount, strict=False):
        assert found[name].value == pytest.approx(angle, abs=0.015)


def test_windows_in_which_something_else_moved_the_robot_are_left_out(rng):
    motion = moved(ARM.format(**KNOWN), rng)
    states = motion.states.copy()
    states[150:170, 2:] += 4.0 * np.sin(np.arange(20))[:, None]
    found = identify(task_of(ARM.format(**KNOWN)), [replace(motion, states=states)])
    assert found.windows[2] in (1, 2)
    assert found.parameters["gain"].value == pytest.approx(40.0, rel=0.03)


def test_a_short_motion_of_other_stamps_joins_a_long_one(rng):
    motion = moved(ARM.format(**KNOWN), rng, seconds=4.0)
    part, seldom = slice(0, 40), slice(40, 80, 2)
    short = [
        MeasuredMotion(motion.time[i], motion.states[i], motion.time, motion.controls, False)
        for i in (part, seldom)
    ]
    found = identify(task_of(ARM.format(**KNOWN)), [motion, *short])
    assert sum(found.windows) == 12 + 1  # a window begins .15 s after the first command at least


def test_a_motion_that_is_too_short_or_has_gaps_is_refused(rng):
    motion, task = moved(ARM.format(**KNOWN), rng, seconds=2.0), task_of(ARM.format(**KNOWN))
    with pytest.raises(InvalidInputError, match="at least 8 are needed; record some 10 s"):
        identify(task, [motion])
    kept = np.arange(len(motion.time)) % 10 < 8
    gaps = replace(motion, time=motion.time[kept], states=motion.states[kept])
    with pytest.raises(InvalidInputError, match="has 0 stretches"):
        identify(task, [gaps])
