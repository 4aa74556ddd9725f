# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The limits of a robot's motor hold alike in the graph, in a bag's check and in process."""

import signal

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from numpy.testing import assert_array_equal
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg

from tests.limited_pendulum import HIGH, LOW, write_task
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.bags.episode import episodes
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import policy_to_msg
from vgps_ros.ros_runtime.qos import LATCHED
from vgps_ros.tasks import make_task


@pytest.mark.slow
def test_executor_simulation_check_and_process_clip_to_the_same_bit(graph, tmp_path):
    task = make_task(write_task(tmp_path))
    shape = Architecture(task.observation.names, (), 1)
    # It swings, with torques to both sides beyond what the motor can do.
    policy = GaussianPolicy(shape, [-8.0, 0.0, 2.0], [1.0])
    recorder = graph.start("recorder", output=tmp_path / "bag")
    graph.spin_until_output(recorder, "Recording to")
    policies = graph.node.create_publisher(GaussianPolicyMsg, "policy", LATCHED)
    policies.publish(policy_to_msg(policy, task.name, 1, Time()))
    graph.start("simulation", task=task.name, start_paused=True)
    executor = graph.start("policy_executor", task=task.name)
    for topic in ("joint_states", "joint_command", "policy"):
        count = graph.node.count_subscribers
        graph.spin_until(lambda t=topic, n=count: n(t) == 2, what=f"listeners of {topic}")
    graph.spin_until(lambda: graph.node.count_subscribers("mjcf_description") == 1)
    program = graph.start("execute_policy", "--task", task.name, "--steps", "50")
    graph.spin_until(lambda: not program.running)
    assert program.wait() == 0, program.output
    assert executor.end() == 0
    graph.spin_for(0.5)  # until its last torques, which are zero, are recorded
    assert recorder.end(signal.SIGINT) == 0, recorder.output

    with BagReader(tmp_path / "bag") as bag:
        episode = episodes(bag, task.dynamics.model)[-1]
    start, noise = task.initial_state[None], np.zeros((1, 50, 1))
    states, controls = task.dynamics.execute(policy, task.observation, start, noise)
    assert {LOW, HIGH} <= set(controls.ravel().tolist())
    found = check_bag(tmp_path / "bag")
    assert found.wrong == []
    assert found.counts["mean"] >= 50
    assert found.counts["safe"] == 1  # the executor's last word: it did not drive any more
    assert_array_equal(episode.controls[1:51], controls[0])
    assert_array_equal(episode.states[:51], states[0])
