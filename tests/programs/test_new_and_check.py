# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""`vgps new` writes a task file that works, and `vgps check` says what is wrong with one."""

import json

import pytest

from tests.simulation.robots import EVERYTHING
from tests.tasks.hopper_file import HOPPER
from vgps_ros.programs.__main__ import main
from vgps_ros.tasks import make_task

PENDULUM = """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.05" contype="0" conaffinity="0"/>
    </body>
    <body name="other" pos="1 0 0">
      <joint name="free_hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.05" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
TASK = """
model: pendulum.xml
control_period: 0.02
horizon: 1.0
start: {positions: {hinge: 1.0}}
cost:
  - {sensor: hinge/position}
  - {control: all, weight: WEIGHT}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    return tmp_path


def ends_with(capsys, *words):
    """Returns the sentence with which a command fails."""
    with pytest.raises(SystemExit) as stop:
        main(words)
    return f"{stop.value} {capsys.readouterr().err}"


@pytest.mark.parametrize(("hard", "is_softened"), [('solimplimit="0 0.8 0.03"', False), ("", True)])
def test_the_first_file_softens_limits_whose_force_jumps(folder, hard, is_softened):
    limited = PENDULUM.replace('name="hinge"', f'name="hinge" limited="true" range="-1 1" {hard}')
    (folder / "robot.xml").write_text(limited)
    main(["new", "mine", "--model", "robot.xml"])
    assert ("solimp_limit" in (folder / "mine" / "task.yaml").read_text()) == is_softened
    assert make_task(str(folder / "mine")).dynamics.model.joint("hinge").solimp[0] == 0.0


@pytest.mark.parametrize("robot", [PENDULUM, HOPPER, EVERYTHING], ids=["fixed", "planar", "free"])
def test_the_first_file_of_any_robot_makes_a_task_whose_cost_ddp_lowers(robot, folder, capsys):
    (folder / "robot.xml").write_text(robot)
    main(["new", "mine", "--model", "robot.xml"])
    assert "Next: vgps check mine/task.yaml" in capsys.readouterr().out
    task = make_task(str(folder / "mine"))
    assert task.dims["n_u"] >= 1
    assert task.name == str(folder / "mine" / "task.yaml")
    main(["check", "mine", "--iterations", "5"])
    shown = capsys.readouterr().out
    assert f"{task.dims['n_x']} numbers a state" in shown
    first, last = (
        float(word) for word in shown.partition("DDP: ")[2].split(" in ")[0].split(" to ")
    )
    assert last < first


def test_the_first_file_of_a_planar_robot_keeps_it_upright_at_any_time_step(folder):
    text = HOPPER.replace("<worldbody>", '<option timestep="0.003"/><worldbody>')
    (folder / "robot.xml").write_text(text)
    main(["new", "mine", "--model", "robot.xml"])
    task = make_task(str(folder / "mine"))
    dt = task.dynamics.time_step
    assert dt == pytest.approx(0.009)
    assert task.horizon * dt == pytest.approx(2.0, abs=dt)
    leaning = task.initial_state.copy()
    leaning[2] = 1.2
    assert task.fallen(leaning)
    assert not task.fallen(task.initial_state)
    scored = (folder / "mine" / "task.yaml").read_text()
    assert "{sensor: up, index: [x], target: [0], weight: 5.0}" in scored


def test_a_robot_without_motors_and_floor_gets_both(folder, capsys):
    bare = HOPPER.replace('<geom name="floor" type="plane" size="0 0 1"/>', "")
    bare = bare[: bare.index("  <actuator>")] + "</mujoco>"
    (folder / "robot.xml").write_text(bare)
    main(["new", "mine", "--model", "robot.xml"])
    model = make_task(str(folder / "mine")).dynamics.model
    assert model.geom("floor").id >= 0
    assert [model.actuator(i).name for i in range(model.nu)] == ["hip"]


def test_new_replaces_no_file_and_names_what_is_not_there(folder, capsys):
    main(["new", "mine", "--model", "pendulum.xml"])
    assert "exists already" in ends_with(capsys, "new", "mine", "--model", "pendulum.xml")
    assert "no file '../pendulun.xml'" in ends_with(capsys, "new", "his", "--model", "pendulun.xml")
    assert "no package nowhere" in ends_with(
        capsys, "new", "his", "--model", "package://nowhere/a.xml"
    )


def check(folder, capsys, *pairs, weight="1.0"):
    text = TASK.replace("WEIGHT", weight)
    for old, new in pairs:
        text = text.replace(old, new)
    (folder / "task.yaml").write_text(text)
    main(["check", "task.yaml", "--iterations", "20"])
    return " ".join(capsys.readouterr().out.split())


def test_nothing_is_said_of_a_sound_task(folder, capsys):
    assert check(folder, capsys).endswith("Nothing looks wrong.")


def test_a_cost_that_no_control_moves_is_named(folder, capsys):
    (folder / "pendulum.xml").write_text(PENDULUM.replace("free_hinge", "free[/hinge]"))
    shown = check(folder, capsys, ("cost:", 'cost:\n  - {sensor: "free[/hinge]/position"}'))
    assert "! No control moves the cost's free[/hinge]/position" in shown
    assert "cost's hinge/position" not in shown


def test_a_control_at_its_limit_is_named(folder, capsys):
    assert "The control of hinge is at its limit" in check(folder, capsys, weight="1.0e-6")


def test_a_first_motion_that_diverges_is_said_with_what_helps(folder, capsys):
    (folder / "pendulum.xml").write_text(
        PENDULUM.replace('ctrllimited="true" ctrlrange="-1 1"', "")
    )
    shown = check(folder, capsys, ("cost:", "begin: {law: noise, std: 1.0e+11}\ncost:"))
    assert "The first rollout diverges: begin with smaller controls" in shown


def test_settings_with_which_no_training_could_begin_are_refused(folder, capsys):
    task = folder / "task.yaml"
    task.write_text(TASK.replace("WEIGHT", "0.01") + "search: {hidden_units: []}\n")
    words = ends_with(capsys, "check", str(task))
    assert "hidden_units is empty, but it must have at least one value." in words


def test_a_picture_replaces_no_file(folder, capsys):
    (folder / "task.yaml").write_text(TASK.replace("WEIGHT", "1.0"))
    main(["check", "task.yaml", "--iterations", "3", "--picture", "motion.png"])
    assert (folder / "motion.png").read_bytes().startswith(b"\x89PNG")
    assert "exists already" in ends_with(capsys, "check", "task.yaml", "--picture", "motion.png")


def test_a_task_of_ones_own_is_trained_and_evaluated_from_anywhere(folder, capsys, monkeypatch):
    (folder / "task.yaml").write_text(TASK.replace("WEIGHT", "1.0"))
    main(["train", "--task", "task.yaml", "--iterations", "2", "--output", "run"])
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    capsys.readouterr()
    main(["evaluate", "../run", "--seconds", "1", "--json", "-"])
    found = json.loads(capsys.readouterr().out)
    assert found["task"] == str(folder / "task.yaml")
    assert found["cost_per_step"]["mean"] < 1.0
