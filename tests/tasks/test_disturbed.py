# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Disturbances of a task, against the laws of mechanics and against differences."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks import make_task
from vgps_ros.tasks.disturbance import Disturbance, DisturbanceSettings
from vgps_ros.tasks.disturbed_task import can_slide_on_ground, disturb_task, draw_disturbance

# A sled of 2 kg on the floor that carries an arm of 1 kg; nothing but the floor brakes it.
SLED = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast" cone="elliptic"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" friction="0.2"/>
    <body name="sled" pos="0 0 0.1">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom name="sled" type="box" size="0.3 0.3 0.1" mass="2" friction="0.2"/>
      <body name="arm" pos="0 0 0.5">
        <joint name="arm" type="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.02" mass="1" contype="0"
          conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <sensor><subtreelinvel name="velocity" body="sled"/></sensor>
  <actuator><motor name="x" joint="x"/></actuator>
</mujoco>
"""
TASK = """
model: sled.xml
control_period: 0.01
horizon: 1.0
changes: {option: {gravity: GRAVITY}, joints: {arm: {damping: DAMPING}}}
cost: [{sensor: x/velocity}, {control: all, weight: 1.0}]
fallen: [{sensor: x/velocity, beyond: 1.0}]
"""


@pytest.fixture
def sled(tmp_path):
    def made(gravity="[0, 0, -9.81]", damping=1e6, mjcf=SLED):
        """With so much damping the arm stands as if it were welded on."""
        (tmp_path / "sled.xml").write_text(mjcf)
        text = TASK.replace("GRAVITY", gravity).replace("DAMPING", str(damping))
        (tmp_path / "task.yaml").write_text(text)
        return make_task(str(tmp_path))

    return made


def coasted(task, disturbance, steps=100):
    """Returns the states of the sled without control."""
    here = disturb_task(task, disturbance)
    return here.dynamics.rollout(task.initial_state, lambda *_: np.zeros(1), steps).states


def test_a_push_gives_its_impulse_to_the_whole_robot_and_no_sooner(sled):
    task = sled(gravity="[0, 0, 0]", damping=0.0)
    push = Disturbance("arm", push=(-3.0, 0.0), push_time=0.4, push_duration=0.1)
    states = coasted(task, push)
    momentum = 3.0 * Readings(task.dynamics.simulations, ["velocity/x"])(states)[:, 0]
    np.testing.assert_array_equal(momentum[:41], 0.0)
    np.testing.assert_allclose(momentum[45], -1.5, rtol=1e-2)
    np.testing.assert_allclose(momentum[50], -3.0, rtol=1e-2)
    assert abs(states[-1, 5]) > 0.1  # it was the arm that was pushed, so it turns


def test_a_push_copies_no_model_and_the_same_simulations_go_on_without_it(sled):
    task, push = sled(), Disturbance(push=(-3.0, 0.0), push_time=0.0, push_duration=2.0)
    calm = coasted(task, Disturbance())
    pushed = coasted(task, push)
    assert disturb_task(task, push).dynamics.model is task.dynamics.model
    assert not np.array_equal(pushed, calm)
    np.testing.assert_array_equal(coasted(task, Disturbance()), calm)
    np.testing.assert_array_equal(coasted(task, push), pushed)


def test_a_sled_on_a_slope_slides_as_coulomb_says(sled):
    task = sled()
    for slope, factor in ((0.4, 1.0), (-0.4, 0.5)):
        found = coasted(task, Disturbance(slope=(slope, 0.0), friction=factor))
        friction = 0.2 * factor * np.cos(slope)
        expected = -9.81 * (np.sin(slope) - np.sign(slope) * friction)
        assert found[20, 3] == pytest.approx(0.2 * expected, rel=0.05)


def test_joints_with_other_damping_and_armature_move_as_their_inertia_says(sled):
    """A slide's armature is mass that its joint moves, and damping c brakes mass m by e^(−ct/m)."""
    mjcf = SLED.replace('axis="1 0 0"/>', 'axis="1 0 0" damping="2" armature="1"/>', 1)
    task = sled(gravity="[0, 0, 0]", mjcf=mjcf)
    start = task.initial_state.copy()
    start[3] = 1.0
    for damping, armature in ((1.0, 1.0), (0.5, 1.0), (2.0, 1.0), (1.0, 3.0)):
        here = disturb_task(task, Disturbance(damping=damping, armature=armature))
        end = here.dynamics.rollout(start, lambda *_: np.zeros(1), 100).states[-1, 3]
        assert end == pytest.approx(np.exp(-2.0 * damping / (3.0 + armature)), rel=5e-3)


