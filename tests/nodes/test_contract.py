# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A network of others that remembers former steps drives through the graph, and is checked."""

import numpy as np
import onnx

from tests.bags.altered import without
from tests.nodes.test_onnx_executor import STEPS, drive, motion_of
from tests.onnx_models import elu_layers, elu_model
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.tasks.driver import driver_of


def test_what_it_remembers_is_the_runs_and_a_check_computes_it_again(graph, swimmer, tmp_path):
    """It reads its last actions and the joints, of three steps."""
    layers = elu_layers(3 * (2 + 2 + 2), 2)
    metadata = {
        "joint_names": "back_joint,front_joint",
        "observation_names": "joint_pos,joint_vel,last_action",
        "observation_terms_history_length": "3",
        "observation_terms_scale": "1,0.5,2",
        "action_scale": "5.0",
    }
    path = tmp_path / "policy.onnx"
    onnx.save(elu_model(layers, metadata), path)
    bag = drive(graph, tmp_path, path, limit=100.0)
    states, controls = motion_of(bag, swimmer)
    driver = driver_of(swimmer, open_policy(path))
    law = driver.started()
    inputs = driver.observation(states[:STEPS])
    expected = np.concatenate([law(row[None]) for row in inputs])
    np.testing.assert_allclose(controls[:STEPS], expected, rtol=1e-5, atol=1e-5)
    first_ones = driver.policy.mean(inputs)
    assert np.abs(first_ones - expected)[1:].max() > 0.1  # the memory matters
    found = check_bag(bag, open_policy(path))
    assert found.wrong == found.missing == found.unproved == []
    assert found.counts["mean"] + found.counts["close"] >= STEPS
    count = found.counts.total() - STEPS + 20
    late = check_bag(without(bag, tmp_path / "late", "/joint_command", count), open_policy(path))
    assert late.wrong == []
    assert 1 <= late.counts["remembering"] <= 4
    assert late.counts["close"] + late.counts["mean"] >= STEPS - 24
    assert any("which a policy remembers" in sentence for sentence in late.missing)
