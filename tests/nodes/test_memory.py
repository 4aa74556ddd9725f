# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy of ours that remembers former steps drives through the graph, and is checked."""

from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from tests.bags.altered import without
from tests.nodes.conftest import remember
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.bags.episode import episodes
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

STEPS = 30


@pytest.fixture
def task(told):
    """The rotor that is told its angle, whose policy remembers two steps and its last action."""
    remember(Path(told), 2)
    return make_task(told)


@pytest.fixture
def policy(task):
    shape = Architecture(task.observation.names, (5,), 1)
    draw = np.random.default_rng(0).standard_normal
    return GaussianPolicy(shape, 0.2 * draw(shape.num_parameters), np.full(1, 0.3))


@pytest.mark.parametrize("stochastic", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_executor_remembers_as_rollouts_do_and_a_check_computes_it_again(
    graph, task, policy, tmp_path, stochastic
):
    path, told = tmp_path / "policy.json", task.name
    save_policy(policy, told, path)
    given = {"policy_file": path, "stochastic": stochastic, "seed": 3}
    bag = graph.record_run(STEPS, told, **given)
    with BagReader(bag) as reader:
        episode = episodes(reader, task.dynamics.model)[-1]
    if not stochastic:
        held = task.signals.constant_context(task.signals.rest, STEPS)
        _, controls = task.dynamics.execute(
            policy, task.observation.within(held), episode.states[:1], np.zeros((1, STEPS, 1))
        )
        np.testing.assert_array_equal(episode.controls[1 : STEPS + 1], controls[0])
    found = check_bag(bag, open_policy(path))
    assert found.wrong == found.missing == found.unproved == []
    assert found.counts["noisy" if stochastic else "mean"] >= STEPS
    count = found.counts.total() - STEPS + 10
    rest = without(tmp_path / "late", "/joint_command", range(count), bag)
    late = check_bag(rest, open_policy(path))
    assert late.wrong == []
    assert 1 <= late.counts["remembering"] <= 4
    assert any("which a policy remembers" in sentence for sentence in late.missing)


def test_mpc_refuses_such_a_policy(graph, task, policy):
    graph.start("mpc", task=task.name)
    graph.publish_policy(policy, task.name)
    graph.diagnosis("mpc", DiagnosticStatus.ERROR, "it remembers former steps")
