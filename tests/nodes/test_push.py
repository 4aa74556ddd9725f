# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The topic `push`: what acts on a body of the simulated robot, and bad messages."""

import math

import mujoco
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped

from tests.nodes.test_simulation import PERIOD, PLAYING, STOPPED, Robot
from vgps_ros.messages.conversions import push_to_msg, state_from_msg
from vgps_ros.simulation.forces import BodyFrames

WRENCH = np.array([3.0, 1.0, 0.0, 0.0, 0.0, 0.5])


@pytest.fixture(scope="module")
def shared_robot(shared_graph, swimmer):
    shared_graph.start("simulation", push_duration=0.04)  # two steps
    return Robot(shared_graph, swimmer)


@pytest.fixture(scope="module")
def pushes(shared_robot):
    return shared_robot.graph.publisher(WrenchStamped, "push")


@pytest.fixture
def robot(shared_robot):
    """The same process for all tests: playing, at time 0."""
    shared_robot.set_state(STOPPED)
    shared_robot.states.clear()
    shared_robot.set_state(PLAYING)
    return shared_robot


def push(robot, publisher, message):
    publisher.publish(message)
    robot.graph.spin_for(0.5)  # until it has come


def test_a_push_acts_for_its_time_and_not_longer(robot, pushes, swimmer):
    message = robot.next_state(0)
    push(robot, pushes, push_to_msg("front", WRENCH))
    frames, x = BodyFrames(swimmer.dynamics.model), swimmer.initial_state
    for step in range(4):
        robot.command([1.0, -1.0], message)
        applied = frames.applied(x, frames.body("front"), WRENCH[:3], WRENCH[3:])
        free = swimmer.dynamics.step(x, np.array([1.0, -1.0]))
        x = swimmer.dynamics.step(x, np.array([1.0, -1.0]), applied if step < 2 else None)
        assert np.array_equal(x, free) == (step >= 2)
        message = robot.next_state((step + 1) * PERIOD)
        np.testing.assert_array_equal(state_from_msg(message, swimmer.joint_names), x)


def test_a_reset_ends_a_push(robot, pushes, swimmer):
    robot.next_state(0)
    push(robot, pushes, push_to_msg("front", WRENCH))
    assert robot.reset().result == 1
    robot.states.clear()
    robot.command([1.0, -1.0], robot.next_state(0))
    x = swimmer.dynamics.step(swimmer.initial_state, np.array([1.0, -1.0]))
    after = state_from_msg(robot.next_state(PERIOD), swimmer.joint_names)
    np.testing.assert_array_equal(after, x)


@pytest.mark.parametrize(
    ("body", "wrench", "sentence"),
    [
        ("frnt", WRENCH, "there is no body 'frnt'; there are"),
        ("", WRENCH, "there is no body ''"),
        ("front", [math.nan, *WRENCH[1:]], "wrench is nan at index 0"),
        ("front", [*WRENCH[:5], -math.inf], "wrench is -inf at index 5"),
        ("front", [0.0, 2e10, 0.0, 0.0, 0.0, 0.0], "wrench has 2e+10; every value must be below"),
    ],
)
def test_a_bad_push_is_ignored_with_a_sentence(robot, pushes, swimmer, body, wrench, sentence):
    message = robot.next_state(0)
    pushes.publish(push_to_msg(body, np.array(wrench)))
    status = robot.graph.diagnosis("simulation", DiagnosticStatus.ERROR, sentence)
    assert "Ignored a push" in status.message
    robot.command([0.0, 0.0], message)
    x = swimmer.dynamics.step(swimmer.initial_state, np.zeros(2))
    after = state_from_msg(robot.next_state(PERIOD), swimmer.joint_names)
    np.testing.assert_array_equal(after, x)
    pushes.publish(push_to_msg("front", WRENCH))
    robot.graph.diagnosis("simulation", DiagnosticStatus.OK)


def test_a_push_so_strong_that_the_state_diverges_pauses_the_simulation(robot, pushes):
    message = robot.next_state(0)
    push(robot, pushes, push_to_msg("front", np.array([9e9, 0.0, 0.0, 0.0, 0.0, 0.0])))
    robot.command([0.0, 0.0], message)
    robot.graph.diagnosis("simulation", DiagnosticStatus.ERROR, "The state diverged")
    assert robot.reset().result == 1


def test_a_force_at_a_bodys_origin_does_what_mujoco_makes_of_it(swimmer, rng):
    model = swimmer.dynamics.model
    frames, data = BodyFrames(model), mujoco.MjData(model)
    state = swimmer.initial_state + rng.normal(size=len(swimmer.initial_state))
    body, (force, torque) = frames.body("front"), rng.normal(size=(2, 3))
    applied = frames.applied(state, body, force, torque)
    data.qpos[:] = state[: model.nq]
    mujoco.mj_forward(model, data)
    axes = data.xmat[body].reshape(3, 3)
    expected, found = np.zeros(model.nv), np.zeros(model.nv)
    at_origin = axes @ force, axes @ torque, data.xpos[body]
    mujoco.mj_applyFT(model, data, *at_origin, body, expected)
    at_centre = applied.wrench[:3], applied.wrench[3:], data.xipos[body]
    mujoco.mj_applyFT(model, data, *at_centre, body, found)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert np.abs(expected).max() > 0.1
