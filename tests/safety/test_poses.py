# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Standing up, holding and sitting down, in the dynamics of a quadruped and of a servo."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.safety.poses import PoseMotion, PoseSettings
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.state_limits import StateLimits
from vgps_ros.safety.supervisor import Supervisor
from vgps_ros.simulation.controls import controls_of
from vgps_ros.storage.run_folder import load_policy
from vgps_ros.tasks import make_task, registry

TASKS = Path(registry.__file__).parent
HEIGHT = 2  # index of the trunk's height in a state
SETTINGS = PoseSettings()


@pytest.fixture(scope="module")
def quadruped():
    return make_task("tests/tasks/quadruped_with_motors.yaml")


def run(task, pose, state, seconds):
    """Returns the states of a motion by a pose's controls, shape (T+1, n_x)."""
    states, step = [state], task.dynamics.time_step
    for t in range(round(seconds / step)):
        control = pose.control(states[-1], round(t * step * 1e9))
        states.append(task.dynamics.step(states[-1], np.clip(control, *task.controls.limits)))
    return np.array(states)


def a_pose(task, goal, duration):
    return PoseMotion("moves", task.controls, SETTINGS, goal, duration)


def crouched(task):
    state = task.initial_state.copy()
    state[HEIGHT] = 0.13
    state[7:19] = np.tile([0.0, 1.35, -2.5], 4)
    return state


def test_it_stands_up_from_the_pose_that_is_measured_without_a_jerk(quadruped):
    low = run(quadruped, a_pose(quadruped, None, 0.0), crouched(quadruped), 1.0)[-1]
    assert low[HEIGHT] < 0.2
    pose = a_pose(quadruped, quadruped.initial_state, 1.5)
    first = pose.control(low, 0)
    rates = low[-12:]
    np.testing.assert_allclose(first, -rates, atol=1e-12)  # no pull where it begins
    states = run(quadruped, pose, low, 2.5)
    assert pose.is_reached
    assert states[-1, HEIGHT] > 0.24
    assert np.abs(states[-1, 7:19] - quadruped.initial_state[7:19]).max() < 0.15
    assert np.abs(states[-1, -12:]).max() < 0.1


def test_it_holds_the_pose_that_it_has(quadruped):
    states = run(quadruped, a_pose(quadruped, None, 0.0), quadruped.initial_state, 3.0)
    assert states[-1, HEIGHT] > 0.24
    assert np.abs(states[-50:, -12:]).max() < 0.1


def test_it_sinks_slowly_where_there_is_no_pose_to_sit_in(quadruped):
    pose = a_pose(quadruped, None, 3.0)
    states = run(quadruped, pose, quadruped.initial_state, 3.1)
    assert pose.is_reached
    height, speed = states[:-1, HEIGHT], np.diff(states[:, HEIGHT]) / quadruped.dynamics.time_step
    assert height[-1] < 0.12  # below it the model's trunk has no contact
    assert speed[height > 0.12].min() > -0.4  # [m/s]


