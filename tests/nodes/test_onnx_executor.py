# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Policies in ONNX files drive the robot through the graph, and their bags are checked."""

import numpy as np
import onnx
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg

from tests.nodes.conftest import values_of
from tests.onnx_models import elu_layers, elu_model, exported
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.bags.episode import episodes
from vgps_ros.messages.conversions import policy_to_msg
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.ros_runtime.qos import LATCHED

STEPS = 60


def drive(graph, policy, limit):
    """Lets the policy of a file drive the swimmer, with narrow limits; returns the bag."""
    given = {"torque_limits": [limit, limit], "safe_action": "damping"}
    return graph.record_run(STEPS, "swimmer", policy_file=policy, **given)


def motion_of(bag_path, task):
    with BagReader(bag_path) as bag:
        episode = episodes(bag, task.dynamics.model)[-1]
    return episode.states[: STEPS + 1], episode.controls[1 : STEPS + 1]


def rollout(task, law, limit):
    limited = task.dynamics.rollout(
        task.initial_state, lambda _, x: np.clip(law(x), -limit, limit), STEPS
    )
    assert (np.abs(limited.controls) == limit).any()
    assert (np.abs(limited.controls) < limit).any()
    return limited


def test_our_own_file_drives_to_the_same_bits_as_the_policy(
    graph, swimmer, random_policy, tmp_path
):
    policy = random_policy(5)
    path = exported(policy, swimmer, tmp_path, "--precision", "float64")
    bag = drive(graph, path, limit=1.5)
    states, controls = motion_of(bag, swimmer)
    expected = rollout(swimmer, lambda x: policy.mean(swimmer.observation(x)), 1.5)
    np.testing.assert_allclose(controls, expected.controls, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(states, expected.states, rtol=1e-9, atol=1e-12)
    for file in (path, tmp_path / "policy.json"):
        found = check_bag(bag, open_policy(file))
        assert found.wrong == found.missing == found.unproved == []
        assert found.counts["mean"] >= STEPS
    assert not check_bag(bag).unproved


@pytest.fixture
def foreign(swimmer, tmp_path):
    """Writes a third-party policy: torques beyond the limits, joints in another order."""

    def write(name, seed=0):
        layers = elu_layers(len(swimmer.observation.names), 2, seed=seed)
        metadata = {
            "joint_names": "back_joint,front_joint",
            "observation_names": ",".join(swimmer.observation.names),
            "action_scale": "5.0",
        }
        onnx.save(elu_model(layers, metadata), tmp_path / name)
        return tmp_path / name

    return write


def test_a_network_of_others_drives_within_the_limits_and_its_bag_is_checked(
    graph, swimmer, foreign, tmp_path
):
    path = foreign("policy.onnx")
    bag = drive(graph, path, limit=0.55)
    states, controls = motion_of(bag, swimmer)
    driver = driver_of(swimmer.deployment, open_policy(path))
    expected = rollout(swimmer, lambda x: driver.policy.mean(driver.observation(x)), 0.55)
    np.testing.assert_allclose(controls, expected.controls, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(states, expected.states, rtol=1e-6, atol=1e-6)
    found = check_bag(bag, open_policy(path))
    assert found.wrong == found.missing == found.unproved == []
    assert found.counts["mean"] + found.counts["close"] >= STEPS
    other = check_bag(bag, open_policy(foreign("other.onnx", seed=1)))
    assert other.unproved == ["the policies, of which none is the file's"]


def test_a_wrong_file_ends_the_start_with_a_sentence(graph, foreign, tmp_path):
    path = tmp_path / "policy.onnx"
    path.write_bytes(foreign("whole.onnx").read_bytes()[:-40])
    executor = graph.start("policy_executor", policy_file=path)
    assert executor.wait() == 1
    assert "is not an ONNX model, or is damaged" in executor.output
    assert "Traceback" not in executor.output
    planner = graph.start("mpc", policy_file=tmp_path / "whole.onnx")
    assert planner.wait() == 1
    assert "a third-party ONNX policy, which only policy_executor can execute" in planner.output


def test_a_policy_of_the_topic_takes_over_from_the_file(graph, swimmer, foreign, random_policy):
    graph.start("policy_executor", policy_file=foreign("policy.onnx"))
    status = graph.diagnosis("policy_executor", DiagnosticStatus.OK, "Waiting for joint_states")
    assert values_of(status)["policy of iteration"] == "0"
    policies = graph.publisher(GaussianPolicyMsg, "policy", LATCHED)
    policies.publish(policy_to_msg(random_policy(1), "swimmer", 7, Time()))

    def takes_over():
        status = graph.diagnosis("policy_executor", DiagnosticStatus.OK)
        return values_of(status)["policy of iteration"] == "7"

    graph.spin_until(takes_over)
