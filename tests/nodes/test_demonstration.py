# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The node `demonstration` answers states as its controller would in this process."""

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from numpy.testing import assert_array_equal
from sensor_msgs.msg import JointState

from tests.nodes.malformed import broken
from vgps_ros.messages.conversions import command_from_msg, stamp_of, state_to_msg
from vgps_ros.tasks import make_task
from vgps_ros.tasks.walker.simbicon import GAIT, TORQUE_LIMIT, walk

PERIOD = 10_000_000  # [ns]


def _start(graph):
    """Starts the node; returns it, its commands and a publisher of states, once they are found."""
    node = graph.start("demonstration")
    commands = graph.messages(JointState, "joint_command")
    states = graph.publisher(JointState, "joint_states")
    graph.spin_until(lambda: graph.node.count_publishers("joint_command"))
    graph.spin_until(lambda: graph.node.count_subscribers("joint_states"))
    return node, commands, states


def test_its_torques_are_the_controllers_and_a_reset_starts_the_gait_anew(graph):
    walker = make_task("walker")
    walking = walk(walker.dynamics, GAIT, 20)
    _, commands, states = _start(graph)

    def answer(t):
        commands.clear()
        stamp = stamp_of(t * PERIOD)
        states.publish(state_to_msg(np.array(walking.states[t]), walker.joint_names, stamp))
        found = graph.spin_until(lambda: list(commands), what="torques")
        return command_from_msg(found[-1], walker.controls)

    for _ in range(2):
        assert_array_equal([answer(t) for t in range(20)], walking.controls)


def test_malformed_states_draw_only_finite_torques_within_limits_and_end_nothing(graph):
    walker = make_task("walker")
    node, commands, states = _start(graph)
    standing = state_to_msg(walker.initial_state, walker.joint_names, stamp_of(PERIOD))
    flood = settings(
        max_examples=200,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
        deadline=None,
    )

    @flood
    @given(broken(standing))
    def publish(message):
        states.publish(message)
        graph.spin_for(0.001)

    publish()
    answered = stamp_of(2 * PERIOD)
    states.publish(state_to_msg(walker.initial_state, walker.joint_names, answered))
    graph.spin_until(lambda: commands and commands[-1].header.stamp == answered, what="torques")
    torques = np.array([command_from_msg(m, walker.controls) for m in commands])
    assert np.abs(torques).max() <= TORQUE_LIMIT
    assert node.running
    assert "Traceback" not in node.output, node.output
