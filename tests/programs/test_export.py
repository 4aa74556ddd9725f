# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `export`, and the programs that read what it writes and the networks of others."""

import hashlib
import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import onnx
import onnxruntime
import pytest

from tests.onnx_models import drawn_policy, elu_layers, elu_mean, elu_model, exported
from tests.servo_arm import GEARED, SERVOS, write_arm
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.onnx_file import metadata_of, parse_model
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.storage.run_folder import load_policy, save_policy
from vgps_ros.tasks import make_task

MJLABS = {"run_path", "joint_names", "joint_stiffness", "joint_damping", "default_joint_pos"}
MJLABS |= {"command_names", "observation_names", "action_scale"}
MJLABS |= {
    f"observation_terms_{key}" for key in ("scale", "clip", "history_length", "flatten_history_dim")
}
ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "08_onnx_controller.py"
ROLLOUTS = ["--seconds", "1", "--rollouts", "3", "--json", "-"]
QUICK = ["--iterations", "2", "--initial-ddp-iterations", "3", "--evaluation-rollouts", "2"]


@pytest.fixture
def run(tmp_path, swimmer):
    """A folder with a swimmer's policy of five units, whose torques are a few N·m."""
    rng, names = np.random.default_rng(3), swimmer.observation.names
    shape = Architecture(names, (5,), 2)
    parameters = 3 * rng.standard_normal(shape.num_parameters)
    save_policy(GaussianPolicy(shape, parameters, np.array([0.5, 2.0])), "swimmer",
                tmp_path / "policy.json")  # fmt: skip
    return tmp_path


@pytest.fixture
def foreign(tmp_path, swimmer):
    """A network of others that drives the swimmer, and its weights."""
    layers = elu_layers(len(swimmer.observation.names), 2)
    metadata = {
        "joint_names": "back_joint,front_joint",  # in another order than the swimmer's controls
        "observation_names": ",".join(swimmer.observation.names),
        "action_scale": "20.0",
    }
    path = tmp_path / "foreign.onnx"
    onnx.save(elu_model(layers, metadata, rows="batch"), path)
    return path, layers


def output_of(capsys, *words):
    vgps([*map(str, words)])
    return capsys.readouterr().out


def test_what_it_writes_is_read_back_and_says_what_it_is(run, swimmer, capsys):
    path = run / "policy.onnx"
    text = output_of(capsys, "export", run, "--output", path, "--precision", "float64")
    assert text == f"Wrote {path}: 9 readings to 2 controls, in float64.\n"
    kept, (policy, _) = open_policy(path), load_policy(run / "policy.json")
    assert kept.task == "swimmer"
    assert kept.gaussian.architecture == policy.architecture
    np.testing.assert_array_equal(kept.gaussian.parameters, policy.parameters)
    says = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    assert says["joint_names"] == "front_joint,back_joint"
    assert says["observation_names"].split(",") == list(swimmer.observation.names)
    assert (says["action_scale"], says["joint_stiffness"]) == ("1.0,1.0", "0.0,0.0")
    assert (says["default_joint_pos"], says["noise_std"]) == ("0.0,0.0", "0.5,2.0")
    assert (says["task"], says["control_period"]) == ("swimmer", "0.02")
    assert says["mjcf_sha256"] == hashlib.sha256(swimmer.mjcf.encode()).hexdigest()
    assert len(says["vgps_ros_commit"].split("-")[0]) == 40


def test_a_contract_of_an_export_computes_the_same_as_its_policy(run, swimmer, rng, capsys):
    """By mjlab's twelve keys, as a third-party reader takes them."""
    output_of(capsys, "export", run, "--output", run / "policy.onnx")
    content = (run / "policy.onnx").read_bytes()
    found = OnnxPolicy(content, "The file", swimmer.controls)
    policy, _ = load_policy(run / "policy.json")
    inputs = rng.standard_normal((20, len(policy.observed)))
    assert found.observed == policy.observed
    expected = np.clip(policy.mean(inputs), *swimmer.controls.limits)
    np.testing.assert_allclose(found.mean(inputs), expected, rtol=1e-5, atol=1e-5)
    assert set(metadata_of(parse_model(content, "The file"))) >= MJLABS