@pytest.mark.parametrize(
    "limit",
    ['ctrlrange="-4 4"', 'forcerange="-4 4"', 'ctrlrange="-2 2" gear="2" forcerange="-2 2"'],
)
def test_actuators_of_another_strength_give_other_largest_forces(sled, limit):
    task = sled(
        gravity="[0, 0, 0]",
        mjcf=SLED.replace('joint="x"/>', f'joint="x" {limit}/>').replace(
            "<mujoco>", '<mujoco><compiler autolimits="true"/>'
        ),
    )
    for strength in (1.0, 0.5, 0.25):
        here = disturb_task(task, Disturbance(strength=strength))
        states = here.dynamics.rollout(task.initial_state, lambda *_: np.full(1, 9.0), 50).states
        assert states[-1, 3] == pytest.approx(4.0 * strength * 0.5 / 3.0, rel=1e-3)


def test_a_joints_limit_of_all_actuators_is_scaled_with_them(sled):
    mjcf = SLED.replace('axis="1 0 0"/>', 'axis="1 0 0" actuatorfrcrange="-3 3"/>', 1)
    here = disturb_task(sled(gravity="[0, 0, 0]", mjcf=mjcf), Disturbance(strength=0.5))
    states = here.dynamics.rollout(here.initial_state, lambda *_: np.full(1, 9.0), 50).states
    assert states[-1, 3] == pytest.approx(0.25, rel=1e-3)


def test_gain_scales_the_force_and_dry_friction_takes_its_part_of_it(sled):
    """A force of 9 N on 3 kg for .1 s; the arm has no actuator, so that nothing rubs there."""
    task = sled(gravity="[0, 0, 0]")
    for gain, friction in ((1.0, 0.0), (0.5, 0.0), (1.0, 3.0), (0.5, 3.0)):
        here = disturb_task(task, Disturbance(gain=gain, friction_loss=friction))
        assert here.dynamics.model.dof_frictionloss.tolist() == [friction, 0.0, 0.0]
        states = here.dynamics.rollout(task.initial_state, lambda *_: np.full(1, 9.0), 50).states
        assert states[-1, 3] == pytest.approx(0.5 * (9.0 * gain - friction) / 3.0, rel=1e-2)


def test_a_payload_is_pushed_with_the_body_that_bears_it(sled):
    task = sled(gravity="[0, 0, 0]")
    push = Disturbance("sled", push=(6.0, 0.0), payload=4.0)
    velocity = coasted(task, push)[-1, 3]
    lighter = coasted(task, replace(push, payload=0.0))[-1, 3]
    assert velocity == pytest.approx(6.0 / 7.0, rel=1e-3)
    assert lighter == pytest.approx(6.0 / 3.0, rel=1e-3)


def test_derivatives_contain_the_push(sled, finite_differences):
    push = Disturbance("arm", push=(5.0, 0.0), push_time=0.02, push_duration=0.03)
    dynamics = disturb_task(sled("[0, 0, 0]", damping=0.0), push).dynamics
    start = np.array([0.0, 1.0, 0.3, 0.1, 0.0, 0.2])
    motion = dynamics.rollout(start, lambda *_: np.ones(1), 8)
    linear, _ = dynamics.linearize(motion)

    def last(x):
        return dynamics.rollout(x, lambda *_: np.ones(1), 8).states[-1]

    product = np.eye(6)
    for f_x in linear.f_x:
        product = f_x @ product
    np.testing.assert_allclose(product, finite_differences(last, start), rtol=1e-3, atol=1e-4)


def test_a_solve_knows_the_push_and_its_motion_is_one_of_the_pushed_robot(sled):
    task = sled(gravity="[0, 0, 0]")
    push = Disturbance("sled", push=(4.0, 0.0), push_time=0.3)
    request = first_request(task, 0, 30)
    calm, pushed = (
        optimize(task, replace(request, situation=replace(request.situation, disturbance=d)))
        for d in (Disturbance(), push)
    )
    mean = pushed.distribution.mean
    assert np.abs(disturb_task(task, push).dynamics.gaps(mean)).max() < 1e-12
    assert np.abs(task.dynamics.gaps(mean)).max() > 0.1
    assert pushed.cost > calm.cost
    # It brakes before the push, which it knows of.
    assert mean.controls[25:30].mean() < -0.01


