# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The first task of an arm or a hand, locks and servos."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from tests.wizard.models import ACROBOT, ARM, CUBE, FOUR, HAND, SERVO, SIX_JOINTS, TWO, walker
from vgps_ros.programs.__main__ import main
from vgps_ros.tasks import make_task
from vgps_ros.wizard.task_check import examine_task


def test_a_hand_starts_within_its_limits(written):
    text, _ = written(HAND.replace('range="0 90"', 'range="18 90"', 1))
    assert "positions: {f0_1: 0.6283}" in text


def test_the_servos_of_an_arm_may_go_where_it_shall_go(written):
    arm = ARM.replace("</worldbody>", CUBE + "</worldbody>")
    stiff = arm.replace("motor", 'position kp="900" forcerange="-9 9"')
    text, task = written(stiff)
    assert "{control: all, pose: {shoulder: 0.5, elbow: 0.5}, weight: 2}" in text
    assert task.cost.control_targets.tolist() == [0.5, 0.5]
    narrow = 'position kp="9" ctrllimited="true" ctrlrange="-.1 .1" name="elbow"'
    text, _ = written(
        ACROBOT.replace('<motor name="elbow"', f"<{narrow}").replace(
            'joint="elbow" ctrlrange="-2 2" ctrllimited="true"', 'joint="elbow"'
        )
    )
    assert text.partition("control: all")[2].partition("weight: ")[2].startswith("50}")
    first = task.begin(task, task.initial_state, task.horizon, np.random.default_rng(0))
    assert first.trajectory.controls == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("model", "axes", "seen"), [(ARM, "xz", "geom: lower_geom"), (SIX_JOINTS, "xyz", "site: tool")]
)
def test_the_tip_of_an_arm_is_commanded_in_a_box_that_it_reaches(written, model, axes, seen):
    """It starts bent in the middle of the box, and DDP brings it to the ends."""
    text, task = written(model)
    assert f"tip: {{type: framepos, {seen}}}" in text
    assert "varied: {position: 0.4, velocity: 0.3}" in text
    commands = task.signals.commands
    assert [c.name for c in commands] == list(axes)
    assert {f"command/{axis}" for axis in axes} <= {*task.observation.names}
    assert {"tip/x", "tip/y", "tip/z"} <= {*task.observation.names}
    (half,) = {c.highest for c in commands}
    assert half > 0.05
    assert all(c.lowest == -half for c in commands)
    data = mujoco.MjData(task.dynamics.model)
    data.qpos[:] = task.initial_state[: len(data.qpos)]
    mujoco.mj_kinematics(task.dynamics.model, data)
    kind, name = seen.split(": ")
    tip = getattr(data, kind)(name).xpos
    rests = [term for term in yaml.safe_load(text)["cost"] if term.get("sensor") == "tip"]
    middle = [target["rest"] for target in rests[0]["target"]]
    assert middle == pytest.approx(tip[["xyz".index(axis) for axis in axes]], abs=5e-3)
    found = examine_task(task, 5, 0, lambda *_: None).commands
    assert len(found) == 2 * len(axes)
    assert [does for *_, does in found] == pytest.approx([v for *_, v, _ in found], abs=half / 4)


def test_a_robot_without_actuators_gets_servos_as_strong_as_its_load(written):
    bare = walker(*FOUR).partition("<actuator>")[0] + "</mujoco>"
    text, task = written(bare)
    assert "stiffness:" in text
    assert task.dims["n_u"] == 12
    held = task.dynamics.rollout(
        task.initial_state, lambda *_: task.dynamics.controls.resting(task.initial_state), 100
    )
    assert not task.fallen(held.states).any()


def test_joints_are_locked_by_one_line_though_other_lines_name_them(written, tmp_path):
    text, _ = written(walker(*TWO).partition("<actuator>")[0] + "</mujoco>")
    assert "left_roll" in text.partition("flip:")[2]
    text = text.replace("  joints:", '  joints:\n    "*_roll": {lock: 0.0}')
    (tmp_path / "mine" / "task.yaml").write_text(text)
    task = make_task("mine")
    assert task.dims["n_u"] == 4
    assert not any("roll" in name for name in task.observation.names)


def test_new_locks_joints_and_puts_servos_in_place_of_motors(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    strong = walker(*FOUR, extra='gear="20" ctrlrange="-1 1"').replace(
        'joint="FL_knee" gear="20"', 'joint="FL_knee" gear="35"'
    )
    (tmp_path / "robot.xml").write_text(strong)
    flags = ["--lock", "*_roll", "HL_roll=0.2", "--servos"]
    main(["new", "mine", "--model", "robot.xml", *flags])
    task = make_task("mine")
    model = task.dynamics.model
    assert task.dims["n_u"] == 8
    forces = dict(zip(task.actuated_joint_names, model.actuator_forcerange[:, 1], strict=True))
    assert forces == pytest.approx(dict.fromkeys(forces, 20.0) | {"FL_knee": 35.0})
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert data.body("HL_thigh").xmat[5] == pytest.approx(-np.sin(0.2), abs=1e-6)
    assert data.body("HR_thigh").xmat[5] == pytest.approx(0.0, abs=1e-6)
    for wrong in ("FL_roll=far", "FL_roll=nan"):
        with pytest.raises(SystemExit, match="is no position of 'FL_roll'"):
            main(["new", "other", "--model", "robot.xml", "--lock", wrong])
    with pytest.raises(
        SystemExit, match=r"^vgps new: --lock FL_rol=0.5: 'FL_rol' matches no hinge or slide"
    ):
        main(["new", "other", "--model", "robot.xml", "--lock", "*_roll", "FL_rol=0.5"])


def test_new_locks_joints_of_a_robot_whose_keyframe_has_controls(tmp_path, monkeypatch):
    """As of Unitree's Go2, whose motors give way to servos."""
    monkeypatch.chdir(tmp_path)
    controls = " ".join(["0"] * 12)
    key = f'<keyframe><key name="home" ctrl="{controls}"/></keyframe></mujoco>'
    Path("robot.xml").write_text(walker(*FOUR).replace("</mujoco>", key))
    main(["new", "mine", "--model", "robot.xml", "--lock", "*_roll", "--servos"])
    assert make_task("mine").dims["n_u"] == 8


def test_servos_in_place_of_those_without_a_limit_are_as_strong_as_their_load(
    tmp_path, monkeypatch
):
    """As of dm_control's quadruped, whose yaw got 1e9 N·m and a rotor of 1e6 kg·m²."""
    monkeypatch.chdir(tmp_path)
    found = []
    for extra in (SERVO, 'kp="60"'):
        Path("robot.xml").write_text(walker(*FOUR, motor="position", extra=extra))
        main(["new", "mine", "--model", "robot.xml", "--servos", "--overwrite"])
        found.append(make_task("mine").dynamics.model.actuator_forcerange[:, 1])
    assert found[0] == pytest.approx(30.0)
    assert found[1].max() < 1000.0
