# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""An ONNX file of a policy of ours that remembers former steps."""

import numpy as np

from tests.onnx_models import drawn_policy, exported
from tests.servo_arm import REMEMBERING, write_arm
from vgps_ros.policies.driver import driver_of, observation_of
from vgps_ros.policies.onnx_file import parse_model
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.robot.executed_control import Driver
from vgps_ros.tasks import make_task


def test_the_contract_in_its_metadata_gives_what_the_policy_reads(tmp_path, rng):
    """An arm of servos, whose actions are targets from the start's on."""
    task = make_task(write_arm(tmp_path, task=REMEMBERING))
    policy = drawn_policy(task)
    path = exported(policy, task, tmp_path, "--precision", "float64")
    again = open_policy(path).gaussian
    assert again is not None
    assert again.architecture == policy.architecture
    assert again.parameters.tobytes() == policy.parameters.tobytes()
    # The same file, read by its metadata alone, as other programs read it.
    content = path.read_bytes()
    foreign = OnnxPolicy(content, "The file", task.controls)
    assert foreign.steps == 3
    observation = observation_of(
        foreign, task.deployment.layout, task.deployment.read, task.signals, "The file"
    )
    states = rng.standard_normal((6, 1, 4))
    context = task.signals.constant_context(task.signals.rest, 6)
    laws = (
        Driver(foreign, observation).new_law(),
        driver_of(task.deployment, open_policy(path)).new_law(),
    )
    own = Driver.of(task.observation, policy).observation
    for t in range(6):
        said, ours = (
            law(each.within(context[t])(states[t]))
            for law, each in zip(laws, (observation, own), strict=True)
        )
        np.testing.assert_allclose(said, ours, rtol=1e-9, atol=1e-12)
    names = [p.key for p in parse_model(content, "it").metadata_props]
    assert "observation_terms_lags" in names
