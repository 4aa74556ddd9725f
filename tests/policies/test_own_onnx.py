# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Policies as ONNX graphs: onnxruntime computes the same, and nothing is lost on the way back."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from vgps_ros.bags import BagReader
from vgps_ros.messages.conversions import policy_from_msg
from vgps_ros.policies.onnx_file import ExportedPolicy, from_onnx, to_onnx

SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"
SHAPES = [
    {"hidden_units": ()},
    {"hidden_units": (), "output_bias": False},
    {"activation": "tanh", "hidden_bias": False},
    {"activation": "relu", "hidden_units": (7, 4), "output_bias": False},
    {"hidden_units": (6, 5, 4)},
]
UNLIMITED = (np.full(2, -np.inf), np.full(2, np.inf))


def metadata(policy):
    return {"observation_names": ",".join(policy.observed), "joint_names": "a,b"}


def outputs(content, inputs):
    session = onnxruntime.InferenceSession(content)
    kind = {"tensor(float)": np.float32, "tensor(double)": np.float64}[session.get_inputs()[0].type]
    found = session.run(["actions", "mean", "std"], {"obs": inputs.astype(kind)})
    return [output.astype(float) for output in found]


@pytest.mark.parametrize("shape", SHAPES)
def test_the_graph_is_the_network_in_every_architecture(shape, random_policy, rng):
    policy, limits = random_policy(**shape), (np.array([-0.3, -np.inf]), np.array([np.inf, 0.2]))
    inputs = rng.standard_normal((200, 3))
    for precision, tolerance in (("float64", 1e-14), ("float32", 1e-6)):
        content = to_onnx(ExportedPolicy(policy, limits, precision), metadata(policy))
        onnx.checker.check_model(onnx.load_model_from_string(content), full_check=True)
        actions, mean, std = outputs(content, inputs)
        read = inputs.astype(precision).astype(float)
        np.testing.assert_allclose(mean, policy.mean(read), rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(std, policy.noise_std, rtol=1e-6)
        lowest, highest = (limit.astype(precision).astype(float) for limit in limits)
        np.testing.assert_array_equal(actions, np.clip(mean, lowest, highest))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_reading_it_back_loses_nothing(shape, precision, random_policy):
    policy = random_policy(**shape)
    content = to_onnx(ExportedPolicy(policy, UNLIMITED, precision), metadata(policy))
    kept = from_onnx(content, "it")
    assert kept.policy.architecture == policy.architecture
    np.testing.assert_array_equal(kept.policy.parameters, policy.parameters)
    np.testing.assert_array_equal(kept.policy.noise_std, policy.noise_std)
    assert kept.precision == precision


def test_a_changed_graph_is_not_taken_for_ours(random_policy):
    policy = random_policy()
    model = onnx.load_model_from_string(
        to_onnx(ExportedPolicy(policy, UNLIMITED, "float64"), metadata(policy))
    )
    (smaller,) = [node for node in model.graph.node if node.op_type == "Min"]
    smaller.op_type = "Sum"
    assert from_onnx(model.SerializeToString(), "it") is None


def test_onnxruntime_agrees_on_ten_thousand_states_of_rollouts(swimmer):
    """The policies of a real training, in the states that they lead to."""
    with BagReader(SAMPLE) as bag:
        policy = policy_from_msg(list(bag.decoded(bag.needed_topic("policy")))[-1][1])
    rng = np.random.default_rng(0)
    starts = swimmer.initial_state + 0.05 * rng.standard_normal((20, 10))
    noise = policy.noise_std * rng.standard_normal((20, 500, 2))
    states, _ = swimmer.dynamics.execute(policy, swimmer.observation, starts, noise)
    inputs = swimmer.observation(states[:, :-1].reshape(10_000, 10))
    for precision, tolerance in (("float64", 1e-12), ("float32", 1e-6)):
        content = to_onnx(ExportedPolicy(policy, UNLIMITED, precision), metadata(policy))
        expected = policy.mean(inputs.astype(precision).astype(float))
        error = np.abs(outputs(content, inputs)[1] - expected).max(axis=0)
        assert (error < tolerance * np.abs(expected).max(axis=0)).all(), (precision, error)
