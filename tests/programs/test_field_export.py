# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What others do with an exported policy: by onnxruntime alone, as Unitree does, and by LEAPP."""

import shutil
import subprocess
import sys
from collections import deque

import numpy as np
import onnxruntime
import pytest
import torch
import yaml
from scipy.spatial.transform import Rotation

from tests.onnx_models import drawn_policy, exported
from tests.programs.test_import import ROBOT, TASK
from tests.servo_arm import REMEMBERING, write_arm
from vgps_ros.policies.driver import driver_of, for_policy
from vgps_ros.policies.foreign import read_contract, read_leapp
from vgps_ros.policies.onnx_file import with_metadata
from vgps_ros.policies.policy_file import policy_of
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.robot.executed_control import Driver
from vgps_ros.simulation.model import state_names
from vgps_ros.tasks import make_task

STEPS = 40
COMMANDS = np.array([0.4, -0.2, 0.6])
# No vgps_ros: what a metadata's names mean is what docs/how_to/export.md says.
ALONE = """
import sys

sys.modules["vgps_ros"] = None
import mujoco, numpy as np, onnxruntime

policy = onnxruntime.InferenceSession("policy.onnx")
says = policy.get_modelmeta().custom_metadata_map
model = mujoco.MjModel.from_xml_path("robot.xml")
data, period = mujoco.MjData(model), float(says["control_period"])
mujoco.mj_resetDataKeyframe(model, data, 0)
data.qvel[:6] = 0.3  # it stands no longer still
told, turn = dict(forward=0.4, sideways=-0.2, turn=0.6), 2 * np.pi / float(says["gait_period"])
listed = {key: says[key].split(",") for key in says}
scale, origin = (np.array(listed[key], float) for key in ("action_scale", "default_joint_pos"))


def read(name):
    owner, _, part = name.rpartition("/")
    if owner == "command":
        return told[part]
    if owner == "clock":
        return {"sin": np.sin, "cos": np.cos}[part](turn * data.time)
    if part in ("position", "velocity"):
        return (data.joint(owner).qpos if part == "position" else data.joint(owner).qvel)[0]
    return data.sensor(owner).data["xyz".index(part)]


states, targets = [], []
for _ in range(40):
    mujoco.mj_forward(model, data)
    states.append(np.append(data.qpos, data.qvel))
    obs = np.array([[read(name) for name in listed["observation_names"]]], np.float32)
    targets.append(origin + scale * policy.run(["actions"], {"obs": obs})[0][0])
    for joint, target in zip(listed["joint_names"], targets[-1]):
        (own,) = [i for i in range(model.nu) if model.actuator_trnid[i, 0] == model.joint(joint).id]
        data.ctrl[own] = target
    mujoco.mj_step(model, data, nstep=round(period / model.opt.timestep))
np.savez("driven.npz", states=states, targets=targets)
"""


def leapp():
    """The package, which requirements/robots.txt pins."""
    return pytest.importorskip("leapp")


def small_export(folder, task, *words):
    """Exports a policy of small weights; returns it."""
    policy = drawn_policy(task, (16, 8), 0.2)
    exported(policy, task, folder, *(w if w[0] == "-" else folder / w for w in words))
    return policy


def driven(task, driver, phase=0.0, states=None):
    """States of a run, and the joints' targets or torques in them, with the clock at a phase."""
    context = task.signals.context(
        np.tile(COMMANDS[: len(task.signals.commands)], (STEPS, 1)),
        task.signals.phases(STEPS, phase),
    )
    law, observed = driver.new_law(), driver.observation.within
    if states is None:
        first = task.initial_state + 0.0
        first[-6:] += 0.3
        found = task.dynamics.rollout(first, lambda t, x: law(observed(context[t])(x)), STEPS)
        return found.states[:-1], as_sent(task, found.controls)
    controls = [law(observed(context[t])(x[None]))[0] for t, x in enumerate(states)]
    return states, as_sent(task, np.array(controls))


def as_sent(task, controls):
    return task.controls.at_joints(np.clip(controls, *task.controls.limits))


def arm(folder, task=REMEMBERING):
    return make_task(write_arm(folder, task=task))


def coordinates(task, states):
    """Positions and velocities of the joints, and the base's angular velocity and (x, y, z, w)."""
    names = state_names(task.dynamics.model)

    def of(*wanted):
        return states[:, [names.index(each) for each in wanted]]

    joints = task.controls.names
    base = next((name.removesuffix("/qw") for name in names if name.endswith("/qw")), None)
    return (
        of(*(f"{joint}/position" for joint in joints)),
        of(*(f"{joint}/velocity" for joint in joints)),
        of(*(f"{base}/w{i}" for i in "xyz")) if base else None,
        of(*(f"{base}/q{i}" for i in "xyzw")) if base else None,
    )


