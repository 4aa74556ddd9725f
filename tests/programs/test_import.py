# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `import`: what it shows, writes and refuses; what it writes drives."""

import json
from dataclasses import replace

import numpy as np
import onnx
import pytest

from tests.onnx_models import elu_layers, elu_model
from vgps_ros.policies.deployment_file import read_deployment
from vgps_ros.policies.driver import driver_of, for_policy
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.robot.executed_control import ExecutedPolicy
from vgps_ros.tasks import make_task

TASK = """
model: robot.xml
control_period: 0.02
horizon: 0.2
commands:
  forward: {from: cmd_vel/linear/x, range: [-1, 1]}
  sideways: {from: cmd_vel/linear/y, range: [-1, 1]}
  turn: {from: cmd_vel/angular/z, range: [-1, 1]}
cost:
  - {sensor: speed, index: x, target: {command: forward}, weight: 1.0}
  - {sensor: speed, index: y, target: {command: sideways}, weight: 1.0}
  - {sensor: gyro, index: z, target: {command: turn}, weight: 1.0}
observe: [joint_positions]
"""
ROBOT = """
<mujoco><worldbody><geom type="plane" size="5 5 1"/><body pos="0 0 0.3"><freejoint name="floating"/>
  <geom type="box" size=".2 .1 .05" mass="2"/><site name="imu"/>
  <body pos="0 .2 0"><joint name="hip" axis="0 1 0"/><geom size=".03" fromto="0 0 0 .2 0 0"
    type="capsule"/></body>
  <body pos="0 -.2 0"><joint name="tail" axis="0 1 0"/><geom size=".03" fromto="0 0 0 -.2 0 0"
    type="capsule"/></body>
</body></worldbody><actuator><motor joint="hip"/><motor joint="tail"/></actuator>
<sensor><velocimeter name="speed" site="imu"/><gyro name="gyro" site="imu"/></sensor></mujoco>
"""
DEPLOY = """
joint_ids_map: [1, 0]
step_dt: 0.02
stiffness: [20, 30]
damping: [1, 2]
default_joint_pos: [0.1, -0.1]
actions: {JointPositionAction: {clip: null, scale: [0.25, 0.25], offset: [0.1, -0.1]}}
observations:
  base_ang_vel: {params: {}, clip: null, scale: [0.2, 0.2, 0.2], history_length: 2}
  projected_gravity: {params: {}, clip: null, scale: null, history_length: 2}
  velocity_commands: {params: {}, clip: null, scale: null, history_length: 2}
  joint_pos_rel: {params: {}, clip: null, scale: null, history_length: 2}
  last_action: {params: {}, clip: null, scale: null, history_length: 2}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of a task, a network without metadata, and its deploy.yaml."""
    for name, text in (("task.yaml", TASK), ("robot.xml", ROBOT), ("deploy.yaml", DEPLOY)):
        (tmp_path / name).write_text(text)
    onnx.save(elu_model(elu_layers(2 * (3 + 3 + 3 + 2 + 2), 2), {}), tmp_path / "policy.onnx")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def imported(*words):
    flags = ["--task", "task.yaml", "--contract", "deploy.yaml", "--output", "whole.onnx"]
    vgps(["import", "policy.onnx", *flags, "--standing", "0.2", *words])


def test_it_shows_the_contract_and_what_it_writes_drives(folder, capsys):
    imported()
    shown = capsys.readouterr().out
    for row in (("0", "tail", "0.1", "0.25", "30", "2"), ("1", "hip", "-0.1", "0.25", "20", "1")):
        assert any(row == tuple(line.split("│")[i].strip() for i in range(1, 7))
                   for line in shown.splitlines() if line.count("│") > 7)  # fmt: skip
    for place, term in (("0-5", "base_ang_vel"), ("6-11", "projected_gravity"), ("22-25", "last")):
        assert any(place in line and term in line for line in shown.splitlines())
    file, task = open_policy(folder / "whole.onnx"), make_task("task.yaml")
    driver = driver_of((served := for_policy(task, file)).deployment, file)
    assert list(served.controls.stiffness) == [20.0, 30.0]
    rollouts = ["--seconds", "3", "--rollouts", "1", "--pushes", "0", "--json", "-"]
    vgps(["evaluate", "whole.onnx", "--task", "task.yaml", *rollouts])
    assert len(json.loads(capsys.readouterr().out)["commands"]) > 7
    # An executor remembers by the stamps of states: one that comes twice is answered twice.
    inputs = np.random.default_rng(0).standard_normal((4, len(driver.policy.observed)))
    law, executed = driver.new_law(), ExecutedPolicy(driver.policy)
    for i, (row, wanted) in enumerate((row, law(row[None])[0]) for row in inputs):
        for _ in range(2):
            np.testing.assert_array_equal(executed.control(row, 20 * i), wanted)
    first = driver.policy.mean(inputs[0])
    assert np.abs(executed.control(inputs[0], 100) - first).max() > 1e-3
    np.testing.assert_array_equal(executed.control(inputs[0], 40), first)  # time goes back
    executed.control(inputs[1], 60)
    executed.forget()
    np.testing.assert_array_equal(executed.control(inputs[0], 80), first)


