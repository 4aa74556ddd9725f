# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Loops of positions that a robot closes at the simulator's rate, for networks with gains."""

import dataclasses

import mujoco
import numpy as np
import onnx
import pytest

from tests.onnx_models import elu_model
from tests.servo_arm import LEG, SERVOS, write_arm
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.driver import driver_of, for_policy
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.simulation.controls import closed_loops, controls_of
from vgps_ros.simulation.model import compile_model
from vgps_ros.tasks import make_task
from vgps_ros.tasks.disturbed_task import with_servos

STIFFNESS, DAMPING = 80.0, 3.0
GAINS = np.full(2, STIFFNESS), np.full(2, DAMPING)


def mean_of(driver):
    return lambda t, x: driver.policy.mean(driver.observation(x))


def at_last(task, law, steps=150):
    """The largest speed of a joint in the last second, from joints that are off their pose."""
    rng, controls = np.random.default_rng(0), task.controls
    n = task.dynamics.model.nv
    start = task.initial_state.copy()
    driven = controls.positions.any(axis=0)
    start[driven] += 0.1 * rng.standard_normal(driven.sum())
    states = task.dynamics.rollout(start, law, steps).states
    assert n == len(task.initial_state) - task.dynamics.model.nq
    return np.abs(states[-50:] @ controls.velocities.T).max()


@pytest.mark.parametrize("name", ["quadruped", "leg"])
def test_gains_that_chatter_when_they_are_held_for_a_control_period_rest(name, tmp_path):
    task = make_task(write_arm(tmp_path, LEG) if name == "leg" else name)
    motors, n_u = task.controls, len(task.controls.names)
    served = with_servos(task, np.full(n_u, STIFFNESS), np.full(n_u, DAMPING))
    assert set(served.controls.kinds) == {"position"}
    pose = motors.positions @ task.initial_state

    def held(_, x):
        y, rate = x @ motors.positions.T, x @ motors.velocities.T
        return motors.from_joints(STIFFNESS * (pose - y) - DAMPING * rate)

    assert at_last(task, held) > 5.0  # [rad/s]
    assert at_last(served, lambda _, x: served.controls.from_joints(pose)[None]) < 1e-3


@pytest.mark.parametrize("name", ["quadruped", "swimmer", "leg", "servos"])
def test_an_executor_knows_closed_loops_without_the_model(name, tmp_path, rng):
    models = {"leg": LEG, "servos": SERVOS}
    task = make_task(write_arm(tmp_path, models[name]) if name in models else name)
    n_u = len(task.controls.names)
    gains = rng.uniform(1.0, 50.0, n_u), rng.uniform(0.0, 2.0, n_u)
    model = compile_model(closed_loops(task.mjcf, *gains))
    found, expected = task.controls.with_servos(*gains), controls_of(model)
    assert (found.kinds, found.units) == (expected.kinds, expected.units)
    for field in dataclasses.fields(found):
        one, other = (getattr(each, field.name) for each in (found, expected))
        if isinstance(one, np.ndarray) or field.name == "limits":
            np.testing.assert_allclose(one, other, rtol=1e-12, err_msg=field.name)


def test_a_closed_loop_exerts_its_law_within_the_motors_limits(tmp_path, rng):
    task = make_task(write_arm(tmp_path, LEG))
    served = with_servos(task, *GAINS)
    np.testing.assert_allclose(served.controls.stiffness, STIFFNESS, rtol=1e-15)
    np.testing.assert_allclose(served.controls.damping, DAMPING, rtol=1e-15)
    np.testing.assert_allclose(served.controls.largest, task.controls.largest, rtol=1e-15)
    model = served.dynamics.model
    data = mujoco.MjData(model)
    clipped = 0
    for _ in range(50):
        target = 0.5 * rng.standard_normal(2)
        data.qpos[:], data.qvel[:] = 0.5 * rng.standard_normal((2, 2))
        data.ctrl[:] = served.controls.from_joints(target)
        mujoco.mj_forward(model, data)
        torque = STIFFNESS * (target - data.qpos) - DAMPING * data.qvel
        # Gears 6 and -6: the shoulder's ±4 N·m, and the elbow's −3 to 4 N·m the other way around.
        expected = np.clip(torque, [-24.0, -24.0], [24.0, 18.0])
        clipped += (torque != expected).any()
        np.testing.assert_allclose(data.qfrc_actuator, expected, rtol=1e-12, atol=1e-12)
    assert clipped > 5


def test_gains_that_a_robot_has_already_change_nothing(tmp_path):
    task = make_task(write_arm(tmp_path, SERVOS))
    own = task.controls.stiffness, task.controls.damping
    assert with_servos(task, *own) is task
    stiffer = with_servos(task, own[0], own[1] + 2.0)
    np.testing.assert_allclose(stiffer.controls.damping, 2.0)
    np.testing.assert_allclose(stiffer.controls.scale, 1.0)


def test_gains_without_a_loop_are_refused(tmp_path):
    task = make_task(write_arm(tmp_path, LEG))
    with pytest.raises(InvalidInputError, match="shoulder shall have a stiffness of 0 and"):
        closed_loops(task.mjcf, np.zeros(2), np.ones(2))


def test_a_network_with_gains_drives_the_robot_by_its_targets(tmp_path):
    task = make_task(write_arm(tmp_path, LEG))
    names, pose = task.observation.names, task.controls.positions @ task.initial_state
    zero = [(np.zeros((2, len(names))), np.zeros(2))]
    says = {
        "joint_names": ",".join(task.controls.names),
        "observation_names": ",".join(names),
        "default_joint_pos": ",".join(map(str, pose)),
        "joint_stiffness": str(STIFFNESS),
        "joint_damping": str(DAMPING),
    }
    onnx.save(elu_model(zero, says, rows="batch"), tmp_path / "policy.onnx")
    file = open_policy(tmp_path / "policy.onnx")
    served = for_policy(task, file)
    law = mean_of(driver_of(served.deployment, file))
    target = served.controls.at_joints(law(0, served.initial_state[None]))
    np.testing.assert_allclose(target[0], pose, rtol=1e-12)
    assert at_last(served, law) < 1e-3
    # As a law of torques, which a motion to start from needs, it chatters.
    assert at_last(task, mean_of(driver_of(task.deployment, file))) > 5.0
