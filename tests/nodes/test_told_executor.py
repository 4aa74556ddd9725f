# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A controller that is told what to do: commands, a clock, and what becomes of wrong ones."""

from itertools import count
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from sensor_msgs.msg import JointState
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.msg import Signals as SignalsMsg

from tests.nodes.conftest import executed, values_of
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import nanoseconds, policy_to_msg, stamp_of, state_to_msg
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.ros_runtime.qos import LATCHED
from vgps_ros.tasks import make_task, registry

PERIOD = 50_000_000  # [ns]
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def twist(z, frame=""):
    message = TwistStamped()
    message.header.frame_id = frame
    message.twist.angular.z = z
    return message


def test_commands_reach_the_policy_and_wrong_ones_are_refused_with_a_sentence(graph, told):
    task = make_task(told)
    shape = Architecture(task.observation.names, (5,), 1)
    draw = np.random.default_rng(0).standard_normal
    policy = GaussianPolicy(shape, draw(shape.num_parameters), np.ones(1))
    graph.start("policy_executor", task=told, command_timeout=1000.0)
    contexts = graph.messages(SignalsMsg, "context")
    answers = graph.messages(JointState, "joint_command")
    states = graph.publisher(JointState, "joint_states")
    cmd_vel = graph.publisher(TwistStamped, "cmd_vel")
    command = graph.publisher(SignalsMsg, "command")
    policies = graph.publisher(GaussianPolicyMsg, "policy", LATCHED)
    graph.diagnosis("policy_executor", OK, "Waiting for policy")
    policies.publish(policy_to_msg(policy, task.name, 1, Time()))
    state, steps = np.array([0.3, -0.2]), count(1)

    def context(step):
        """Sends a state; returns the context of the answer, which must be the policy's."""
        contexts.clear()
        answers.clear()

        def are_there():
            said = [c for c in contexts if nanoseconds(c.header.stamp) == step * PERIOD]
            sent = [a for a in answers if nanoseconds(a.header.stamp) == step * PERIOD]
            return (said[-1], sent[-1]) if said and sent else None

        states.publish(state_to_msg(state, task.joint_names, stamp_of(step * PERIOD)))
        said, sent = graph.spin_until(are_there, what="an answer with its context")
        assert tuple(said.names) == task.signals.names
        inputs = np.concatenate([state, said.values])
        np.testing.assert_array_equal(sent.effort, executed(policy, inputs))
        return np.array(said.values)

    def after(publisher, message, level, sentence=""):
        publisher.publish(message)
        graph.diagnosis("policy_executor", level, sentence, 20.0)

    def check(step, angle, lift):
        """The clock turns once in ten steps."""
        turned = 0.2 * np.pi * step
        expected = [angle, lift, np.sin(turned), np.cos(turned)]
        np.testing.assert_allclose(context(step), expected, atol=1e-12)

    graph.spin_for(2.0)  # until the policy is there
    check(next(steps), 0.0, 0.0)
    after(cmd_vel, twist(0.5), OK)
    for _ in range(3):
        check(next(steps), 0.5, 0.0)
    check(4, 0.5, 0.0)  # again
    after(cmd_vel, twist(7.0), WARN, "angle is 7, but it must be from -1 to 1 rad")
    check(next(steps), 1.0, 0.0)
    late, now = twist(0.5), graph.node.get_clock().now().nanoseconds
    late.header.stamp = stamp_of(now - 5000 * 10**9)
    sentence = "it was sent 5e+03 s ago, but command_timeout is 1000 s; synchronise the clocks"
    after(cmd_vel, late, ERROR, sentence)
    check(next(steps), 1.0, 0.0)
    late.header.stamp = stamp_of(now - 10**16)  # by another clock, as that of a simulation
    after(cmd_vel, late, OK)
    check(next(steps), 0.5, 0.0)
    after(cmd_vel, twist(float("nan")), ERROR, "Refused a cmd_vel; any before it stays")
    after(cmd_vel, twist(0.1, "map"), ERROR, "its frame is 'map', but it must be that of")
    wrong = SignalsMsg(names=["speed"], values=[1.0])
    after(command, wrong, ERROR, "there is no command 'speed', but angle, lift.")
    for names, values, sentence in (
        (["lift"], [float("nan")], "values is nan at index 0; every value must be finite."),
        (["lift"], [float("inf")], "values is inf at index 0; every value must be finite."),
        (["lift", "angle"], [0.5], "values has 1 values, but shape (2,) needs 2."),
        (["lift", "lift"], [0.1, 0.2], "The names are ['lift', 'lift'], but each may come only"),
    ):
        after(command, SignalsMsg(names=names, values=values), ERROR, sentence)
    check(next(steps), 0.5, 0.0)
    command.publish(SignalsMsg(names=["lift"], values=[0.25]))
    after(cmd_vel, twist(-0.5), OK)
    check(next(steps), -0.5, 0.25)
    for step in (100, 103, 0):  # after a gap, and where time goes back
        check(step, -0.5, 0.25)
    assert graph.set_parameter("policy_executor", "command_timeout", 0.01).successful
    assert not graph.set_parameter("policy_executor", "commands.lowest", [-9.0, 0.0]).successful
    check(1, 0.0, 0.0)
    values = values_of(graph.diagnosis("policy_executor", OK))
    assert values["command angle"] == "0 rad"