def test_a_solve_closes_what_a_changed_model_opens():
    task = make_task("walker")
    change = Disturbance(payload=0.3, slope=(0.02, 0.0), friction=0.8)
    request = first_request(task, 0, 20)
    changed = replace(request.situation, disturbance=change)
    found = optimize(task, replace(request, situation=changed))
    gaps = disturb_task(task, change).dynamics.gaps(found.distribution.mean)
    assert np.abs(gaps).max() < 1e-9


def test_on_a_slope_a_policy_measures_the_vertical_and_a_cost_counts_from_the_ground(rng):
    """An inertial unit feels gravity, wherever the ground is; the accelerometer is the witness."""
    task = make_task("quadruped")
    slope = disturb_task(task, Disturbance(slope=(0.2, -0.1)))
    turns = rng.standard_normal((6, task.dynamics.space.tangent_dim)) * 0.4
    states = task.dynamics.space.add(task.initial_state, turns)
    names = ["up/x", "up/y", "up/z"]
    of_ground = Readings(slope.dynamics.simulations, names)(states)
    np.testing.assert_array_equal(of_ground, Readings(task.dynamics.simulations, names)(states))
    read = slope.observation.readings
    measured = read(states)[:, [read.names.index(name) for name in names]]
    model, data = slope.dynamics.model, mujoco.MjData(slope.dynamics.model)
    for state, up, ground in zip(states, measured, of_ground, strict=True):
        data.qpos[:] = state[: model.nq]
        mujoco.mj_kinematics(model, data)
        falls = data.site("imu").xmat.reshape(3, 3).T @ model.opt.gravity
        np.testing.assert_allclose(up, -falls / 9.81, atol=1e-12)
        assert up @ ground == pytest.approx(
            1.0 / np.sqrt(1.0 + np.tan(0.2) ** 2 + np.tan(0.1) ** 2)
        )
    still, level = task.observation.readings, disturb_task(task, Disturbance(friction=0.9))
    np.testing.assert_array_equal(level.observation.readings(states), still(states))


def test_slopes_are_drawn_in_all_directions(rng):
    task, settings = make_task("quadruped"), DisturbanceSettings(slope=0.2)
    slopes = np.array([draw_disturbance(task, settings, rng).slope for _ in range(60)])
    assert (np.hypot(*slopes.T) <= 0.2).all()
    assert len(set(map(tuple, np.sign(slopes)))) == 4


def test_a_sled_that_slides_meets_steps_as_high_as_they_are_said_to_be(sled, rng):
    """It begins on the first two steps, whose tops are 0.03 m high, as it does where none are."""
    task = sled()
    start = task.initial_state.copy()
    start[:2] = 0.6, 0.03  # [m]
    for height, rests in ((0.03, 0.03), (0.0, 0.0)):
        here = disturb_task(task, Disturbance(steps=height))
        states = here.dynamics.rollout(start, lambda *_: np.zeros(1), 100).states
        assert states[-1, 1] == pytest.approx(rests, abs=2e-3)
    settings = DisturbanceSettings(steps=0.04)
    draws = [draw_disturbance(task, settings, rng).steps for _ in range(40)]
    assert 0.0 <= min(draws) < 0.005 < 0.035 < max(draws) <= 0.04


def test_ridges_lift_what_lies_on_them(sled):
    task = sled()
    states = coasted(task, Disturbance(ridges=0.05, ridges_seed=3))
    assert states[-1, 1] > 0.001
    other = coasted(task, Disturbance(ridges=0.05, ridges_seed=4))
    assert other[-1, 1] != states[-1, 1]


def test_joints_are_drawn_as_often_weaker_as_stronger_and_no_other_draw_changes(sled, rng):
    task, settings = sled(), DisturbanceSettings(push=5.0, payload=2.0)
    states = [np.random.default_rng(i) for i in range(200)]
    changed = [
        draw_disturbance(
            task, replace(settings, joints=1.0, strength=0.3, gain=0.5, friction_loss=2.0), rng
        )
        for rng in states
    ]
    for name in ("damping", "armature"):
        drawn = np.array([getattr(each, name) for each in changed])
        assert 0.5 <= drawn.min() < 0.55 < 1.8 < drawn.max() <= 2.0
        assert 60 < np.count_nonzero(drawn < 1.0) < 140
    assert 0.7 <= min(each.strength for each in changed) < 0.75
    assert 0.95 < max(each.strength for each in changed) <= 1.0
    assert len({each.damping / each.armature for each in changed}) > 100
    assert 1 / 1.5 <= min(each.gain for each in changed) < 0.7
    assert 1.4 < max(each.gain for each in changed) <= 1.5
    assert 0.0 <= min(each.friction_loss for each in changed) < 0.1
    assert 1.9 < max(each.friction_loss for each in changed) <= 2.0
    usual = [draw_disturbance(task, settings, np.random.default_rng(i)) for i in range(200)]
    same = {"damping": 1.0, "armature": 1.0, "strength": 1.0, "gain": 1.0, "friction_loss": 0.0}
    calm = [replace(each, **same) for each in changed]
    assert usual == calm