def test_evaluate_takes_the_exported_policy_as_it_takes_the_run(run, capsys):
    path = run / "policy.onnx"
    output_of(capsys, "export", run, "--output", path, "--precision", "float64")
    expected = output_of(capsys, "evaluate", run, *ROLLOUTS)
    assert output_of(capsys, "evaluate", path, *ROLLOUTS) == expected


def test_the_example_without_this_package_drives_the_robot_the_same_way(run, swimmer, capsys):
    path = run / "policy.onnx"
    output_of(capsys, "export", run, "--output", path, "--precision", "float64")
    robot = ROOT / "vgps_ros" / "tasks" / "swimmer" / "swimmer.xml"
    printed = subprocess.run(
        [sys.executable, EXAMPLE, path, robot], capture_output=True, text=True, check=True
    ).stdout
    policy, _ = load_policy(run / "policy.json")
    (states,), _ = swimmer.dynamics.execute(
        policy, swimmer.observation, np.zeros((1, 10)), np.zeros((1, 500, 2))
    )
    assert printed == f"After 10.0 s the robot is at x = {states[-1, 0]:.3f} m.\n"
    spec = importlib.util.spec_from_file_location("example", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    data = example.drive(str(path), str(robot))
    np.testing.assert_allclose([*data.qpos, *data.qvel], states[-1], atol=1e-12)
    assert "vgps_ros" not in EXAMPLE.read_text().split('"""')[2]


def test_a_network_of_others_drives_the_robot_and_is_evaluated(foreign, swimmer, rng, capsys):
    path, layers = foreign
    states = swimmer.initial_state + 0.3 * rng.standard_normal((50, 10))
    expected = 20.0 * elu_mean(layers, swimmer.observation(states))[:, ::-1]
    driver = driver_of(swimmer.deployment, open_policy(path))
    found = driver.policy.mean(driver.observation(states))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
    result = json.loads(output_of(capsys, "evaluate", path, "--task", "swimmer", *ROLLOUTS))
    assert 0 < result["cost_per_step"]["mean"] < 10  # standing still costs 1


def test_a_training_starts_from_the_motion_of_a_policy(foreign, tmp_path, capsys):
    path, _ = foreign
    flags = ["--task", "swimmer", "--demonstration", path]
    task = make_task("swimmer", str(path))
    driver = driver_of(make_task("swimmer").deployment, open_policy(path))

    def law(t, x):
        return driver.policy.mean(driver.observation(x))

    shown = task.dynamics.rollout(task.initial_state, law, task.planned_horizon)
    begun = task.begin(task, task.initial_state, task.planned_horizon, None)
    np.testing.assert_array_equal(begun.trajectory.states, shown.states)
    assert np.abs(shown.controls).max() > 1.0
    output_of(capsys, "train", *flags, *QUICK, "--output", tmp_path / "run")
    assert (tmp_path / "run" / "policy.json").is_file()


def fails(sentence, *words):
    with pytest.raises(SystemExit, match=sentence) as stop:
        vgps([*map(str, words)])
    assert "\n" not in str(stop.value.code)


def test_the_robots_mjcf_has_the_tasks_changes_and_names(run, swimmer, capsys):
    output_of(capsys, "export", run, "--output", run / "a.onnx", "--mjcf", run / "robot.xml")
    written = (run / "robot.xml").read_bytes()
    assert written.decode() == swimmer.mjcf
    metadata = {p.key: p.value for p in onnx.load(run / "a.onnx").metadata_props}
    assert metadata["mjcf_sha256"] == hashlib.sha256(written).hexdigest()


def test_what_cannot_be_exported_or_executed_is_refused_with_a_sentence(run, foreign, tmp_path):
    path, layers = foreign
    (tmp_path / "empty").mkdir()
    fails(r"policy\.json is not a readable policy", "export", tmp_path / "empty", "--output", "x")
    fails("none is not a readable policy .*No such file", "export", "none", "--output", "x")
    fails("exists already", "export", run, "--output", path)
    fails("'x' is named for two files", "export", run, "--output", "x", "--mjcf", "./x")
    fails("There is no folder 'none'; make it", "export", run, "--output", "none/x.onnx")
    fails("is not a readable policy", "export", path, "--output", "x")
    (tmp_path / "large").mkdir()
    with (tmp_path / "large" / "policy.json").open("wb") as file:
        file.truncate(2 << 30)  # 2 GB, of which the disk holds nothing
    fails("has 2147 MB, and at most 268 MB", "export", tmp_path / "large", "--output", "x")
    fails("has 2 controls, but the task has 6", "export", run, "--output", "x", "--task", "walker")
    fails("names no task; give --task", "evaluate", path)
    fails("has no noise to draw", "evaluate", path, "--task", "swimmer", "--stochastic")
    metadata = {"joint_names": "back_joint,front_joint", "observation_names": ",".join("abcdefghi")}
    onnx.save(elu_model(layers, metadata), tmp_path / "strange.onnx")
    fails("has no reading 'a'", "evaluate", tmp_path / "strange.onnx", "--task", "swimmer")
    fails("robot's controls drive", "evaluate", path, "--task", "walker")
    layers[-1] = (1e6 * layers[-1][0], layers[-1][1])
    names = ",".join(make_task("swimmer").observation.names)
    onnx.save(elu_model(layers, {**metadata, "observation_names": names}), tmp_path / "strong.onnx")
    flags = ["--task", "swimmer", "--demonstration", tmp_path / "strong.onnx"]
    fails("diverges after 0", "train", *flags, *QUICK, "--output", tmp_path / "run")


@pytest.mark.parametrize("mjcf", [SERVOS, GEARED])
def test_an_export_says_what_actions_are_at_the_joints(mjcf, tmp_path, rng):
    """A second computation by the metadata alone gives the torques of the robot's own model."""
    task = make_task(write_arm(tmp_path, mjcf))
    policy = drawn_policy(task, (4,), 0.3)
    path = exported(policy, task, tmp_path, "--precision", "float64")
    says = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    numbers = {
        key: np.array(says[key].split(","), dtype=float)
        for key in ("action_scale", "default_joint_pos", "joint_stiffness", "joint_damping")
    }
    names, session = says["joint_names"].split(","), onnxruntime.InferenceSession(path)
    model = mujoco.MjModel.from_xml_string(task.mjcf)
    data, dofs = mujoco.MjData(model), [model.joint(name).dofadr[0] for name in names]
    for state in task.initial_state + 0.3 * rng.standard_normal((20, len(task.initial_state))):
        obs = task.observation(state)
        (actions,) = session.run(["actions"], {"obs": obs[None]})
        said = numbers["action_scale"] * actions[0]
        data.qpos[:], data.qvel[:] = np.split(state, 2)
        torques = said
        if says["action_kind"].startswith("position"):
            held = numbers["default_joint_pos"] + said - data.qpos[dofs]
            torques = numbers["joint_stiffness"] * held - numbers["joint_damping"] * data.qvel[dofs]
        data.ctrl[:] = np.clip(policy.mean(obs), *task.controls.limits)
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(torques, data.qfrc_actuator[dofs], rtol=1e-9, atol=1e-9)
    assert says["action_unit"].split(",") == [{SERVOS: "rad", GEARED: "N·m"}[mjcf]] * len(names)
    assert open_policy(path).gaussian is not None  # as our own, whatever its actions start from
