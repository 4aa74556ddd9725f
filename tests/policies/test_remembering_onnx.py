# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""An ONNX file of a policy of ours that remembers former steps."""

import numpy as np

from tests.servo_arm import SERVOS
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.policies.driver import Driver, observation_of
from vgps_ros.policies.onnx_file import parsed
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

TASK = """
model: arm.xml
control_period: 0.02
horizon: 1.0
start: {keyframe: home}
clock: {frequency: 2.0}
cost: [{control: all, weight: 1.0}]
observe: [joint_positions, last_action, clock, joint_velocities]
history: 2
"""


def test_the_contract_in_its_metadata_gives_what_the_policy_reads(tmp_path, rng):
    """An arm of servos, whose actions are targets from the start's on."""
    (tmp_path / "arm.xml").write_text(SERVOS)
    (tmp_path / "task.yaml").write_text(TASK)
    task = make_task(str(tmp_path / "task.yaml"))
    shape = Architecture(task.observation.names, (5,), 2)
    policy = GaussianPolicy(shape, rng.standard_normal(shape.num_parameters), np.ones(2))
    save_policy(policy, task.name, tmp_path / "policy.json")
    path = tmp_path / "policy.onnx"
    words = [str(tmp_path / "policy.json"), "--output", str(path), "--precision", "float64"]
    vgps(["export", *words])
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
    context = task.signals.held(task.signals.rest, 6)
    laws = Driver(foreign, observation).started(), task.driver(open_policy(path)).started()
    own = Driver.of(task.observation, policy).observation
    for t in range(6):
        said, ours = (
            law(each.within(context[t])(states[t]))
            for law, each in zip(laws, (observation, own), strict=True)
        )
        np.testing.assert_allclose(said, ours, rtol=1e-9, atol=1e-12)
    names = [p.key for p in parsed(content, "it").metadata_props]
    assert "observation_terms_lags" in names
