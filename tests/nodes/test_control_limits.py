# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The limits of a robot's motor hold alike in the graph, in a bag's check and in process."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.limited_pendulum import HIGH, LOW, write_task
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.bags.episode import episodes
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.tasks import make_task


@pytest.mark.slow
def test_executor_simulation_check_and_process_clip_to_the_same_bit(graph, tmp_path):
    task = make_task(write_task(tmp_path))
    shape = Architecture(task.observation.names, (), 1)
    # It swings, with torques to both sides beyond what the motor can do.
    policy = GaussianPolicy(shape, [-8.0, 0.0, 2.0], [1.0])
    graph.publish_policy(policy, task.name)
    graph.record_run(50, task.name, to_its_end=True)
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