def test_servos_go_from_the_measured_pose_to_the_goal():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="a"/><geom size=".1"/></body></worldbody>
        <actuator><position joint="a" kp="20"/></actuator></mujoco>"""
    )
    pose = PoseMotion(
        "moves", controls_of(model), PoseSettings(pose_integral=0.0), np.array([1.0, 0.0]), 2.0
    )
    targets = [pose.control(np.array([0.2, 5.0]), t * 10**9)[0] for t in range(4)]
    np.testing.assert_allclose(targets, [0.2, 0.6, 1.0, 1.0])


@pytest.mark.parametrize("name", ["quadruped", "tests/tasks/quadruped_with_motors.yaml"])
def test_weight_does_not_make_it_sag_nor_chatter(name):
    """Servos of 30 N·m/rad sag by 7 cm without a correction, motors of 60 by 2 cm."""
    task = make_task(name)
    low = run(task, a_pose(task, None, 0.0), crouched(task), 1.0)[-1]
    standing = a_pose(task, task.initial_state, 1.5)
    states = run(task, standing, low, 8.0)
    assert np.abs(states[-100:, HEIGHT] - task.initial_state[HEIGHT]).max() < 0.005
    assert np.abs(states[-100:, 7:19] - task.initial_state[7:19]).max() < 0.03
    assert np.abs(states[-100:, -12:]).max() < 0.02  # rad/s
    # What it holds next, it holds from there on.
    last = standing.control(states[-1], 8 * 10**9)
    holding = PoseMotion("holds", task.controls, SETTINGS, None, 0.0, last=last)
    states = run(task, holding, states[-1], 2.0)
    assert np.abs(states[:, HEIGHT] - task.initial_state[HEIGHT]).max() < 0.005
    # The correction is bounded, and a state that comes twice is answered twice.
    bounded = PoseMotion("holds", task.controls, PoseSettings(pose_correction=0.0), None, 0.0)
    assert run(task, bounded, states[-1], 2.0)[-1, HEIGHT] < task.initial_state[HEIGHT] - 0.01
    first, again = (holding.control(states[-1], 10**10) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_a_keyframe_that_is_none_is_refused(quadruped):
    model, robot = quadruped.dynamics.model, quadruped.deployment
    assert robot.pose("sit_keyframe", "") is quadruped.initial_state
    np.testing.assert_array_equal(
        robot.pose("sit_keyframe", "stand")[: model.nq], model.key("stand").qpos
    )
    with pytest.raises(
        InvalidInputError, match="sit_keyframe is 'lie', but it must be one of stand"
    ):
        robot.pose("sit_keyframe", "lie")


class Walking:
    """The built-in quadruped, driven by its policy under a supervisor, as an executor does it."""

    def __init__(self, commands, **settings):
        self.task, robot = make_task("quadruped"), make_task("quadruped").deployment
        self.settings = SafetySettings(
            torque_limits=tuple(robot.controls.largest), damping=1.0, tilt_limit=1.2, **settings
        )
        self.carrying = robot.standing("", robot.controls)
        limits = StateLimits(self.settings, robot.layout, robot.initial_state)
        self.supervisor = Supervisor(
            self.settings, robot.controls, 0.02, lambda _: "", limits, self.carrying
        )
        self.policy, _ = load_policy(TASKS / "quadruped" / "policy.json")
        self.commands, self.state, self.step = np.array(commands), robot.initial_state, 0
        self.pose = None

    def go_on(self, seconds):
        """Answers each state; returns the least height of the trunk."""
        heights, task = [], self.task
        for _ in range(round(seconds / 0.02)):
            self.step += 1
            stamp, now = self.step * 20_000_000, 0.02 * self.step
            phase = np.array(now * task.signals.frequency % 1.0)
            told = np.asarray(task.signals.context(self.commands, phase))

            def law(stamp=stamp, told=told):
                if self.pose:
                    return self.pose.control(self.state, stamp)
                return self.policy.mean(task.observation.within(told)(self.state))

            answer = self.supervisor.answer(
                self.state, stamp, lambda: 0.0, now, law, is_policy=self.pose is None
            )
            self.state = task.dynamics.step(self.state, answer.control)
            heights.append(self.state[HEIGHT])
        return min(heights)

    def take_pose(self, duration, goal=None, first=None, last=None):
        controls = self.task.controls
        self.pose = PoseMotion("moves", controls, SETTINGS, goal, duration, first, last)


@pytest.mark.parametrize("steps", [0, 4, 9])
@pytest.mark.parametrize("commands", [(0.5, 0.0, 0.0), (-0.3, 0.2, 0.0), (0.0, 0.0, 1.0)])
def test_a_robot_that_walks_stands_when_it_is_stopped_and_walks_on(commands, steps):
    """Held where its feet were in the air, it tipped over in 11 of 30 such stops."""
    robot = Walking(commands, safe_action="stand")
    standing = robot.task.initial_state
    robot.go_on(1.0 + 0.02 * steps)
    robot.supervisor.stop_driving("the node is deactivated.")
    assert robot.go_on(2.0) > 0.24
    assert np.abs(robot.state[-18:]).max() < 0.5  # it is still
    last = robot.supervisor.stop().control
    np.testing.assert_array_equal(last, robot.carrying)
    robot.supervisor.begin()
    robot.take_pose(1.0, standing, last=robot.supervisor.last_control)
    assert robot.go_on(1.0) > 0.25  # it is not let down
    robot.pose = None
    assert robot.go_on(1.0) > 0.23
    for goal in (None, standing):  # it holds its pose, or stands, amid its steps
        robot.take_pose(0.0, goal, standing, robot.carrying)
        assert robot.go_on(1.0) > 0.24
        robot.pose = None
        assert robot.go_on(1.0) > 0.23


def test_a_robot_that_lies_or_is_stopped_in_an_emergency_is_not_stood_up():
    robot = Walking((0.0, 0.0, 0.0), safe_action="stand")
    robot.state = robot.state.copy()
    robot.state[HEIGHT], robot.state[3:7] = 0.4, [0.0, 1.0, 0.0, 0.0]  # on its back
    measured = robot.task.controls.positions @ robot.state
    robot.go_on(0.02)
    assert "the base is tilted by 3.14 rad" in robot.supervisor.fault
    np.testing.assert_allclose(robot.supervisor.last_control, measured)
    robot = Walking((0.5, 0.0, 0.0), safe_action="stand")
    robot.go_on(0.5)
    robot.supervisor.stop_driving("there is an emergency stop.", is_frozen=True)
    measured = robot.task.controls.positions @ robot.state
    robot.go_on(0.02)
    np.testing.assert_allclose(robot.supervisor.last_control, measured)


def test_what_carries_the_weight_holds_the_pose_to_a_few_millimetres():
    task = make_task("quadruped")
    robot = task.deployment
    sags, stands = (
        task.dynamics.rollout(task.initial_state, lambda *_, u=u: u, 150).states[-1, HEIGHT]
        for u in (task.controls.resting(task.initial_state), robot.standing("", task.controls))
    )
    assert sags < 0.22
    assert stands == pytest.approx(task.initial_state[HEIGHT], abs=0.01)
    for name in ("cart_pole", "walker", "tests/tasks/quadruped_with_motors.yaml"):
        assert not np.any(list(make_task(name).deployment.carrying.values()))


def test_what_a_control_asks_for_is_what_pulls_so(quadruped, rng):
    """Damping of a motor that moves carries nothing."""
    for task in (quadruped, make_task("quadruped")):
        state = task.initial_state + np.r_[np.zeros(7), 0.1 * rng.standard_normal(30)]
        beyond = 0.02 * rng.standard_normal(12)
        control = task.controls.pulling(state, state, 60.0, 1.0, beyond)
        asked = task.controls.asked(state, control, 60.0, 1.0)
        np.testing.assert_allclose(asked, beyond, atol=1e-12)
        assert not task.controls.asked(state, control, 0.0, 1.0)[task.controls.stiffness == 0].any()
