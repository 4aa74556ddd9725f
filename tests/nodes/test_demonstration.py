"""The node `demonstration` answers states as its controller would in this process."""

import numpy as np
from numpy.testing import assert_array_equal
from sensor_msgs.msg import JointState

from vgps_ros.messages.conversions import command_from_msg, stamp_of, state_to_msg
from vgps_ros.tasks import make_task
from vgps_ros.tasks.simbicon import GAIT, walk

PERIOD = 10_000_000  # [ns]


def test_its_torques_are_the_controllers_and_a_reset_starts_the_gait_anew(graph):
    walker = make_task("walker")
    walking = walk(walker.dynamics, GAIT, 20)
    graph.start("demonstration")
    commands = graph.messages(JointState, "joint_command")
    states = graph.publisher(JointState, "joint_states")
    graph.spin_until(lambda: graph.node.count_publishers("joint_command"))
    graph.spin_until(lambda: graph.node.count_subscribers("joint_states"))

    def answer(t):
        commands.clear()
        stamp = stamp_of(t * PERIOD)
        states.publish(state_to_msg(np.array(walking.states[t]), walker.joint_names, stamp))
        found = graph.spin_until(lambda: list(commands), what="torques")
        return command_from_msg(found[-1], walker.actuated_joint_names)

    for _ in range(2):
        assert_array_equal([answer(t) for t in range(20)], walking.controls)
