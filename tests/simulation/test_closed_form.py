# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives in closed form, against centred differences of full steps and a readable form."""

import re

import mujoco
import numpy as np
import pytest

from tests.simulation.readable_derivatives import inverse_dynamics_rates
from tests.simulation.robots import EVERYTHING, random_states
from tests.simulation.test_differences import SERVO, centred_differences
from vgps_ros.core.records import Trajectory
from vgps_ros.simulation.compiled_mechanism import mechanism_of
from vgps_ros.simulation.dynamics import Dynamics

TENDON = r'<tendon>.*?</tendon>|<position name="pull"[^>]*/>|<tendonpos[^>]*/>'
MJCF = re.sub(TENDON, "", EVERYTHING, flags=re.DOTALL)
OPTION, GEOM, HIP = 'integrator="implicitfast"', "<geom solref", 'joint name="hip"'
MOTOR = '<motor name="hip" joint="hip"/>'
SPHERE = '<geom type="sphere" size=".1" mass="1"/>'
CAPSULE = '<geom type="capsule" size=".06 .15" mass="1"/>'
BOX = '<geom type="box" size=".1 .07 .05" mass="1"/>'
PAIR = """
<mujoco>
  <option timestep=".002" integrator="implicitfast" tolerance="1e-14" cone="{cone}"/>
  <default><geom solref=".03 1" condim="{dim}" friction="1 .02 .01"/></default>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="a"><freejoint/>{one}
      <body pos=".3 0 0">
        <joint type="slide" axis="1 .2 0"/>
        <joint name="h" axis="0 1 0" damping=".1"/>
        <joint axis="1 0 0" pos=".02 0 0"/>{one}
      </body>
    </body>
    <body name="b"><freejoint/>{two}
      <body pos="0 0 .4">
        <joint type="ball" damping=".1"/>
        <geom type="box" size=".05 .05 .05" mass=".2" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="h"/></actuator>
</mujoco>
"""


def errors_of(model, states, controls):
    """Returns the largest error of each step, relative to its largest derivative."""
    linear, steps = Dynamics(model, threads=1).linearize(Trajectory(states, controls))
    assert steps == len(controls), "no step needs differences"
    errors = []
    for t, control in enumerate(controls):
        expected = centred_differences(model, states[t], control)
        found = np.hstack([linear.f_x[t], linear.f_u[t]])
        errors.append(np.abs(found - expected).max() / np.abs(expected).max())
    return errors


@pytest.mark.parametrize(
    "changes",
    [
        (),
        (OPTION, 'integrator="Euler"'),
        (OPTION, f'{OPTION} cone="elliptic"'),
        (OPTION, f'{OPTION} cone="elliptic" impratio="5"'),
        (OPTION, f'{OPTION} jacobian="sparse"'),
        (OPTION, f'{OPTION} gravity="1 2 3"'),
        (GEOM, '<geom condim="6" friction="1 .1 .05" solref'),
        (
            f"{OPTION}",
            f'{OPTION} cone="elliptic"',
            GEOM,
            '<geom condim="6" friction=".2 .1 .05" solref',
        ),
        (GEOM, '<geom condim="1" solref'),
        (GEOM, '<geom margin=".02" gap=".005" solref'),
        ('solref="0.04 1"', 'solref="-3000 -50"'),
        (HIP, 'joint stiffness="20" springref=".3" name="hip"'),
        (HIP, 'joint limited="true" range="-3 3" name="hip"'),
        (HIP, 'joint frictionloss=".5" name="hip"'),
        (OPTION, f'{OPTION} gravity="1 2 -9"', "<body name=", '<body gravcomp=".7" name='),
        (HIP, 'joint actuatorfrcrange="-.2 .2" name="hip"'),
        (MOTOR, MOTOR.replace("/>", ' armature=".05" damping=".2" gear="3"/>')),
        (MOTOR, MOTOR.replace("/>", ' damping=".2" gear="3"/>'), OPTION, 'integrator="Euler"'),
        (MOTOR, SERVO),
        (MOTOR, SERVO, OPTION, 'integrator="Euler"'),
        ('dynprm=".05"', 'dynprm=".05" actearly="true"'),
        ('dyntype="filter"', 'dyntype="filterexact"'),
        (
            "<actuator>",
            '<equality><joint joint1="hip" joint2="knee" polycoef="0 .5 0 0 0"/></equality>'
            "<actuator>",
        ),
        (OPTION, 'integrator="Euler"', "damping=", "margin="),
    ],
)
def test_steps_of_a_legged_robot_differentiate_in_closed_form(changes, rng):
    mjcf = MJCF
    for old, new in zip(changes[::2], changes[1::2], strict=True):
        mjcf = mjcf.replace(old, new)
    model = mujoco.MjModel.from_xml_string(mjcf)
    states, controls = random_states(model, rng, 13), rng.uniform(-1, 1, (12, model.nu))
    errors = errors_of(model, states, controls)
    assert np.median(errors) < 1e-8
    assert np.quantile(errors, 0.8) < 1e-6


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize(
    ("one", "two", "dim", "is_low"),
    [
        (SPHERE, SPHERE, 3, False),
        (SPHERE, CAPSULE, 4, False),
        (CAPSULE, CAPSULE, 3, False),
        (CAPSULE, CAPSULE, 6, False),
        (BOX, SPHERE, 3, True),
        (CAPSULE, SPHERE, 6, True),
    ],
)
def test_contacts_differentiate_in_closed_form(one, two, dim, is_low, cone, rng):
    model = mujoco.MjModel.from_xml_string(PAIR.format(one=one, two=two, dim=dim, cone=cone))
    data, states = mujoco.MjData(model), []
    b = model.jnt_qposadr[model.body("b").jntadr[0]]
    while len(states) < 13:
        data.qpos = model.qpos0
        mujoco.mj_integratePos(model, data.qpos, rng.uniform(-0.5, 0.5, model.nv), 1.0)
        data.qpos[2] = rng.uniform(0.05, 0.2) if is_low else 2.0
        data.qpos[b : b + 3] = data.qpos[:3] + rng.uniform(-0.3, 0.3, 3) + (3.0 * is_low, 0, 0)
        data.qpos[b + 2] = rng.uniform(0.05, 0.2) if is_low else data.qpos[b + 2]
        mujoco.mj_forward(model, data)
        is_deep = not is_low and min(data.contact.dist, default=0.0) < -0.08
        if data.efc_force.any() and not is_deep:
            states.append(np.r_[data.qpos, rng.uniform(-1, 1, model.nv)])
    errors = errors_of(model, np.array(states), rng.uniform(-1, 1, (12, 1)))
    assert np.median(errors) < 1e-7
    assert np.quantile(errors, 0.8) < 1e-6