def test_draws_are_within_their_sizes_and_point_where_the_robot_can_move(sled, rng):
    settings = DisturbanceSettings(push=5.0, push_before=2.0, payload=2.0, friction=0.3, slope=0.1)
    task = sled()
    draws = [draw_disturbance(task, settings, rng) for _ in range(40)]
    assert {d.push for d in draws} == {(5.0, 0.0), (-5.0, 0.0)}
    assert {d.body for d in draws} == {"sled"}  # the heaviest
    assert 0.0 <= min(d.push_time for d in draws) < 0.3 < 1.7 < max(d.push_time for d in draws) < 2
    assert all(0.0 <= d.payload <= 2.0 for d in draws)
    assert all(0.7 <= d.friction <= 1.3 for d in draws)
    assert all(abs(d.slope[0]) <= 0.1 and d.slope[1] == 0.0 for d in draws)
    free = make_task("quadruped")
    turns = [draw_disturbance(free, settings, rng).push for _ in range(9)]
    assert len(set(turns)) == 9
    assert all(np.hypot(*push) == pytest.approx(5.0) for push in turns)


@pytest.mark.parametrize(
    ("disturbance", "sentence"),
    [
        (
            {"body": "slet", "payload": 1.0},
            "there is no body 'slet'; there are sled, arm.*Did you mean 'sled'",
        ),
        ({"payload": -1.0}, r"disturbance.payload is -1.0, but it must be finite and from 0"),
        ({"push": (np.nan, 0.0)}, "disturbance.push is .*nan"),
        ({"slope": (2.0, 0.0)}, "disturbance.slope is"),
        ({"strength": 0.0}, "disturbance.strength is 0.0, but it must be finite and from 0.01"),
        ({"armature": -1.0}, "disturbance.armature is -1.0, but it must be finite and from 0"),
        ({"strength": 0.5}, r"forces shall change by the factor 0\.5, but no actuator has one"),
    ],
)
def test_what_does_not_suit_is_refused(sled, disturbance, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        disturb_task(sled(), Disturbance(**disturbance))


def test_bodies_without_a_name_have_that_of_their_place(tmp_path, rng):
    bare = re.sub('<body name="[a-z]+"', "<body", SLED.replace('body="sled"', 'body="world"'))
    (tmp_path / "sled.xml").write_text(bare)
    (tmp_path / "task.yaml").write_text(re.sub("changes.*\n", "", TASK))
    task = make_task(str(tmp_path))
    assert task.mjcf == bare  # whose joints have names, so that it stands as it is
    for name, found in (("", "body"), ("body_body", "body_body")):
        settings = DisturbanceSettings(body=name, push=1.0, payload=2.0)
        drawn = draw_disturbance(task, settings, rng)
        assert drawn.body == found
        loaded = disturb_task(task, drawn).dynamics.model
        assert loaded.body_mass.sum() == pytest.approx(3.0 + drawn.payload)


def test_friction_changes_only_where_something_can_rub(sled):
    ice = Disturbance(friction=0.5)
    assert can_slide_on_ground(disturb_task(sled(), ice).dynamics.model)
    for change in ('contype="0"', 'condim="1"'):
        smooth = SLED.replace('size="0.3 0.3 0.1"', f'size="0.3 0.3 0.1" {change}')
        smooth = smooth.replace('type="plane"', f'type="plane" {change}')
        with pytest.raises(InvalidInputError, match=r"factor 0\.5, but no two geoms of the robot"):
            disturb_task(sled(mjcf=smooth), ice)


def test_a_body_that_cannot_move_sideways_is_not_pushed(sled, rng):
    lift = SLED.replace('<joint name="z" type="slide" axis="0 0 1"/>', "").replace("1 0 0", "0 0 1")
    with pytest.raises(InvalidInputError, match="'sled' cannot move horizontally"):
        draw_disturbance(sled(mjcf=lift), DisturbanceSettings(push=1.0), rng)