def test_an_unstamped_cmd_vel_is_taken_where_a_parameter_says_so(graph, told):
    graph.start("policy_executor", task=told, stamped_cmd_vel=False)
    cmd_vel = graph.publisher(Twist, "cmd_vel")
    graph.diagnosis("policy_executor", OK, "Waiting for policy")
    graph.spin_for(1.0)  # until the executor knows the publisher
    message = Twist()
    message.angular.z = -7.0
    cmd_vel.publish(message)
    sentence = "angle is -7, but it must be from -1 to 1 rad"
    graph.diagnosis("policy_executor", WARN, sentence, 20.0)
    message.angular.z = float("inf")
    cmd_vel.publish(message)
    graph.diagnosis("policy_executor", ERROR, "cmd_vel is inf at index 0", 20.0)


def test_a_quadruped_steps_at_rest_only_after_it_was_tilted(graph):
    """Its clock stands still, turns for 1.5 s of the stamps, and stands still again."""
    task = make_task("quadruped")
    policy = Path(registry.__file__).parent / "quadruped" / "policy.json"
    graph.start("policy_executor", task="quadruped", policy_file=policy, base_from="odom")
    contexts = graph.messages(SignalsMsg, "context")
    messages = StateMessages(task.deployment.layout)
    senders = {topic: graph.publisher(kind, topic) for topic, kind in messages.topics.items()}
    graph.diagnosis("policy_executor", OK, "Waiting for odom and joint_states")
    tilted = task.initial_state.copy()
    tilted[3:7] = np.cos(0.05), np.sin(0.05), 0.0, 0.0  # by 0.1 rad
    for step, state, turns in (
        (1, task.initial_state, False),
        (2, tilted, True),
        (3, task.initial_state, True),
        (76, task.initial_state, True),
        (77, task.initial_state, False),
    ):
        stamp = 20_000_000 * step

        def said(stamp=stamp):
            found = [c for c in contexts if nanoseconds(c.header.stamp) == stamp]
            return found[-1] if found else None

        for topic, message in messages.split(state, stamp_of(stamp)).items():
            senders[topic].publish(message)
        context = np.array(graph.spin_until(said, what="a context").values)
        signals = task.signals.turning if turns else task.signals
        wanted = signals.context(np.zeros(3), np.array(task.signals.phase_at(stamp)))
        np.testing.assert_allclose(context, wanted, atol=1e-12)
        assert context[3:].any() == turns
