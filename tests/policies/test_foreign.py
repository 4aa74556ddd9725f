# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files that other projects write beside their policies become one kind of contract."""

import numpy as np
import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.contract import Contract
from vgps_ros.policies.foreign import GO1_OF_PLAYGROUND, read_contract

JOINTS = ("left_hip", "left_knee", "right_hip", "right_knee")
DEPLOY = """
joint_ids_map: [0, 2, 1, 3]
step_dt: 0.02
stiffness: [100, 150, 101, 151]
damping: [2, 4, 2, 4]
default_joint_pos: [-0.1, -0.2, 0.3, 0.4]
actions:
  JointPositionAction:
    clip: null
    scale: [0.25, 0.25, 0.25, 0.25]
    offset: [-0.1, -0.2, 0.3, 0.4]
    joint_ids: !!python/object/apply:builtins.slice [null, null, null]
observations:
  base_ang_vel: {params: {}, clip: null, scale: [0.2, 0.2, 0.2], history_length: 2}
  joint_pos_rel: {params: {}, clip: [-3, 3], scale: null, history_length: 2}
  gait_phase: {params: {period: 0.8}, clip: null, scale: [1.0, 1.0], history_length: 2}
"""
RL_SAR = """
biped/legged_gym:
  observations: ["ang_vel", "commands", "dof_vel", "actions"]
  observations_history: [2, 1, 0]
  clip_obs: 100.0
  clip_actions_lower: [-9, -9, -9, -9]
  clip_actions_upper: [8, 8, 8, 8]
  rl_kp: [20.0, 21.0, 22.0, 23.0]
  rl_kd: [0.5, 0.5, 0.5, 0.5]
  action_scale: [0.125, 0.25, 0.125, 0.25]
  ang_vel_scale: 0.25
  dof_vel_scale: 0.05
  commands_scale: [2.0, 2.0, 0.25]
  default_dof_pos: [0.1, 0.2, 0.3, 0.4]
  joint_mapping: [2, 3, 0, 1]
"""


def written(folder, text, base=""):
    (folder / "legged_gym").mkdir(exist_ok=True)
    path = folder / "legged_gym" / "config.yaml"
    path.write_text(text)
    if base:
        (folder / "base.yaml").write_text(base)
    return path


def contract(*arguments):
    return Contract(read_contract(*arguments, JOINTS, [0.1, 0.2, 0.3, 0.4]), "The file")


def test_a_deploy_yaml_of_unitree(tmp_path):
    """Its gains are in the motors' order, all else in the policy's."""
    found = contract(written(tmp_path, DEPLOY))
    assert found.joints == ("left_hip", "right_hip", "left_knee", "right_knee")
    np.testing.assert_array_equal(found.stiffness, [100, 101, 150, 151])
    np.testing.assert_array_equal(found.damping, [2, 2, 4, 4])
    np.testing.assert_array_equal(found.origin, [-0.1, -0.2, 0.3, 0.4])
    assert (found.period, found.gait_period) == (0.02, 0.8)
    assert [(t.kind, t.lags, t.clip) for t in found.terms] == [
        ("base_ang_vel", (1, 0), (-np.inf, np.inf)),
        ("joint_pos", (1, 0), (-3.0, 3.0)),
        ("gait_phase", (1, 0), (-np.inf, np.inf)),
    ]
    assert [name for name, *_ in found.places] == (
        ["base_ang_vel"] * 6 + ["joint_pos"] * 8 + ["gait_phase"] * 4
    )
    by_time = DEPLOY.replace("observations:", "observations:\n  use_gym_history: true")
    places = contract(written(tmp_path, by_time)).places
    assert [lag for _, lag, _ in places] == [1] * 9 + [0] * 9


def test_a_config_yaml_of_rl_sar_with_its_base(tmp_path):
    """Joint i of the policy is the robot's joint_mapping[i]; their names are in base.yaml."""
    names = "[right_hip, right_knee, left_hip, left_knee]"
    base = f"biped: {{dt: 0.005, decimation: 4, default_dof_pos: [], joint_names: {names}}}"
    found = contract(written(tmp_path, RL_SAR, base))
    assert found.joints == JOINTS
    np.testing.assert_array_equal(found.stiffness, [20, 21, 22, 23])
    np.testing.assert_array_equal(found.action_clip, [[-9] * 4, [8] * 4])
    assert (found.period, tuple(found.observation_clip)) == (0.02, (-100.0, 100.0))
    scales = np.concatenate([term.scale for term in found.terms])
    np.testing.assert_array_equal(scales, [0.25] * 3 + [2.0, 2.0, 0.25] + [0.05] * 4 + [1.0] * 4)
    assert [lag for _, lag, _ in found.places] == [2] * 14 + [1] * 14 + [0] * 14


def test_what_playgrounds_go1_reads_and_metadata_in_yaml(tmp_path):
    found = contract(GO1_OF_PLAYGROUND)
    assert len(found.places) == 9 + 3 * 4 + 3
    np.testing.assert_array_equal(found.origin, [0.1, 0.2, 0.3, 0.4])
    text = "joint_names: [a, b]\nobservation_names: [joint_vel, last_action]\naction_scale: 0.5\n"
    again = contract(written(tmp_path, text + "observation_terms_scale: [[1, 2], 3]\n"))
    assert again.joints == ("a", "b")
    np.testing.assert_array_equal(again.terms[0].scale, [1.0, 2.0])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (DEPLOY.replace("joint_pos_rel", "joint_pos_rl"), "Did you mean 'joint_pos_rel'"),
        (DEPLOY.replace("joint_pos_rel", "joint_pos"), "The term 'joint_pos' is none of"),
        (DEPLOY.replace("[0, 2, 1, 3]", "[0, 2, 1]"), "4 values, but 'joint_names' has 3 joints"),
        (DEPLOY.replace("[0, 2, 1, 3]", "[0, 2, 1, 4]"), "it has 4: left_hip"),
        (DEPLOY.replace("[0, 2, 1, 3]", "[0, 2, 2, 3]"), "it has 4: left_hip"),
        (DEPLOY.replace("offset: [-0.1", "offset: [0.1"), "must be its default_joint_pos"),
        (DEPLOY.replace("JointPosition", "JointVelocity"), "'JointVelocityAction'"),
        (DEPLOY.replace("step_dt: 0.02", ""), "lacks 'step_dt'"),
        (RL_SAR.replace('"actions"', '"action"'), "Did you mean 'actions'"),
        (RL_SAR.replace("rl_kp:", "wheel_indices: [3]\n  rl_kp:"), "Wheels"),
        ("a: 1\nb: 2", "is neither a deploy.yaml of Unitree"),
        ("- 1", "must hold keys with values"),
        ("a: [", "is no YAML"),
    ],
)
def test_what_no_contract_can_say_is_refused(text, sentence, tmp_path):
    with pytest.raises(InvalidInputError, match=sentence):
        contract(written(tmp_path, text))
