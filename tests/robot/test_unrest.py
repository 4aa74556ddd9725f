# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""When a robot that stands has to step, so that a clock that stops turns again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.robot.bodies import vertical
from vgps_ros.robot.unrest import RATE, TILT, Unrest, Waking
from vgps_ros.simulation.frames import state_layout
from vgps_ros.tasks import make_task
from vgps_ros.tasks.disturbance import Disturbance
from vgps_ros.tasks.disturbed_task import disturb_task

MS = 1_000_000  # [ns]


@pytest.fixture(scope="module")
def quadruped():
    return make_task("quadruped")


def turned(state, rotation, rate=(0.0, 0.0, 0.0)):
    """A state whose base is turned in the world, and turns at a rate in its own axes."""
    found = state.copy()
    whole = rotation * Rotation.from_quat(state[3:7], scalar_first=True)
    found[3:7], found[22:25] = whole.as_quat(scalar_first=True), rate
    return found


def test_the_vertical_is_that_of_rotation_matrices(rng):
    turns = Rotation.random(20, rng)
    wanted = turns.inv().apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(vertical(turns.as_quat(scalar_first=True)), wanted, atol=1e-12)
    up = np.array([0.6, 0.0, 0.8])
    found = vertical(turns.as_quat(scalar_first=True), up)
    np.testing.assert_allclose(found, turns.inv().apply(up), atol=1e-12)


def test_a_slope_is_felt_as_a_tilt(quadruped):
    """On a slope of 0.2 rad it stands level again where it is turned back by so much."""
    slope = disturb_task(quadruped, Disturbance(slope=(0.2, 0.0)))
    here, uphill = slope.initial_state, Rotation.from_euler("Y", 0.2)
    assert slope.unrest.restless(here)
    assert not slope.unrest.restless(turned(here, uphill))
    assert not quadruped.unrest.restless(here)


@pytest.mark.parametrize("start", [Rotation.identity(), Rotation.from_euler("XY", [0.3, -0.5])])
def test_a_tilt_and_a_turn_about_a_level_axis_are_felt_and_no_heading(quadruped, start):
    upright = turned(quadruped.initial_state, start)
    unrest = Unrest.of(quadruped.signals, state_layout(quadruped.dynamics.model), upright)
    up = start.inv().apply([0.0, 0.0, 1.0])
    level = np.linalg.svd(up[None])[2][1]  # in the base's axes
    for heading in (0.0, 1.0, 3.0):
        spun = Rotation.from_euler("Z", heading)
        for share, is_felt in ((0.95, False), (1.05, True)):
            for rotation, rate in (
                (Rotation.from_euler("X", share * TILT), (0.0, 0.0, 0.0)),
                (Rotation.from_euler("Y", -share * TILT), (0.0, 0.0, 0.0)),
                (Rotation.identity(), share * RATE * level + 4.0 * up),
            ):
                assert unrest.restless(turned(upright, rotation * spun, rate)) == is_felt


def test_the_clock_turns_for_a_while_after_the_robot_was_restless(quadruped):
    unrest, calm = quadruped.unrest, quadruped.initial_state
    pushed = turned(calm, Rotation.from_euler("X", 0.1))
    motion = np.array([calm, pushed, pushed, *[calm] * 100])
    awake = unrest.awake(motion)
    assert unrest.steps == 75
    assert np.flatnonzero(awake).tolist() == [*range(1, 2 + 75)]
    waking = Waking(unrest, 0.02)
    assert [waking.is_awake(x, 20 * MS * t) for t, x in enumerate(motion, 1)] == awake.tolist()
    assert waking.is_awake(pushed, 5000 * MS)
    assert not waking.is_awake(calm, 20 * MS)  # time was set back
    assert waking.is_awake(pushed, 40 * MS)


def test_compiled_rollouts_read_the_clock_that_the_motion_tells(quadruped, rng):
    """A random network at rest, under a push: each control is that of the state's own context."""
    push = Disturbance(body="trunk", push=(0.0, 12.0), push_time=0.3, slope=(-0.03, 0.04))
    task = disturb_task(quadruped, push)
    observation, signals, steps = task.observation, task.signals, 130
    shape = Architecture(observation.names, (8,), 12)
    weights = 0.02 * rng.standard_normal(shape.num_parameters)
    policy, none = GaussianPolicy(shape, weights, np.ones(12)), np.zeros((2, steps, 12))
    commands = np.zeros((2, steps, 3))
    commands[1, 60:, 0] = 0.3
    phases = np.array([signals.phases(steps, first) for first in (0.0, 0.4)])
    calm, turning = (one.context(commands, phases) for one in (signals, signals.turning))
    states, controls = task.dynamics.execute(
        *(policy, observation.within(turning), np.tile(task.initial_state, (2, 1)), none),
        unrest=task.unrest,
        calm=calm,
    )
    for x, u, *contexts in zip(states[:, :-1], controls, calm, turning, strict=True):
        awake = task.unrest.awake(x)
        assert 0 < awake.sum() < steps
        context = np.where(awake[:, None], contexts[1], contexts[0])
        wanted = policy.mean(observation.within(context)(x))
        np.testing.assert_allclose(u, np.clip(wanted, *task.controls.limits), atol=1e-9)


def test_a_task_whose_clock_never_stops_has_no_unrest(quadruped):
    assert replace(quadruped, signals=quadruped.signals.turning).unrest is None
    robot = quadruped.deployment
    deployed = Unrest.of(robot.signals, robot.layout, robot.initial_state)
    assert (deployed.rotation, deployed.rate, deployed.steps) == (3, 22, 75)
    np.testing.assert_allclose(deployed.up, [0.0, 0.0, 1.0])
