# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Files that other projects write beside their policies become one kind of contract."""

from collections import deque

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.contract import Contract
from vgps_ros.policies.foreign import read_contract

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
    return Contract(read_contract(*arguments, JOINTS), "The file")


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


PUBLISHED = """
  model_name: policy.pt
  num_observations: 14
  num_of_dofs: 4
  torque_limits: [20.0, 20.0, 20.0, 20.0]
  joint_controller_names: [a, b, c, d]
  waist_joint_indices: []
"""


def test_a_yaml_file_of_metadata_takes_lists_and_the_texts_that_an_onnx_file_has(tmp_path):
    listed = "observation_names: [joint_pos, phase_cos]\nphase_frequency: [1.25, 1.75, 1.5]\n"
    as_text = "observation_names: joint_pos,phase_cos\nphase_frequency: 1.25,1.75,1.5\n"
    found = [read_contract(written(tmp_path, text), JOINTS) for text in (listed, as_text)]
    assert (
        found[0]
        == found[1]
        == {"observation_names": "joint_pos,phase_cos", "phase_frequency": "1.25,1.75,1.5"}
    )


def test_a_published_config_yaml_has_keys_beside_those_that_count(tmp_path):
    """As all that rl_sar publishes; base.yaml may be a folder further up."""
    text, base = RL_SAR.rstrip() + PUBLISHED, "biped: {dt: 0.005, decimation: 4}"
    folder = tmp_path / "robomimic" / "walk"
    folder.mkdir(parents=True)
    (tmp_path / "base.yaml").write_text(base)
    (folder / "config.yaml").write_text(text)
    found = read_contract(folder / "config.yaml", JOINTS)
    assert found["control_period"] == "0.02"
    assert found == read_contract(written(tmp_path, RL_SAR), JOINTS)
    with pytest.raises(InvalidInputError, match=r"'num_obervations'.*Did you mean 'num_observ"):
        contract(written(tmp_path, text.replace("num_observations", "num_obervations")))


def test_a_refusal_is_one_sentence(tmp_path):
    wheels = written(tmp_path, RL_SAR.replace("rl_kp:", "wheel_indices: [3]\n  rl_kp:"))
    with pytest.raises(InvalidInputError) as caught:
        contract(wheels)
    assert str(caught.value) == ("Wheels of rl_sar's config.yaml cannot be driven; use legs alone.")


def test_metadata_in_yaml(tmp_path):
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
        (DEPLOY.replace("history_length", "history_lenght"), "Did you mean 'history_length'"),
        (DEPLOY.replace("stiffness:", "stifness:"), "Did you mean 'stiffness'"),
        (DEPLOY.replace("    scale:", "    scales:"), "Did you mean 'scale'"),
        (DEPLOY.replace("actions:", "actions: {}\nother:"), "must be one term"),
        (DEPLOY.replace("actions:", "actions: 3\nother:"), "lacks .*, or has it in another form"),
        (
            DEPLOY.replace("_rel: {params: {}", "_rel: {params: {asset_cfg: {joint_ids: [0]}}"),
            "joint_pos_rel of deploy.yaml must be of all joints",
        ),
        (RL_SAR.replace("observations_history", "observation_history"), "'observations_history'"),
        (RL_SAR.replace("commands_scale", "comands_scale"), "Did you mean 'commands_scale'"),
        (RL_SAR.replace("  rl_kd: [0.5, 0.5, 0.5, 0.5]\n", ""), "lacks 'rl_kd'"),
        ("joint_names: [a]\nobservation_names: [joint_vel]\naction_scal: 2", "'action_scale'"),
        ("a: 1\nb: 2", "is neither a deploy.yaml of Unitree"),
        ("- 1", "must hold keys with values"),
        ("a: [", "is no YAML"),
    ],
)
def test_what_no_contract_can_say_is_refused(text, sentence, tmp_path):
    with pytest.raises(InvalidInputError, match=sentence):
        contract(written(tmp_path, text))


TERMS = ("base_ang_vel", "projected_gravity", "velocity_commands", "joint_pos_rel", "joint_vel_rel",
         "last_action", "gait_phase")  # fmt: skip
NUMBERS = {"base_ang_vel": 3, "projected_gravity": 3, "velocity_commands": 3, "gait_phase": 2}


