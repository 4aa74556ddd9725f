# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""ONNX files of policies that are told commands and a clock."""

import numpy as np

from tests.nodes.conftest import told  # noqa: F401
from tests.onnx_models import elu_layers, elu_mean, elu_model
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.onnx_file import ExportedPolicy, to_onnx
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.programs.export import metadata
from vgps_ros.tasks import make_task

TOLD = ("command/angle", "command/lift", "clock/sin", "clock/cos")


def test_an_exported_policy_names_what_it_is_told_and_drives_again(told, tmp_path):  # noqa: F811
    task = make_task(told)
    shape = Architecture(task.observation.names, (5,), 1)
    draw = np.random.default_rng(0).standard_normal
    policy = GaussianPolicy(shape, draw(shape.num_parameters), np.ones(1))
    exported = ExportedPolicy(policy, task.dynamics.control_limits, "float64")
    said = metadata(task, policy, tmp_path)
    assert tuple(said["observation_names"].split(",")[-4:]) == TOLD
    (tmp_path / "policy.onnx").write_bytes(to_onnx(exported, said))
    driver = driver_of(task.deployment, open_policy(tmp_path / "policy.onnx"))
    context, state = task.signals.context(np.array([0.5, 0.1]), np.array(0.3)), np.ones(2)
    inputs = np.concatenate([state, context])
    np.testing.assert_array_equal(driver.observation.within(context)(state), inputs)
    np.testing.assert_array_equal(driver.policy.mean(inputs), policy.mean(inputs))


def test_a_third_party_network_is_told_by_name_in_any_order(told, tmp_path):  # noqa: F811
    task, layers = make_task(told), elu_layers(4, 1)
    names = ["rotor/velocity", "clock/cos", "clock/sin", "command/angle"]
    file = tmp_path / "other.onnx"

    def write(observed):
        said = {"observation_names": ",".join(observed), "joint_names": "rotor"}
        file.write_bytes(elu_model(layers, said).SerializeToString())

    context = task.signals.context(np.array([0.5, 0.1]), np.array(0.3))
    own = np.array([-0.7, context[3], context[2], 0.5])
    for order in ([0, 1, 2, 3], [3, 1, 0, 2]):
        write([names[i] for i in order])
        driver = driver_of(task.deployment, open_policy(file))
        mean = driver.policy.mean(driver.observation.within(context)(np.array([0.2, -0.7])))
        np.testing.assert_allclose(mean, elu_mean(layers, own[order]), rtol=1e-5)
