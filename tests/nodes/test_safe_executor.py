# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Faults injected into a running `policy_executor`: what it sends, says, and how it recovers."""

import signal
import time

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.msg import TrajectoryDistribution as TrajectoryDistributionMsg

from tests.nodes.conftest import PATIENCE, executed, values_of
from vgps_ros.core.records import LinearDynamics, Trajectory, TrajectoryDistribution
from vgps_ros.messages.conversions import (
    command_from_msg,
    distribution_to_msg,
    nanoseconds,
    policy_to_msg,
    stamp_of,
    state_from_msg,
    state_to_msg,
)
from vgps_ros.ros_runtime.qos import LATCHED, STREAM
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.storage.run_folder import save_distributions

ERROR, WARN, OK = DiagnosticStatus.ERROR, DiagnosticStatus.WARN, DiagnosticStatus.OK
PERIOD = 20_000_000  # of the swimmer's control [ns]
STATE = np.linspace(-0.3, 0.6, 10)
DAMPING = 2.0
LIMITS = np.array([20.0, 1.5])


def mean(policy, state=STATE):
    """The torques of a policy without noise; it reads all of the state but root x."""
    return executed(policy, state[..., 1:].copy())


class Robot:
    """What the executor drives: its states are numbered, its commands are kept.

    With `wall` the number of a state is that of the control periods since 1970.
    """

    def __init__(self, graph, task, policy, *, wall=False, **parameters):
        self.graph, self.task, self.policy, self.wall = graph, task, policy, wall
        self.process = graph.start("policy_executor", **parameters)
        self._commands = graph.messages(JointState, "joint_command")
        self.policies = graph.publisher(GaussianPolicyMsg, "policy", LATCHED)
        self.states = graph.publisher(JointState, "joint_states")
        graph.spin_until(lambda: graph.node.count_publishers("joint_command"))
        self.step = 0
        self.publish_policy(policy)
        graph.diagnosis("policy_executor", OK, "Waiting for joint_states")

        def is_answered():
            self.states.publish(self.message())
            graph.spin_for(0.1)
            return self._commands

        graph.spin_until(is_answered, what="the first torques")

    def publish_policy(self, policy, **changes):
        message = policy_to_msg(policy, self.task.name, 1, Time())
        for name, value in changes.items():
            setattr(message, name, value)
        self.policies.publish(message)

    def message(self, state=STATE, step=None):
        """A state, by default a new one."""
        if step is None:
            self.step = step = time.time_ns() // PERIOD if self.wall else self.step + 1
        return state_to_msg(np.array(state), self.task.joint_names, stamp_of(step * PERIOD))

    @property
    def commands(self):
        """Torques and stamp [ns] of each command so far."""
        controls = self.task.controls
        return [
            (command_from_msg(c, controls), nanoseconds(c.header.stamp)) for c in self._commands
        ]

    def send(self, message):
        """Sends a message and returns the torques that come next and their stamp in steps."""
        self._commands.clear()
        self.states.publish(message)
        self.graph.spin_until(lambda: self._commands, what="a command")
        torques, stamp = self.commands[0]
        return torques, stamp / PERIOD

    def drive(self, state=STATE):
        """Sends a good state; returns the torques that answer it."""
        self._commands.clear()
        self.states.publish(self.message(state))

        def answers():
            return [torques for torques, stamp in self.commands if stamp == self.step * PERIOD]

        return self.graph.spin_until(answers, what=f"the answer to state {self.step}")[0]

    def wait_for_command(self):
        """Waits for torques without having sent a state, and returns them and their stamp."""
        self._commands.clear()
        self.graph.spin_until(lambda: self._commands, what="a command")
        torques, stamp = self.commands[0]
        return torques, stamp / PERIOD

    def stays_silent(self, duration):
        self._commands.clear()
        self.graph.spin_for(duration)
        return not self._commands

    def is_driven(self):
        """Whether the policy answers the next state."""
        expected = np.clip(mean(self.policy), -LIMITS, LIMITS)
        return np.array_equal(self.drive(), expected)

    def change(self, transition):
        return self.graph.change(transition)

    def diagnosis(self, level, text):
        return self.graph.diagnosis("policy_executor", level, text)

    def diagnosis_while_driven(self, level, text, state=STATE):
        """Waits for a status while states go on coming."""
        timer = self.graph.node.create_timer(0.1, lambda: self.states.publish(self.message(state)))
        try:
            return self.diagnosis(level, text)
        finally:
            self.graph.node.destroy_timer(timer)