def test_a_step_with_a_contact_of_other_shapes_is_left_to_differences(rng):
    mjcf = PAIR.format(one=BOX, two=BOX, dim=3, cone="pyramidal")
    model = mujoco.MjModel.from_xml_string(mjcf)
    state = np.r_[model.qpos0, np.zeros(model.nv)]
    state[2], state[model.jnt_qposadr[model.body("b").jntadr[0]] + 2] = 2.0, 2.08
    states, controls = np.stack([state, state]), np.zeros((1, 1))
    linear, steps = Dynamics(model, threads=1).linearize(Trajectory(states, controls))
    assert steps > 1
    expected = centred_differences(model, state, controls[0])
    np.testing.assert_allclose(linear.f_x[0][:, model.nv :], expected[:, model.nv : -1], atol=1e-4)


def test_the_compiled_form_is_the_readable_one(rng):
    """Without constraints and damping M da = −(∂(M a + c)/∂q dq + ∂c/∂v dv)."""
    mjcf = re.sub(r'<joint name="tail"[^>]*/>', "", MJCF).replace("damping=", "margin=")
    mjcf = re.sub(
        r'<ballangvel[^>]*/>|<motor name="wag"[^>]*/>|<keyframe>.*</keyframe>',
        "",
        mjcf,
        flags=re.DOTALL,
    )
    mjcf = re.sub(r'joint="tail"', 'joint="hip"', mjcf)
    model = mujoco.MjModel.from_xml_string(mjcf.replace(OPTION, 'integrator="Euler"'))
    data, n, h = mujoco.MjData(model), model.nv, model.opt.timestep
    states, controls = random_states(model, rng, 6), rng.uniform(-1, 1, (5, model.nu))
    states[:, 2] = 5.0  # in the air
    linear, _ = Dynamics(model, threads=1).linearize(Trajectory(states, controls))
    for t, control in enumerate(controls):
        data.qpos, data.qvel, data.act = np.split(states[t], [model.nq, model.nq + n])
        data.ctrl = control
        mujoco.mj_forward(model, data)
        mass = np.empty((n, n))
        mujoco.mj_fullM(model, data, mass)
        by_position, by_velocity = inverse_dynamics_rates(model, data, data.qacc)
        rows = slice(n, 2 * n)
        expected = -h * np.linalg.solve(mass, by_position)
        np.testing.assert_allclose(linear.f_x[t, rows, :n], expected, atol=1e-11)
        expected = np.eye(n) - h * np.linalg.solve(mass, by_velocity)
        np.testing.assert_allclose(linear.f_x[t, rows, n : 2 * n], expected, atol=1e-11)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (HIP, 'joint springdamper="0 0" stiffness="1 2" name="hip"'),
        ('joint name="tail"', 'joint stiffness="1" name="tail"'),
        (HIP, 'joint actuatorgravcomp="true" name="hip"'),
        (MOTOR, '<motor name="hip" site="foot" gear="1 0 0 0 0 0"/>'),
        ("<actuator>", '<equality><weld body1="tail" body2="shin"/></equality><actuator>'),
        (OPTION, 'integrator="RK4"'),
        (OPTION, 'integrator="implicit"'),
        (OPTION, f'{OPTION} noslip_iterations="3"'),
        (OPTION, f'{OPTION} density="1000"'),
    ],
)
def test_what_has_no_closed_form_is_left_to_differences(old, new):
    model = mujoco.MjModel.from_xml_string(MJCF.replace(old, new))
    assert not mechanism_of(model, mujoco.MjData(model)).is_known
