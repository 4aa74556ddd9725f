# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The swimmer is the paper's, and the registry names what it has."""

import dataclasses

import numpy as np
from numpy.testing import assert_allclose

from tests.simulation.robots import everything, random_states
from vgps_ros.core.records import Trajectory
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import deviation_names
from vgps_ros.tasks import make_task
from vgps_ros.tasks.first_motion import smoothed_noise


def test_swimmer_has_three_links_five_degrees_of_freedom_and_two_torques(swimmer):
    assert swimmer.dims == {"n_x": 10, "n_dx": 10, "n_u": 2, "n_z": 0}
    assert swimmer.joint_names == ["root_x", "root_y", "root_yaw", "front_joint", "back_joint"]
    assert swimmer.actuated_joint_names == ["front_joint", "back_joint"]
    mass = swimmer.dynamics.model.body_mass[1:]
    assert_allclose(mass, 1000 * (np.pi * 0.05**2 * 1.0 + 4 / 3 * np.pi * 0.05**3))


def test_standing_still_costs_500(swimmer):
    still = Trajectory(np.zeros((501, 10)), np.zeros((500, 2)))
    assert swimmer.trajectory_cost(still) == 500.0


def test_torque_turns_the_joint_that_bears_its_name(swimmer):
    for i, name in enumerate(swimmer.actuated_joint_names):
        torque = np.zeros(2)
        torque[i] = 1.0
        moved = swimmer.dynamics.step(np.zeros(10), torque)[:5]
        joints = {n: moved[swimmer.joint_names.index(n)] for n in swimmer.actuated_joint_names}
        assert max(joints, key=lambda n: joints[n]) == name


def test_first_controls_depend_on_their_generator(swimmer):
    first, again, other = (
        swimmer.begin.controls(swimmer, 500, generator(seed, Stream.INITIAL_CONTROLS, 0))
        for seed in (0, 0, 1)
    )
    assert first.shape == (500, 2)
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, other)


def test_smoothed_noise_has_its_amplitude_and_time_constant(rng):
    noise = smoothed_noise(rng, (200_000, 1), amplitude=30.0, time_constant=25.0)[:, 0]
    assert_allclose(noise.std(), 30.0, rtol=0.05)
    correlation = np.corrcoef(noise[:-25], noise[25:])[0, 1]
    assert_allclose(correlation, np.exp(-1), rtol=0.1)


def test_a_diverged_rollout_costs_infinity_and_the_others_their_own(swimmer):
    states, controls = np.zeros((2, 501, 10)), np.zeros((2, 500, 2))
    states[1, 200:] = np.nan
    np.testing.assert_array_equal(swimmer.rollout_costs(states, controls), [500.0, np.inf])


def test_a_robot_with_a_free_base_has_its_coordinates_named_and_told_apart(swimmer, rng):
    model = everything()
    task = dataclasses.replace(swimmer, dynamics=Dynamics(model))
    assert task.dims == {"n_x": 13 + 11 + 1, "n_dx": 11 + 11 + 1, "n_u": 4, "n_z": 0}
    assert task.joint_names == ["hip", "knee"]
    assert task.position_names[:6] == [f"base/{c}" for c in ("x", "y", "z", "rx", "ry", "rz")]
    assert deviation_names(model)[task.velocities][:3] == ["base/vx", "base/vy", "base/vz"]
    assert deviation_names(model)[task.velocities][-1] == "tail/wz"
    assert task.angles.tolist() == [False] * 3 + [True] * 8
    before, after = random_states(model, rng, 3), random_states(model, rng, 3)
    assert_allclose(task.distance(before, after), after[:, 0] - before[:, 0])


def test_distance_is_along_the_first_slide_and_nothing_without_one(swimmer, rng):
    before, after = rng.standard_normal((2, 3, 10))
    assert_allclose(swimmer.distance(before, after), after[:, 0] - before[:, 0])
    assert_allclose(make_task("rotor").distance(before[:, :2], after[:, :2]), np.zeros(3))
