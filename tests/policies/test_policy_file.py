# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy is opened from each kind of file, and what is none is refused with a sentence."""

import json
from dataclasses import fields

import numpy as np
import pytest

from tests.motors import motors, named
from tests.onnx_models import elu_layers, elu_mean, elu_model
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.onnx_file import ExportedPolicy, to_onnx
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.storage.run_folder import RunFolder

UNLIMITED = (np.full(2, -np.inf), np.full(2, np.inf))


def saved(folder, policy):
    """Writes a policy.json, and an ONNX file of the same policy; returns their paths."""
    run = RunFolder(folder / "run")
    run.save({"task": "rotor", "initial_ddp_cost": 2.0, "iterations": []}, policy)
    onnx = folder / "policy.onnx"
    says = {"task": "rotor", "observation_names": "a,b", "joint_names": "hip,knee"}
    onnx.write_bytes(to_onnx(ExportedPolicy(policy, UNLIMITED, "float64"), says))
    return run.policy, onnx


def test_both_kinds_of_file_hold_the_same_policy_to_the_bit(random_policy, tmp_path):
    policy = random_policy(("a", "b"))
    for path in saved(tmp_path, policy):
        opened = open_policy(path)
        assert (opened.name, opened.task) == (f"'{path}'", "rotor")
        same = opened.policy(named(motors(1.0, 1.0), ["hip", "knee"]))
        assert same.parameters.tobytes() == policy.parameters.tobytes()
        assert same.noise_std.tobytes() == policy.noise_std.tobytes()
        assert same.architecture == policy.architecture


def test_a_network_of_others_is_executed_for_the_robots_joints(tmp_path, rng):
    layers, path = elu_layers(2, 2), tmp_path / "others.onnx"
    names = {"joint_names": "hip,knee", "observation_names": "a,b"}
    path.write_bytes(elu_model(layers, names).SerializeToString())
    opened, inputs = open_policy(path), rng.standard_normal(2)
    assert (opened.task, opened.gaussian) == ("", None)
    mean = opened.policy(named(motors(1.0, 1.0), ["hip", "knee"])).mean(inputs)
    np.testing.assert_allclose(mean, elu_mean(layers, inputs), atol=1e-6)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda text: None, "is not a readable policy file .* name the policy.json of a run"),
        (lambda text: text[:-20], "is not a readable policy file"),
        (lambda text: "[" * 100_000, "is not a readable policy file"),
        (lambda text: "[]", "is not a policy of vgps_ros"),
        (lambda text: without(text, "task"), "is not a policy of vgps_ros .'task'"),
        (lambda text: without(text, "parameters"), "is not a policy of vgps_ros .'parameters'"),
        (lambda text: text.replace('"softplus"', '"sine"'), "is not a policy of vgps_ros .*sine"),
    ],
)
def test_what_is_no_policy_is_refused_with_a_sentence(change, sentence, random_policy, tmp_path):
    path, _ = saved(tmp_path, random_policy(("a", "b")))
    text = change(path.read_text())
    path.unlink()
    if text is not None:
        path.write_text(text)
    with pytest.raises(InvalidInputError, match=rf"(?s)^{path} {sentence}.*\.$"):
        open_policy(path)


def without(text, key):
    content = json.loads(text)
    assert key in content
    return json.dumps({name: value for name, value in content.items() if name != key})


def test_each_number_of_the_architecture_stands_in_the_file(random_policy, tmp_path):
    policy = random_policy(("a", "b"), (4, 3))
    content = json.loads(saved(tmp_path, policy)[0].read_text())
    for field in fields(policy.architecture):
        value = getattr(policy.architecture, field.name)
        assert content[field.name] == (list(value) if isinstance(value, tuple) else value)