def test_onnxruntime_metadata_and_mujoco_alone_do_the_same(tmp_path):
    task = make_task("quadruped")
    policy = small_export(tmp_path, task, "--mjcf", "robot.xml")
    says = onnxruntime.InferenceSession(tmp_path / "policy.onnx").get_modelmeta()
    assert says.custom_metadata_map["gait_stops"] == "0.07,0.7,1.5"
    subprocess.run([sys.executable, "-c", ALONE], cwd=tmp_path, check=True)
    found = np.load(tmp_path / "driven.npz")
    _, expected = driven(task, Driver.of(task.observation, policy), states=found["states"])
    assert np.abs(found["states"][-1] - found["states"][0]).max() > 0.1  # it moved
    np.testing.assert_allclose(found["targets"], expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("robot", ["quadruped", "arm"])
def test_unitrees_controller_does_the_same(robot, tmp_path):
    """Computed as deploy/include/isaaclab of unitree_rl_lab does; its clock is a step ahead."""
    task = make_task(robot) if robot == "quadruped" else arm(tmp_path)
    policy = small_export(tmp_path, task, "--unitree", "its")
    says = yaml.safe_load((tmp_path / "its" / "params" / "deploy.yaml").read_text())
    session = onnxruntime.InferenceSession(tmp_path / "its" / "exported" / "policy.onnx")
    ahead = says["step_dt"] * task.signals.frequency
    states, expected = driven(task, Driver.of(task.observation, policy), ahead)
    positions, velocities, turning, rotations = coordinates(task, states)
    (action,) = says["actions"].values()
    raw, phase, history, period = np.zeros(len(positions[0])), 0.0, {}, 1.0 / task.signals.frequency
    for t in range(STEPS):
        phase = (phase + says["step_dt"] / period) % 1.0
        values = {
            "velocity_commands": COMMANDS,
            "joint_pos_rel": positions[t] - says["default_joint_pos"],
            "joint_vel_rel": velocities[t],
            "last_action": raw,
            "gait_phase": np.array([np.sin(2 * np.pi * phase), np.cos(2 * np.pi * phase)]),
        }
        if robot == "quadruped":
            values["base_ang_vel"] = turning[t]
            values["projected_gravity"] = Rotation(rotations[t]).inv().apply([0, 0, -1])
        for name, term in says["observations"].items():
            value, length = values[name] * term["scale"], term["history_length"]
            history.setdefault(name, deque([value] * length, length)).append(value)
        obs = np.concatenate([value for kept in history.values() for value in kept])
        (raw,) = session.run(["actions"], {"obs": obs[None].astype(np.float32)})[0]
        target = raw * action["scale"] + action["offset"]
        np.testing.assert_allclose(target, expected[t], rtol=1e-6, atol=1e-6)
    # Read back by our own reader.
    said = read_contract(tmp_path / "its" / "params" / "deploy.yaml", task.controls.names)
    content = (tmp_path / "its" / "exported" / "policy.onnx").read_bytes()
    file = policy_of(with_metadata(content, said, "it"), "it")
    _, again = driven(task, driver_of(task.deployment, file), ahead, states)
    np.testing.assert_allclose(again, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "robot", [pytest.param("quadruped", marks=pytest.mark.slow), "arm", "swimmer"]
)
def test_leapps_loader_does_the_same(robot, tmp_path):
    text = REMEMBERING.replace("history: 2", "")
    task = arm(tmp_path, text) if robot == "arm" else make_task(robot)
    policy = small_export(tmp_path, task, "--leapp", "bundle")
    manager = leapp().InferenceManager(str(tmp_path / "bundle" / "policy.yaml"))
    states, expected = driven(task, Driver.of(task.observation, policy))
    positions, velocities, turning, rotations = coordinates(task, states)
    told = np.tile(COMMANDS, (STEPS, 1))
    given = {"joint_pos": positions, "joint_vel": velocities, "velocity_commands": told}
    given |= {"base_ang_vel": turning, "base_rotation": rotations}
    described = {i["name"]: i["element_names"] for i in manager.nodes["policy"].input_descriptions}
    (loose,) = described.get("readings", [()])
    observed = Driver.of(task.observation, policy).observation
    columns = [observed.names.index(name) for name in loose]
    given["readings"] = observed.readings(states)[:, columns] if columns else None
    (target,) = [key for key in manager.outputs if key.endswith("_target")]
    for t in range(STEPS):
        inputs = {key: given[key.removeprefix("policy/")][t : t + 1] for key in manager.inputs}
        found = manager({key: torch.tensor(v.astype(np.float32)) for key, v in inputs.items()})
        np.testing.assert_allclose(found[target][0], expected[t], rtol=1e-6, atol=1e-6)
    home = np.linspace(-0.5, 0.5, len(positions[0]))
    content = read_leapp(tmp_path / "bundle" / "policy.yaml", task.controls.names, home)
    file = policy_of(content, "it")
    _, again = driven(task, driver_of(task.deployment, file), states=states)
    np.testing.assert_allclose(again, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_leapps_loader_stops_the_clock_as_we_do(tmp_path):
    """At rest, tilted once, at rest until the clock stands again, and then told to walk."""
    task = make_task("quadruped")
    policy = small_export(tmp_path, task, "--leapp", "bundle")
    tilt = Rotation.from_euler("X", 0.1) * Rotation.from_quat(task.initial_state[[4, 5, 6, 3]])
    states = np.tile(task.initial_state, (90, 1))
    states[3, 3:7] = tilt.as_quat()[[3, 0, 1, 2]]
    told = np.zeros((90, 3))
    told[85:] = COMMANDS
    phases = task.signals.phases(90, 0.0)
    calm, turning = (s.context(told, phases) for s in (task.signals, task.signals.turning))
    awake = task.unrest.awake(states)
    assert awake.sum() == 75
    context = np.where(awake[:, None], turning, calm)
    expected = as_sent(task, policy.mean(task.observation.within(context)(states)))
    positions, velocities, rates, rotations = coordinates(task, states)
    given = {"joint_pos": positions, "joint_vel": velocities, "velocity_commands": told}
    given |= {"base_ang_vel": rates, "base_rotation": rotations}
    manager = leapp().InferenceManager(str(tmp_path / "bundle" / "policy.yaml"))
    (target,) = [key for key in manager.outputs if key.endswith("_target")]
    for t in range(90):
        inputs = {key: given[key.removeprefix("policy/")][t : t + 1] for key in manager.inputs}
        found = manager({key: torch.tensor(v.astype(np.float32)) for key, v in inputs.items()})
        np.testing.assert_allclose(found[target][0], expected[t], rtol=1e-6, atol=1e-6)
    home = task.initial_state[7:19]
    file = policy_of(read_leapp(tmp_path / "bundle" / "policy.yaml", task.controls.names, home), "")
    law, observation = (
        driver_of(task.deployment, file).new_law(),
        driver_of(task.deployment, file).observation,
    )
    for t, state in enumerate(states):
        own = observation.within(calm[t])(state[None])
        np.testing.assert_allclose(as_sent(task, law(own)[0]), expected[t], rtol=1e-6, atol=1e-6)


def test_what_a_format_cannot_say_is_refused_by_name(tmp_path):
    swimmer = make_task("swimmer")
    with pytest.raises(SystemExit, match="control of front_joint is a torque"):
        small_export(tmp_path, swimmer, "--unitree", "its")
    task = arm(
        tmp_path,
        REMEMBERING.replace("joint_velocities]", "JOINT/sin]".replace("JOINT", "shoulder")),
    )
    with pytest.raises(SystemExit, match="reads 'shoulder/sin', which is none of a"):
        small_export(tmp_path, task, "--unitree", "its", "--overwrite")
    with pytest.raises(SystemExit, match="of former steps"):
        small_export(tmp_path, arm(tmp_path), "--leapp", "bundle", "--overwrite")


@pytest.fixture(scope="module")
def bundles(tmp_path_factory):
    """Writes bundles, each of them once, and copies of them."""
    made = {}

    def copied(folder, **changes):
        key = str(changes)
        if key not in made:
            made[key] = bundle(tmp_path_factory.mktemp("made"), **changes).parent
        shutil.copytree(made[key], folder / "bundle")
        return folder / "bundle" / "bundle.yaml"

    return copied


def bundle(folder, **changes):
    """A recurrent network with an own state and the last action, which LEAPP itself exports."""
    made = leapp()
    annotate, semantics = made.annotate, made.TensorSemantics
    torch.manual_seed(0)
    wide, back, out = torch.randn(14, 6), torch.randn(6, 6), torch.randn(6, 2)

    def tensor(name, values, kind, elements, **extra):
        ref = torch.as_tensor(values, dtype=torch.float32)[None]
        return semantics(name=name, ref=ref, kind=kind, element_names=elements, **extra)

    made.start(name="bundle", save_path=str(folder))
    places, rates, turning, rotation, told = annotate.input_tensors(
        "policy",
        [
            tensor("places", [0.0] * 2, "state/joint/position", ["tail", "hip"]),
            tensor("rates", [0.0] * 2, "state/joint/velocity", ["hip", "tail"]),
            tensor("turning", [0.0] * 3, "state/body/angular_velocity", list("xyz")),
            tensor("rotation", [0.0] * 4, "state/body/rotation", ["qx", "qy", "qz", "qw"]),
            tensor("told", [0.0] * 3, "command/body/velocity", ["x", "y", "yaw"]),
        ],
    )
    # Each state by itself, since LEAPP keeps the order in which they are named.
    hidden = annotate.state_tensors("policy", {"hidden": torch.full((1, 6), 0.5)})
    read = torch.cat([places, rates, 0.2 * turning, rotation, told], 1)
    hidden = torch.tanh(read @ wide + hidden @ back)
    annotate.update_state("policy", {"hidden": hidden})
    target = semantics(
        name="target",
        ref=0.3 * hidden @ out + 0.1,
        kind=changes.get("drives", "target/joint/position"),
        element_names=["hip", "tail"],
    )
    fixed = [
        tensor(f"{kind}s", gains, kind, ["tail", "hip"])
        for kind, gains in (("kp", [30.0, 20.0]), ("kd", [2.0, 1.0]))
    ]
    annotate.output_tensors("policy", target, static_outputs=fixed, export_with="onnx")
    made.stop()
    configs = made.utils.tensor_description.GraphConfigs(frequency=changes.get("frequency", 50.0))
    made.compile_graph(graph_configs=configs, visualize=False)
    return folder / "bundle" / "bundle.yaml"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of the task of `vgps import`'s tests."""
    (tmp_path / "task.yaml").write_text(TASK)
    (tmp_path / "robot.xml").write_text(ROBOT)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def imported(path, *words):
    vgps(["import", str(path), "--task", "task.yaml", "--output", "whole.onnx", *words])


def test_a_bundle_of_leapp_drives_as_its_own_loader_has_it(folder, bundles, capsys):
    path = bundles(folder)
    imported(path)
    shown = capsys.readouterr().out
    for joint, gains in (("hip", ("20", "1")), ("tail", ("30", "2"))):
        line = next(line for line in shown.splitlines() if joint in line)
        assert tuple(cell.strip() for cell in line.split("│")[5:7]) == gains
    file, task = policy_of((folder / "whole.onnx").read_bytes(), "it"), make_task("task.yaml")
    task = for_policy(task, file)
    driver = driver_of(task.deployment, file)
    assert list(task.controls.stiffness) == [20.0, 30.0]
    states, found = driven(task, driver)
    positions, velocities, turning, rotations = coordinates(task, states)
    manager = leapp().InferenceManager(str(path))
    for t in range(STEPS):
        given = {"places": positions[t, ::-1], "rates": velocities[t], "turning": turning[t]}
        given |= {"rotation": rotations[t], "told": COMMANDS}
        tensors = {
            f"policy/{k}": torch.tensor(v[None].astype(np.float32)) for k, v in given.items()
        }
        expected = manager(tensors)["policy/target"][0]
        np.testing.assert_allclose(found[t], expected, rtol=1e-6, atol=1e-6)
    assert driver.policy.steps > STEPS  # a bag tells its state from its beginning alone


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"frequency": 100.0}, ""),  # a task with its period is written beside it
        ({"drives": "target/joint/effort"}, "gives a torque of hip, but the robot takes a pos"),
        ({"drives": "target/body/position"}, "'target/body/position', which drives nothing"),
        (
            ("kind: state/joint/velocity", "kind: state/joint/velocty"),
            "Did you mean 'state/joint/velocity'",
        ),
        (("element_names: [[tail, hip]]", "element_names: [[tail, hop]]"), "'hop/position'"),
        (("element_names: [[tail, hip]]", "element_names: [[tail]]"), "has 2 elements, but"),
        (("element_names: [[qx, qy, qz, qw]]", "unknown: 1"), ""),
        (("backend: onnx", "backend: jit"), "the backend"),
        (("model_path: policy", "model_path: ../policy"), "not in its folder"),
        (("sha256sum: ", "sha256sum: 0"), "is not the file that .* describes"),
        (("pipeline:", "pipelin:"), "lacks 'pipeline'"),
        (("- name: rates", "- name: speeds"), "are described; export it anew"),
    ],
)
def test_a_bundle_that_does_not_fit_is_refused(change, sentence, folder, bundles):
    path = bundles(folder, **change if isinstance(change, dict) else {})
    if isinstance(change, tuple):
        path.write_text(path.read_text().replace(*change, 1))
    if not sentence:  # a rotation's elements have an order of their own
        imported(path)
        return
    with pytest.raises(SystemExit, match=sentence) as stopped:
        imported(path)
    assert "\n" not in str(stopped.value.code)
    assert not (folder / "whole.onnx").exists()