def measured(found, rng):
    """Draws what is observed, and what the terms of Unitree are of it."""
    inputs = rng.standard_normal((1, len(found.observed)))
    value = dict(zip(found.observed, inputs[0], strict=True))

    def of(pattern, names):
        return np.array([value.get(pattern.format(name), 0.0) for name in names])

    rotation = of("the free base/q{}", "xyzw")
    turn = Rotation.from_quat(rotation if rotation.any() else [0.0, 0.0, 0.0, 1.0])
    return inputs, {
        "base_ang_vel": of("the free base/w{}", "xyz"),
        "projected_gravity": turn.inv().apply([0.0, 0.0, -1.0]),
        "velocity_commands": of("cmd_vel/{}", ("linear/x", "linear/y", "angular/z")),
        "joint_pos_rel": of("{}/position", found.joints) - found.origin,
        "joint_vel_rel": of("{}/velocity", found.joints),
        "gait_phase": of("clock/{}", ("sin", "cos")),
    }


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("by_time", [False, True])
def test_a_deploy_yaml_of_any_order_is_read_as_unitrees_controller_reads_it(
    seed, by_time, tmp_path
):
    """Terms in any order, each with a history, a scale of each number and a clip of its own."""
    rng = np.random.default_rng(seed)
    names = [str(name) for name in rng.permutation(TERMS)[: 4 + seed]]
    lengths = [2] * len(names) if by_time else rng.integers(1, 4, len(names)).tolist()
    terms = {
        name: {
            "params": {"period": 0.8} if name == "gait_phase" else {},
            "clip": [-0.5, 0.9] if rng.random() < 0.5 else None,
            "scale": rng.uniform(0.1, 2.0, NUMBERS.get(name, 4)).tolist(),
            "history_length": length,
        }
        for name, length in zip(names, lengths, strict=True)
    }
    text = DEPLOY[: DEPLOY.index("observations:")].replace("clip: null", "clip: [[-1, 0.5]] ")
    content = {"observations": {**({"use_gym_history": True} if by_time else {}), **terms}}
    found = contract(written(tmp_path, text.replace("[[-1, 0.5]]", str([[-1, 0.5]] * 4))
                             + yaml.safe_dump(content, sort_keys=False)))  # fmt: skip
    np.testing.assert_array_equal(found.target_clip, [[-1.0] * 4, [0.5] * 4])
    memory, action, history = None, np.zeros(4), {}
    for _ in range(5):
        inputs, values = measured(found, rng)
        values["last_action"] = action
        for name, term in terms.items():
            value = np.clip(values[name], *(term["clip"] or (-np.inf, np.inf))) * term["scale"]
            length = term["history_length"]
            history.setdefault(name, deque([value] * length, length)).append(value)
        expected = (
            [history[name][step] for step in range(2) for name in names]
            if by_time
            else [value for name in names for value in history[name]]
        )
        memory = found.remembered(inputs, memory)
        np.testing.assert_allclose(found.read(memory)[0], np.concatenate(expected), atol=1e-12)
        action = rng.standard_normal(4)
        memory = memory._replace(action=action[None])


@pytest.mark.parametrize("priority", ["time", "term"])
def test_a_config_yaml_is_read_as_rl_sar_reads_it(priority, tmp_path, rng):
    """Scaled, then clipped to clip_obs; its history lists how many steps ago, in their order."""
    text = RL_SAR.replace("[2, 1, 0]", "[0, 2, 1]").replace("clip_obs: 100.0", "clip_obs: 0.4")
    text = text.replace('"commands", ', '"g1_phase", "commands", ')
    found = contract(written(tmp_path, text + f"  observations_history_priority: {priority}\n"))
    assert found.gait_period == 0.8
    memory, action, frames = None, np.zeros(4), []
    for _ in range(5):
        inputs, values = measured(found, rng)
        terms = [
            0.25 * values["base_ang_vel"],
            values["gait_phase"],
            [2.0, 2.0, 0.25] * values["velocity_commands"],
            0.05 * values["joint_vel_rel"],
            action,
        ]
        terms = [np.clip(term, -0.4, 0.4) for term in terms]
        frames = [terms, *(frames or [terms] * 2)]
        expected = (
            [term for lag in (0, 2, 1) for term in frames[lag]]
            if priority == "time"
            else [frames[lag][i] for i in range(5) for lag in (0, 2, 1)]
        )
        memory = found.remembered(inputs, memory)
        np.testing.assert_allclose(found.read(memory)[0], np.concatenate(expected), atol=1e-12)
        action = rng.standard_normal(4)
        memory = memory._replace(action=action[None])