METADATA = """
observation_names: [gyro/x, gyro/y, gyro/z, projected_gravity, joint_pos, velocity_commands]
action_scale: 0.5
control_period: 0.02
joint_stiffness: 20
joint_damping: 1
"""


def test_metadata_in_yaml_may_leave_the_joints_to_the_robot(folder):
    onnx.save(elu_model(elu_layers(11, 2), {}), folder / "policy.onnx")
    for name, text in (("own", METADATA), ("named", METADATA + "joint_names: [tail, hip]")):
        (folder / "contract.yaml").write_text(text)
        words = ["--contract", "contract.yaml", "--output", f"{name}.onnx"]
        vgps(["import", "policy.onnx", "--task", "task.yaml", "--standing", "0.2", *words])
    policies = [open_policy(folder / f"{name}.onnx").policy(make_task("task.yaml").controls)
                for name in ("own", "named")]  # fmt: skip
    assert [policy.contract.joints for policy in policies] == [("hip", "tail"), ("tail", "hip")]


@pytest.mark.parametrize(
    ("file", "old", "new", "sentence"),
    [
        ("task.yaml", "from: cmd_vel/linear/y, ", "", "reads 'cmd_vel/linear/y', but the task"),
        ("robot.xml", '<freejoint name="floating"/>', "", "Of 'policy.onnx': .*'the free base/"),
        ("deploy.yaml", "last_action", "last_actio", "Did you mean 'last_action'"),
        ("deploy.yaml", "history_length: 2", "history_length: 3", "26 numbers, but .* names 39"),
        ("deploy.yaml", "step_dt: 0.02", "step_dt: inf", "'control_period' of .* finite"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_robot_is_refused(folder, file, old, new, sentence):
    (folder / file).write_text((folder / file).read_text().replace(old, new))
    with pytest.raises(SystemExit, match=sentence) as stop:
        imported()
    assert "\n" not in str(stop.value.code)
    assert not (folder / "whole.onnx").exists()


def test_a_policy_with_other_times_gets_a_task_that_has_them(folder, capsys):
    """Its control period and its clock: what else the task says stays, or as near as they allow."""
    (folder / "tasks").mkdir()
    text = TASK.replace("robot.xml", "../robot.xml").replace("0.02", "0.019")
    text = text.replace(
        "horizon: 0.2", "horizon: 0.19\nlookahead: 0.05\nchanges: {option: {timestep: 0.0019}}"
    )
    (folder / "tasks/task.yaml").write_text(text)
    deploy = DEPLOY.replace("last_action: {params: {}", "gait_phase: {params: {period: 0.8}")
    (folder / "deploy.yaml").write_text(deploy)
    imported("--task", "tasks", "--deployment", "robot.json")
    assert "Give whole.task.yaml as the task from here on" in capsys.readouterr().out
    before, task = make_task("tasks"), make_task("whole.task.yaml")
    times = task.dynamics.time_step, task.dynamics.model.opt.timestep, task.signals.period
    assert times == pytest.approx((0.02, 0.002, 0.8))
    assert (task.horizon, task.lookahead) == (10, 3)
    assert task.cost.weights.tolist() == before.cost.weights.tolist()
    assert read_deployment(folder / "robot.json").time_step == task.dynamics.time_step
    imported("--task", "whole.task.yaml", "--overwrite")  # nothing else is written
    assert "and whole.task.yaml" not in capsys.readouterr().out
    (folder / "whole.onnx").unlink()
    with pytest.raises(SystemExit, match=r"whole\.task\.yaml' exists already"):
        imported("--task", "tasks")
    (folder / "deploy.yaml").write_text(DEPLOY)
    imported("--task", "tasks", "--overwrite")
    with pytest.raises(
        SystemExit, match=r"of 0\.02 s, but .* takes 0\.019 s; `vgps import` writes"
    ):
        vgps(["evaluate", "whole.onnx", "--task", "tasks"])


def test_an_import_that_is_refused_leaves_no_task_behind(folder):
    (folder / "deploy.yaml").write_text(DEPLOY.replace("0.02", "0.03"))
    (folder / "robot.xml").write_text(ROBOT.replace('<freejoint name="floating"/>', ""))
    with pytest.raises(SystemExit, match="'the free base/"):
        imported()
    assert not list(folder.glob("whole*"))


def test_an_import_that_fails_leaves_the_files_of_an_earlier_one(folder):
    (folder / "deploy.yaml").write_text(DEPLOY.replace("0.02", "0.03"))
    imported()
    earlier = {file: file.read_bytes() for file in folder.glob("whole*")}
    assert len(earlier) == 2
    (folder / "robot.xml").write_text(ROBOT.replace('<freejoint name="floating"/>', ""))
    with pytest.raises(SystemExit, match="'the free base/"):
        imported("--overwrite")
    assert {file: file.read_bytes() for file in folder.glob("whole*")} == earlier


@pytest.mark.parametrize(
    ("joint", "term", "sentence"),
    [
        ("tail", "base_angvel", r"(1 of base_angvel).* Did you mean 'base_ang_vel'\?"),
        ("tial", "base_ang_vel", r"drives \['hip', 'tial'\].* Did you mean 'tail'\?"),
    ],
)
def test_a_name_of_nothing_is_refused_with_the_nearest(folder, joint, term, sentence):
    text = f"joint_names: [hip, {joint}]\nobservation_names: [{term}]"
    (folder / "deploy.yaml").write_text(text)
    with pytest.raises(SystemExit, match=sentence):
        imported()


HEAD = """
  <body pos=".2 0 0"><joint name="neck" axis="0 1 0" damping=".1"/><geom size=".03" mass=".5"
    fromto="0 0 0 .2 0 0" type="capsule"/></body>
  <body pos="-.2 0 0"><joint name="wrist" axis="0 1 0"/><geom size=".03" mass=".5"
    fromto="0 0 0 -.2 0 0" type="capsule"/></body>
</body></worldbody>"""
STARTED = "\nstart: {keyframe: begin}"
KEY = '<keyframe><key name="begin" qpos="0 0 .3 1 0 0 0 0 0 .3 -.4"/></keyframe></mujoco>'


def with_a_head(folder, neck):
    """A robot with two more joints, which the policy does not drive: a control and a servo."""
    robot = ROBOT.replace("</body></worldbody>", HEAD).replace("</mujoco>", KEY)
    more = f'{neck}<position joint="wrist" kp="30" kv="1"/></actuator>'
    (folder / "robot.xml").write_text(robot.replace("</actuator>", more))
    (folder / "task.yaml").write_text(TASK + STARTED)


def test_joints_that_it_does_not_drive_are_held(folder, capsys):
    with_a_head(folder, '<motor joint="neck"/>')
    robot = ["--deployment", "robot.json"]
    imported("--pose-stiffness", "40", "--pose-damping", "2", *robot)
    shown = capsys.readouterr().out
    for joint, place, k_p in (("neck", "0.3", "40"), ("wrist", "-0.4", "0")):
        line = next(line for line in shown.splitlines() if joint in line)
        cells = [cell.strip() for cell in line.split("│")[1:6]]
        assert cells == ["held", joint, place, "0", k_p]
    file, task = open_policy(folder / "whole.onnx"), make_task("task.yaml")
    task = for_policy(task, file)
    driver = driver_of(task.deployment, file)
    assert list(task.controls.stiffness) == [20.0, 30.0, 40.0, 30.0]
    law, told = driver.new_law(), task.signals.constant_context(task.signals.rest, 100)
    observed = driver.observation.within
    states = task.dynamics.rollout(task.initial_state, lambda t, x: law(observed(told[t])(x)), 100)
    where = states.states[-1][9:11]
    assert np.abs(where - [0.3, -0.4]).max() < 0.15  # by 40 and 30 N·m/rad, as the robot tumbles
    asked = task.controls.at_joints(states.controls)
    np.testing.assert_allclose(asked[:, 2:], [[0.3, -0.4]] * len(asked), atol=1e-12)
    assert np.abs(np.diff(asked[:, :2], axis=0)).max() > 0
    # An executor without the task does the same.
    known = read_deployment(folder / "robot.json")
    policy = file.policy(known.controls)
    known = replace(known, controls=known.controls.with_servos(policy.stiffness, policy.damping))
    light = driver_of(known, file)
    law, observed = light.new_law(), light.observation.within
    found = [law(observed(told[t])(x[None]))[0] for t, x in enumerate(states.states[:-1])]
    np.testing.assert_allclose(known.controls.at_joints(np.array(found)), asked, atol=1e-6)
    with pytest.raises(SystemExit):
        imported("--deployment", "robot.yaml", "--overwrite")
    assert "name it robot.json" in capsys.readouterr().err


def test_what_cannot_be_held_is_refused_by_name(folder):
    with_a_head(folder, '<general joint="neck" biastype="affine" biasprm="0 9 0"/>')
    with pytest.raises(SystemExit, match="does not drive neck, whose activation cannot hold it"):
        imported()


def test_a_file_that_leaves_a_joint_to_itself_is_refused(folder):
    imported()
    with_a_head(folder, '<motor joint="neck"/>')
    with pytest.raises(SystemExit, match="does not drive neck, wrist; write it with `vgps import`"):
        vgps(["evaluate", "whole.onnx", "--task", "task.yaml"])
