# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A network of others that remembers former steps drives through the graph, and is checked."""

import numpy as np
import onnx
import pytest
from lifecycle_msgs.msg import Transition

from tests.bags.altered import without
from tests.nodes.conftest import Hardware
from tests.nodes.test_onnx_executor import STEPS, drive, motion_of
from tests.onnx_models import elu_layers, elu_model
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.policy_file import open_policy


@pytest.fixture
def path(tmp_path):
    """A policy of the swimmer that reads its last actions and the joints, of three steps."""
    layers = elu_layers(3 * (2 + 2 + 2), 2)
    metadata = {
        "joint_names": "back_joint,front_joint",
        "observation_names": "joint_pos,joint_vel,last_action",
        "observation_terms_history_length": "3",
        "observation_terms_scale": "1,0.5,2",
        "action_scale": "5.0",
    }
    onnx.save(elu_model(layers, metadata), tmp_path / "policy.onnx")
    return tmp_path / "policy.onnx"


def test_what_it_remembers_is_the_runs_and_a_check_computes_it_again(
    graph, swimmer, path, tmp_path
):
    bag = drive(graph, path, limit=100.0)
    states, controls = motion_of(bag, swimmer)
    driver = driver_of(swimmer.deployment, open_policy(path))
    law = driver.new_law()
    inputs = driver.observation(states[:STEPS])
    expected = np.concatenate([law(row[None]) for row in inputs])
    np.testing.assert_allclose(controls[:STEPS], expected, rtol=1e-5, atol=1e-5)
    first_ones = driver.policy.mean(inputs)
    assert np.abs(first_ones - expected)[1:].max() > 0.1  # the memory matters
    found = check_bag(bag, open_policy(path))
    assert found.wrong == found.missing == found.unproved == []
    assert found.counts["mean"] + found.counts["close"] >= STEPS
    count = found.counts.total() - STEPS + 20
    rest = without(tmp_path / "late", "/joint_command", range(count), bag)
    late = check_bag(rest, open_policy(path))
    assert late.wrong == []
    assert 1 <= late.counts["remembering"] <= 4
    assert late.counts["close"] + late.counts["mean"] >= STEPS - 24
    assert any("which a policy remembers" in sentence for sentence in late.missing)


def test_it_begins_anew_where_it_is_activated_again(graph, swimmer, path):
    graph.start("policy_executor", autostart=False, policy_file=path)
    robot = Hardware(graph, swimmer)

    def answer(step):
        return robot.answer(np.ones(10), step * 20_000_000)

    assert graph.change(Transition.TRANSITION_CONFIGURE)
    assert graph.change(Transition.TRANSITION_ACTIVATE)
    driver = driver_of(swimmer.deployment, open_policy(path))
    inputs = driver.observation(np.ones((1, 10)))
    law = driver.new_law()
    for step in (1, 2, 3):
        wanted = law(inputs)[0]
        for _ in range(2):  # a state that comes twice is answered twice
            np.testing.assert_allclose(answer(step), wanted, rtol=1e-5)
    first = driver.policy.mean(inputs)[0]
    assert np.abs(wanted - first).max() > 0.1
    assert graph.change(Transition.TRANSITION_DEACTIVATE)
    assert graph.change(Transition.TRANSITION_ACTIVATE)
    np.testing.assert_allclose(answer(4), first, rtol=1e-5)