@pytest.fixture(scope="module")
def shared_robot(shared_graph, swimmer, random_policy):
    return Robot(
        shared_graph,
        swimmer,
        random_policy(0),
        safe_action="damping",
        damping=DAMPING,
        torque_limits=LIMITS.tolist(),
        state_timeout=1.0,
    )


@pytest.fixture
def robot(shared_robot):
    """One process for many tests; the policy drives before and after each."""
    assert shared_robot.is_driven()
    yield shared_robot
    assert shared_robot.is_driven()
    assert shared_robot.process.running


def braking(robot, state=STATE):
    """The safe torques in a state."""
    velocities = state[[8, 9]]
    assert robot.task.joint_names[3:] == robot.task.actuated_joint_names
    return np.clip(-DAMPING * velocities, -LIMITS, LIMITS)


def at(seconds):
    message = JointState()
    message.header.stamp = Time(sec=seconds)
    return message.header


NAN = float("nan")
JOINTS = ["root_x", "root_y", "root_yaw", "front_joint", "back_joint"]
FAULTS = {
    "not finite": ({"velocity": [0.0, NAN, 0.0, 0.0, 0.0]}, "velocity of 'root_y' is nan"),
    "infinite": ({"position": [float("inf")] * 5}, "position of 'root_x' is inf"),
    "a joint twice": (
        {"name": [*JOINTS, JOINTS[0]], "position": [0.0] * 6, "velocity": [0.0] * 6},
        "must be there once",
    ),
    "too short": ({"position": [0.0] * 4}, "position has 4 values"),
    "without velocities": ({"velocity": []}, "velocity has 0 values"),
    "before time": ({"header": at(-1)}, "must not be < 0"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_an_unusable_state_gets_the_safe_action_and_the_next_good_one_the_policy(robot, fault):
    fields, sentence = FAULTS[fault]
    robot.step += 100  # beyond 1 s
    state = (1 + len(fault) % 5) * STATE
    robot.drive(state)
    message = robot.message(np.zeros(10), robot.step + 1)
    for name, wrong in fields.items():
        setattr(message, name, wrong)
    torques, step = robot.send(message)
    np.testing.assert_array_equal(torques, braking(robot, state))
    assert step == robot.step  # that of the last usable state
    status = robot.diagnosis(ERROR, sentence)
    assert "Safe action active (damping)" in status.message
    # The watchdog goes on with it; nothing else came meanwhile.
    robot.graph.spin_until(lambda: len(robot.commands) > 3, what="the watchdog")
    for torques, stamp in robot.commands:
        assert stamp == robot.step * PERIOD
        assert np.array_equal(torques, braking(robot, state)) or not torques.any()
    assert robot.is_driven()


def test_a_state_that_was_overtaken_is_left_out_with_a_warning(robot):
    robot.step += 100
    robot.drive()
    robot._commands.clear()
    robot.states.publish(robot.message(np.zeros(10), robot.step - 1))
    robot.graph.spin_until_output(robot.process, "A state came after one that is 0.02 s newer")
    assert not robot.commands
    assert robot.is_driven()


def test_the_safe_action_reaches_the_robot_within_two_of_its_control_periods(robot):
    """The robot sends a state each period, and counts those after the first bad one."""
    counts = []
    for _ in range(20):
        robot.drive()
        robot._commands.clear()
        bad, due, sent = [NAN] * 10, time.monotonic(), 0
        while not robot.commands:
            if time.monotonic() >= due:
                robot.states.publish(robot.message(bad, robot.step + 1))
                sent, due = sent + 1, due + PERIOD * 1e-9
            robot.graph.spin_for(1e-3)
        assert not np.array_equal(robot.commands[0][0], mean(robot.policy))
        counts.append(sent)
    # The machine may be busy with something else in most of them.
    assert min(counts) <= 2


def test_a_clock_that_jumps_by_an_hour_misses_no_deadline(robot):
    def shown():
        values = values_of(robot.diagnosis_while_driven(OK, "Running"))
        numbers = values.get("missed deadlines", "0 of 0").split(" of ")
        return *map(int, numbers), int(values.get("clock jumps", 0))

    def newer():
        before = shown()
        return robot.graph.spin_until(lambda: (s := shown()) != before and s, what="figures")

    missed, answered, jumps = newer()
    robot.step += 180_000
    robot.drive()
    now_missed, now_answered, now_jumps = newer()
    assert now_missed == missed
    assert now_answered - answered < 1000
    assert now_jumps == jumps + 1


def test_silence_leads_to_zero_torques_and_the_next_state_back(robot):
    robot.drive()
    torques, step = robot.wait_for_command()
    assert not torques.any()  # the last state is too old to brake by
    assert step == robot.step
    robot.diagnosis(ERROR, "no usable joint_states came for 1 s")
    assert robot.is_driven()
    robot.diagnosis_while_driven(OK, "Running")


@pytest.mark.parametrize("names", [list("abcde"), []])
def test_joint_states_of_another_robot_are_as_good_as_silence(robot, names):
    robot.drive()
    message = robot.message()
    message.name = names
    robot.states.publish(message)
    assert not robot.wait_for_command()[0].any()
    robot.diagnosis(ERROR, "no usable joint_states came for 1 s")
    assert robot.is_driven()


def test_a_policy_whose_torques_are_not_finite_gives_way_to_the_safe_action(robot):
    robot.publish_policy(robot.policy, parameters=[1e308] * len(robot.policy.parameters))
    state = 5.0 * np.ones(10)
    robot.graph.spin_until(
        lambda: np.array_equal(robot.drive(state), braking(robot, state)), what="the new policy"
    )
    robot.diagnosis(ERROR, "the policy's output is")
    robot.publish_policy(robot.policy)
    robot.graph.spin_until(robot.is_driven, what="the old policy")


def test_a_policy_is_swapped_between_two_states_and_a_wrong_one_is_not_taken(robot, random_policy):
    def answer(policy):
        return np.clip(mean(policy), -LIMITS, LIMITS)

    old, new = robot.policy, random_policy(7)
    answers = [robot.drive() for _ in range(5)]
    robot.publish_policy(new, noise_std=[NAN, 1.0])
    robot.diagnosis(ERROR, "Refused a policy, and the one before stays: policy.noise_std is nan")
    answers += [robot.drive() for _ in range(5)]
    assert all(np.array_equal(torques, answer(old)) for torques in answers)
    robot.publish_policy(new)
    answers = []
    robot.graph.spin_until(lambda: answers.append(robot.drive()) or len(answers) > 50)
    which = [np.array_equal(torques, answer(new)) for torques in answers]
    assert all(np.array_equal(torques, answer(old)) for torques in answers[: which.index(True)])
    assert which == sorted(which)
    assert which[-1]
    robot.publish_policy(old)
    robot.graph.spin_until(robot.is_driven, what="the old policy")


def test_deactivated_it_ends_with_zero_and_is_silent_whatever_comes(robot):
    robot.drive()
    assert robot.change(Transition.TRANSITION_DEACTIVATE)
    robot.graph.spin_until(lambda: not robot.commands[-1][0].any(), what="the last torques")
    robot.states.publish(robot.message())
    robot.states.publish(robot.message([NAN] * 10))
    assert robot.stays_silent(1.5)  # longer than state_timeout
    assert robot.change(Transition.TRANSITION_ACTIVATE)


def test_recovery_by_hand_needs_a_new_activation_and_rates_are_limited(
    graph, swimmer, random_policy
):
    rate = 50.0
    change = rate * PERIOD * 1e-9
    policy = random_policy(0)
    robot = Robot(graph, swimmer, policy, recovery="manual", torque_rate_limit=rate)
    robot.step = -1  # a new time
    before = np.zeros(2)
    for scale in (1.0, 1.0, -3.0, 4.0):
        torques = robot.drive(scale * STATE)
        wanted = mean(policy, scale * STATE)
        np.testing.assert_array_equal(torques, np.clip(wanted, before - change, before + change))
        before = torques
    robot.send(robot.message([NAN] * 10, robot.step + 1))
    for _ in range(3):
        np.testing.assert_array_equal(robot.drive(), [0.0, 0.0])
    status = robot.diagnosis(ERROR, " is nan; every value")
    assert "until the node is deactivated and activated" in status.message
    for name in ("drive", "stand", "hold", "sit"):  # which would do nothing
        answer = graph.call(Trigger, f"policy_executor/{name}")
        assert not answer.success
        assert answer.message.startswith("Deactivate and activate the node first")
        assert " is nan; every value" in answer.message
    np.testing.assert_array_equal(robot.drive(), [0.0, 0.0])
    assert robot.change(Transition.TRANSITION_DEACTIVATE)
    assert robot.change(Transition.TRANSITION_ACTIVATE)
    np.testing.assert_array_equal(robot.drive(), np.clip(mean(policy), -change, change))
    robot.diagnosis_while_driven(OK, "Running")


def test_a_state_whose_stamp_is_far_from_the_clock_is_refused(graph, swimmer, random_policy):
    policy = random_policy(0)
    robot = Robot(graph, swimmer, policy, wall=True, max_state_age=0.5)
    graph.spin_until(lambda: np.array_equal(robot.drive(), mean(policy)))
    ahead, old = robot.message(step=robot.step + 500), robot.message(step=robot.step)
    graph.spin_for(0.7)
    for message in (ahead, old):
        torques, step = robot.send(message)
        assert not torques.any()
        assert step == robot.step
        robot.diagnosis(ERROR, "max_state_age is 0.5 s")
    graph.spin_until(lambda: np.array_equal(robot.drive(), mean(policy)))
    robot.diagnosis_while_driven(OK, "Running")


def test_with_sim_time_a_clock_that_goes_back_lets_earlier_states_drive(
    graph, swimmer, random_policy
):
    clocks = graph.node.create_publisher(Clock, "/clock", STREAM)
    robot = Robot(graph, swimmer, random_policy(0), use_sim_time=True)
    robot.step = 500
    clocks.publish(Clock(clock=stamp_of(robot.step * PERIOD)))
    robot.drive()
    robot.step = 3
    _, step = robot.send(robot.message(step=robot.step))
    assert step == 501
    clocks.publish(Clock(clock=stamp_of(robot.step * PERIOD)))
    graph.spin_until(lambda: robot.send(robot.message())[1] == robot.step, timeout=2.0)


def test_faults_in_lock_step_change_no_bit_of_the_motion(graph, swimmer, random_policy):
    horizon, policy = 60, random_policy(4)
    start = np.linspace(-0.3, 0.3, 10)
    graph.start(
        "simulation", initial_state=start.tolist(), start_paused=True, wait_timeout=PATIENCE
    )
    executor = graph.start("policy_executor", safe_action="damping")
    received = graph.messages(JointState, "joint_states")
    states = graph.publisher(JointState, "joint_states")
    graph.publish_policy(policy)

    def motion():
        good = [m for m in received if np.isfinite(m.position).all()]
        return {nanoseconds(m.header.stamp) // PERIOD: m for m in good}

    def inject(message):
        if nanoseconds(message.header.stamp) // PERIOD % 7 == 3 and message.position[0] < np.inf:
            bad = state_to_msg(np.full(10, NAN), swimmer.joint_names, message.header.stamp)
            states.publish(bad)

    graph.spin_until(motion)
    graph.node.create_subscription(JointState, "joint_states", inject, STREAM)
    graph.step(horizon)
    graph.spin_until(lambda: horizon in motion())
    assert "joint_states.position of 'root_x' is nan" in executor.output
    rollout = swimmer.dynamics.rollout(start, lambda _, x: mean(policy, x[0])[None], horizon)
    assert len(motion()) == horizon + 1
    for t, message in motion().items():
        found = state_from_msg(message, swimmer.joint_names)
        np.testing.assert_array_equal(found, rollout.states[t])


@pytest.fixture
def distribution(swimmer, rng):
    """q(ζ) along a motion of the swimmer, with gains and covariances that are easy to check."""
    horizon = 30
    controls = rng.standard_normal((horizon, 2))
    mean = swimmer.dynamics.rollout(swimmer.initial_state, lambda t, _: controls[t], horizon)
    return TrajectoryDistribution(
        Trajectory(mean.states, mean.controls),
        rng.standard_normal((horizon, 2, 10)),
        np.tile(np.eye(2), (horizon, 1, 1)),
        LinearDynamics(np.zeros((horizon, 10, 10)), np.zeros((horizon, 10, 2))),
        np.tile(0.01 * np.eye(10), (horizon + 1, 1, 1)),
        np.empty((horizon, 0)),
    )


def test_far_from_the_training_it_warns_and_then_follows_the_ddp_solution(
    graph, swimmer, random_policy, distribution, tmp_path
):
    file = tmp_path / "distribution.npz"
    save_distributions([distribution], "swimmer", file)
    published = graph.messages(TrajectoryDistributionMsg, "trajectory_distribution", LATCHED)
    robot = Robot(
        graph,
        swimmer,
        random_policy(0),
        distribution_file=file,
        safe_action="feedback",
        distance_warning=5.0,
        distance_limit=10.0,
    )
    graph.spin_until(lambda: published, what="the distribution of the file")
    marginals = TrainingMarginals(distribution, swimmer.observation, 2)
    q, step, root = distribution, 12, np.zeros(10)
    root[0] = 3.0  # where the swimmer is does not count

    def moved(distance):
        """A state at this distance from the nearest step."""
        direction = np.zeros(10)
        direction[4] = 1.0
        state = q.mean.states[step] + distance * np.sqrt(0.01 + 1e-4) * direction
        return state + root, marginals.nearest(state)

    near, nearest = moved(1.0)
    np.testing.assert_array_equal(robot.drive(near), mean(robot.policy, near))
    status = robot.diagnosis_while_driven(OK, "Running", near)
    assert float(values_of(status)["distance from training"]) == pytest.approx(
        nearest.distance, abs=0.006
    )

    odd, nearest = moved(7.0)
    assert 5 < nearest.distance < 10
    np.testing.assert_array_equal(robot.drive(odd), mean(robot.policy, odd))
    robot.diagnosis(WARN, "above distance_warning, 5")

    far, nearest = moved(14.0)
    assert nearest.distance > 10
    deviation = far - q.mean.states[nearest.step]
    deviation[0] = 0.0
    expected = q.mean.controls[nearest.step] + q.gains[nearest.step] @ deviation
    np.testing.assert_allclose(robot.drive(far), expected, rtol=1e-12)
    robot.diagnosis(ERROR, "above distance_limit, 10")

    np.testing.assert_array_equal(robot.drive(near), mean(robot.policy, near))
    robot.diagnosis_while_driven(OK, "Running", near)
    wrong = distribution_to_msg(q, robot.task.deployment, 0, 1, Time())
    wrong.mean.robot.states[0] = "hip/position"
    distributions = graph.publisher(TrajectoryDistributionMsg, "trajectory_distribution", LATCHED)
    distributions.publish(wrong)
    robot.diagnosis(ERROR, "any before it stays: it is for another robot: its states[0] is 'hip/")
    np.testing.assert_array_equal(robot.drive(near), mean(robot.policy, near))


@pytest.mark.parametrize("way", [pytest.param("INT", marks=pytest.mark.slow), "TERM", "SHUTDOWN"])
def test_the_last_torques_are_zero_however_it_ends(graph, swimmer, random_policy, way):
    robot = Robot(graph, swimmer, random_policy(0))
    assert robot.drive().any()
    robot._commands.clear()
    if way == "SHUTDOWN":
        assert robot.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    else:
        robot.process.send(getattr(signal, f"SIG{way}"))
    torques, stamp = graph.spin_until(lambda: robot.commands, what="the last torques")[-1]
    assert not torques.any()
    assert stamp == robot.step * PERIOD
    robot.states.publish(robot.message())
    assert robot.stays_silent(1.5)
    ended = robot.process.end if way == "SHUTDOWN" else robot.process.wait
    assert ended() == 0, robot.process.output
