# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""`vgps new` writes a task file that works, and `vgps check` says what is wrong with one."""

import json
import re
import time

import numpy as np
import pytest

from tests.simulation.robots import EVERYTHING
from tests.tasks.hopper_file import HOPPER
from vgps_ros.programs.__main__ import main
from vgps_ros.tasks import make_task
from vgps_ros.wizard.task_check import examine_task, explain_inexact_derivatives

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
    text = HOPPER.replace("<worldbody>", '<option timestep="0.007"/><worldbody>')
    (folder / "robot.xml").write_text(text)
    main(["new", "mine", "--model", "robot.xml"])
    task = make_task(str(folder / "mine"))
    dt = task.dynamics.time_step
    assert dt == pytest.approx(4 * task.dynamics.model.opt.timestep)
    assert task.horizon == 50
    leaning = task.initial_state.copy()
    leaning[2] = 1.2
    assert task.fallen(leaning)
    assert not task.fallen(task.initial_state)
    scored = (folder / "mine" / "task.yaml").read_text()
    assert "{sensor: up, index: [x], target: [0], weight: 50}" in scored


def test_a_robot_with_a_ball_alone_is_read_and_held_by_its_quaternion(folder, capsys):
    ball = '<body name="arm" pos="0 0 1"><joint name="ball" type="ball" damping="0.1"/>'
    ball = PENDULUM.replace('<body name="arm">', ball)
    ball = re.sub('<joint name="hinge".*', "", ball).replace('="hinge"', '="ball" gear="1 1 1"')
    ball = re.sub('<body name="other".*?</body>', "", ball, flags=re.DOTALL)
    (folder / "robot.xml").write_text(ball)
    main(["new", "mine", "--model", "robot.xml"])
    task = make_task("mine")
    read = ("ball_turn/w", "ball_turn/x", "ball_turn/y", "ball_turn/z")
    assert task.observation.names == (*read, "ball/wx", "ball/wy", "ball/wz")
    assert task.cost_names == task.observation.names
    at_rest = task.cost(task.initial_state[None], np.zeros((1, 1)))
    turned = task.dynamics.space.add(task.initial_state, np.array([0, 0.5, 0, 0, 0, 0]))
    assert at_rest == 0.0 < task.cost(turned[None], np.zeros((1, 1)))
    main(["check", "mine", "--iterations", "5"])
    assert "Nothing looks wrong." in capsys.readouterr().out


def test_a_policy_that_reads_nothing_is_refused_with_its_line(folder, capsys):
    text = TASK.replace("WEIGHT", "0.1") + "observe: [{joint_positions: {except: ['*']}}]\n"
    (folder / "task.yaml").write_text(text)
    sentence = ends_with(capsys, "check", "task.yaml")
    assert "task.yaml line 9, observe: the policy reads nothing; name the readings" in sentence


@pytest.mark.parametrize("begin", ["path", "zero"])
def test_a_first_motion_that_is_the_best_already_is_no_trouble(folder, capsys, begin):
    text = TASK.replace("WEIGHT", "0.1").replace("start: {positions: {hinge: 1.0}}\n", "")
    (folder / "task.yaml").write_text(text + f"begin: {{law: {begin}}}\n")
    main(["check", "task.yaml", "--iterations", "2"])
    assert "Nothing looks wrong." in capsys.readouterr().out


def test_a_robot_without_motors_and_floor_gets_both(folder, capsys):
    bare = HOPPER.replace('<geom name="floor" type="plane" size="0 0 1"/>', "")
    bare = bare[: bare.index("  <actuator>")] + "</mujoco>"
    (folder / "robot.xml").write_text(bare)
    main(["new", "mine", "--model", "robot.xml"])
    model = make_task(str(folder / "mine")).dynamics.model
    assert model.geom("floor").id >= 0
    assert [model.actuator(i).name for i in range(model.nu)] == ["hip"]


WALKS = """
<mujoco>
  {ground}
  <worldbody>
    <body name="ball" pos="2 0 .1"><freejoint/><geom size=".1"/></body>
    <body name="base" {pose}><freejoint/><geom type="box" size=".1 .1 .1"/>
      <body pos=".1 0 0"><joint name="hip" axis="0 1 0"/>
        <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2"/></body></body>
  </worldbody>
  <actuator><motor joint="hip" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("ground", "pose", "height"),
    [
        ("", "", 0.22),
        ("", 'pos="0 0 -0.3"', 0.22),
        ("", 'pos="0 0 1"', 1.0),
        ("", 'euler="0 90 0"', 0.12),  # the leg lies along the ground, below the trunk
        ('<worldbody><geom type="plane" size="1 1 1" pos="0 0 .5"/></worldbody>', "", 0.72),
    ],
)
def test_the_first_file_stands_the_robot_on_its_ground(folder, ground, pose, height):
    """The robot is what has an actuator, and not the ball that comes first."""
    (folder / "robot.xml").write_text(WALKS.format(ground=ground, pose=pose))
    main(["new", "mine", "--model", "robot.xml"])
    task = make_task(str(folder / "mine"))
    model = task.dynamics.model
    place = model.jnt_qposadr[model.joint("base_free").id]
    assert task.initial_state[place + 2] == pytest.approx(height, abs=2e-3)
    assert not task.fallen(task.initial_state[None])[0]
    assert "velocity: {type: velocimeter, xbody: base}" in (folder / "mine/task.yaml").read_text()


def test_a_fixed_robot_gets_no_floor(folder):
    (folder / "robot.xml").write_text(PENDULUM.replace('contype="0" conaffinity="0"', ""))
    main(["new", "mine", "--model", "robot.xml"])
    assert "floor" not in (folder / "mine" / "task.yaml").read_text()


def test_new_replaces_no_file_and_names_what_is_not_there(folder, capsys):
    main(["new", "mine", "--model", "pendulum.xml"])
    assert "exists already" in ends_with(capsys, "new", "mine", "--model", "pendulum.xml")
    sentence = ends_with(capsys, "new", "his", "--model", "pendulun.xml")
    assert "vgps new: --model: there is no file 'pendulun.xml' in " in sentence
    assert "Did you mean 'pendulum.xml'?" in sentence
    assert "no package nowhere" in ends_with(
        capsys, "new", "his", "--model", "package://nowhere/a.xml"
    )
    assert not (folder / "his").exists()


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
    assert "their limits in a part of the steps: hinge (" in check(folder, capsys, weight="1.0e-6")


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


def test_a_disturbance_that_does_not_suit_the_robot_is_refused(folder, capsys):
    text = TASK.replace("WEIGHT", "0.1") + "search: {disturb.body: leg, disturb.push: 4.0}\n"
    (folder / "task.yaml").write_text(text)
    assert "there is no body 'leg'; there are arm, other" in ends_with(capsys, "check", "task.yaml")


@pytest.mark.parametrize(
    ("search", "sentence"),
    [
        ("{hidden_units: [0]}", r"task.yaml line 9, search.hidden_units: hidden_units is 0, but"),
        ("{situation: 3}", r"task.yaml line 9, search.situation: .* Did you mean 'situations'"),
        ("{alphas: [1, 2], alpha_iterations: [5, 1]}", "line 9, search: alpha_iterations is"),
    ],
)
def test_an_error_of_a_setting_of_the_search_has_its_line(folder, capsys, search, sentence):
    text = TASK.replace("WEIGHT", "0.1") + f"search: {search}\n"
    (folder / "task.yaml").write_text(text)
    for words in (["check", "task.yaml"], ["train", "--task", "task.yaml", "--output", "run"]):
        assert re.search(sentence, ends_with(capsys, *words))


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


FLAWED = """
<mujoco>
  <option timestep="0.01" {option}/>
  <worldbody><geom name="floor" type="plane" size="1 1 1"/>
    <body name="box" pos="0 0 {height}"><freejoint/>
      <geom name="box" type="box" size=".1 .1 .1" mass="1"/>
      <body name="arm" pos="0 0 .1"><joint name="hinge" axis="0 1 0" {range}/>
        <geom name="arm" type="capsule" size=".03" fromto="0 0 0 0 0 .3" mass=".3"/></body></body>
  </worldbody>
  <actuator><motor joint="hinge" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("option", "height", "turn", "sentence"),
    [
        ("", 0.02, "", r"the geoms floor and box are 0\.08 m inside each other"),
        ("", 0.1, 'limited="true" range="20 90"', "hinge starts at 0, beyond its range from 0.349"),
    ],
)
def test_a_start_or_a_solver_that_is_wrong_is_named(folder, capsys, option, height, turn, sentence):
    text = FLAWED.format(option=option, height=height, range=turn)
    (folder / "pendulum.xml").write_text(text)
    begin = ("cost:", "begin: {law: noise, std: 0.5}\ncost:")
    shown = check(folder, capsys, ("start: {positions: {hinge: 1.0}}\n", ""), begin)
    assert re.search(sentence, shown), shown


URDF = """<robot name="two"><link name="base"/><link name="arm"><inertial><mass value="1"/>
<origin xyz=".1 0 0"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="package://two/meshes/arm.stl"/></geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="20" velocity="5"/></joint></robot>"""


@pytest.mark.parametrize("place", ["around the URDF", "a ROS package", "nowhere"])
def test_meshes_that_a_urdf_names_by_package_are_found_or_left_out(
    folder, capsys, monkeypatch, place
):
    (folder / "two").mkdir()
    model = folder / "two" / "two.urdf"
    model.write_text(URDF)
    share = folder / "two" if place == "around the URDF" else folder / "ros" / "share" / "two"
    if place != "nowhere":
        (share / "meshes").mkdir(parents=True)
        corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], np.float32)
        faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
        sides = b"".join(bytes(12) + corners[list(f)].tobytes() + bytes(2) for f in faces)
        count = len(faces).to_bytes(4, "little")
        (share / "meshes" / "arm.stl").write_bytes(bytes(80) + count + sides)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(folder / "ros"))
    main(["new", "mine", "--model", str(model)])
    said = capsys.readouterr().out
    assert ("Without meshes, since" in said) == (place == "nowhere")
    assert make_task("mine").dynamics.model.nmesh == (place != "nowhere")


def test_a_base_that_stands_and_touches_its_first_link_is_named_and_no_setting(folder, capsys):
    base = """<body name="base" pos="0 0 1"><geom name="stand" type="box" size=".05 .05 .05"/>
      <body name="arm" pos="0 0 .05"><joint name="hinge" axis="0 1 0" damping="0.5"/>
      <geom name="link" type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass=".5"/></body></body>"""
    (folder / "pendulum.xml").write_text(
        f'<mujoco><option integrator="implicitfast"/><worldbody>{base}</worldbody><actuator>'
        '<position name="motor" joint="hinge" kp="60" dampratio="1" forcerange="-20 20"/>'
        "</actuator></mujoco>"
    )
    main(["new", "mine", "--model", "pendulum.xml"])
    main(["check", "mine"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "the geoms link and stand are 0.02 m inside each other though one carries" in shown
    assert "distribution_regularization" not in shown


@pytest.mark.parametrize(("weight", "obeys"), [("1.0e-4", True), ("1.0e+3", False)])
def test_check_says_what_the_motion_does_of_each_command(folder, capsys, weight, obeys):
    told = "commands: {to: {range: [-0.08, 0.08], unit: rad}}\ncost:"
    follows = "{sensor: hinge/position, target: {command: to}}"
    shown = check(
        folder,
        capsys,
        ("start: {positions: {hinge: 1.0}}\n", ""),
        ("cost:", told),
        ("{sensor: hinge/position}", follows),
        ("weight: 1.0", f"weight: {weight}"),
    )
    rows = re.findall(r"│ to +│ rad +│ +(\S+) │ +(\S+) │", shown)
    assert [float(value) for value, _ in rows] == [-0.08, 0.08]
    for value, does in rows:
        assert (abs(float(does) - float(value)) < 0.03) == obeys
    assert ("Commanded 0.08 rad to, DDP's motion does" in shown) != obeys


def test_a_start_at_the_goal_is_said(folder, capsys):
    shown = check(folder, capsys, ("start: {positions: {hinge: 1.0}}\n", ""))
    assert "Note: the start is the goal, where the robot stays without a control" in shown


def test_a_solver_that_ends_early_is_blamed_before_contact(folder):
    text = PENDULUM.replace("<option ", '<option solver="PGS" tolerance="1e-4" ')
    (folder / "pendulum.xml").write_text(text)
    (folder / "task.yaml").write_text(TASK.replace("WEIGHT", "1.0"))
    task = make_task("task.yaml")
    assert "PGS with a tolerance of 0.0001" in explain_inexact_derivatives(task, [0.5] * 10)[0]
    (folder / "pendulum.xml").write_text(PENDULUM.replace("<option ", '<option tolerance="1e-10" '))
    assert (
        "contact is too hard" in explain_inexact_derivatives(make_task("task.yaml"), [0.5] * 10)[0]
    )
    assert not explain_inexact_derivatives(task, [1e-6] * 10)
    soft = PENDULUM.replace("<option ", '<option tolerance="1e-10" ')
    (folder / "pendulum.xml").write_text(soft.replace("<geom ", '<geom solimp="0 .9" '))
    assert (
        "abruptly though it is soft"
        in explain_inexact_derivatives(make_task("task.yaml"), [0.5] * 10)[0]
    )


def test_weights_that_leave_the_noise_to_the_limits_are_named(folder, capsys):
    small = ("{sensor: hinge/position}", "{sensor: hinge/position, weight: 1.0e-4}")
    shown = check(folder, capsys, small, weight="1.0e-3")
    assert "The first noise of the control of hinge" in shown


def test_the_first_motion_is_made_once(folder, capsys):
    begin = "begin: {law: sampling, samples: 4}\ncost:"
    check(folder, capsys, ("cost:", begin))
    assert capsys.readouterr().err.count("Samples a first motion") <= 1


def test_a_motion_that_dives_at_its_end_is_named(folder, capsys):
    (folder / "robot.xml").write_text(HOPPER)
    main(["new", "mine", "--model", "robot.xml"])
    path = folder / "mine" / "task.yaml"
    short = re.sub("horizon: .*", "horizon: 0.9", path.read_text())
    path.write_text(re.sub("lookahead.*", "", short))
    main(["check", "mine"])
    assert "lets itself fall at its end" in " ".join(capsys.readouterr().out.split())


def test_a_thing_that_the_robot_hardly_touches_is_named(folder, capsys):
    """The arm falls on the paddle late, which a time in which nothing moves it precedes."""
    model = PENDULUM.replace(' contype="0" conaffinity="0"', "").replace(
        'pos="1 0 0"', 'pos=".4 0 -.4"'
    )
    (folder / "pendulum.xml").write_text(model.replace('-0.5"', '-0.6"'))
    goal = ("{sensor: hinge/position}", "{sensor: free_hinge/velocity, target: 3.0, weight: 1.0}")
    shown = check(folder, capsys, goal, ("horizon: 1.0", "horizon: 0.7"))
    assert "The cost's free_hinge/velocity does not change in" in shown, shown


def test_a_path_is_called_a_guess_whose_cost_may_rise(folder, capsys):
    fall = ("cost:", "begin: {law: path}\ncost:")
    strong = ("{sensor: hinge/position}", "{sensor: hinge/position, target: 1.0}")
    shown = check(folder, capsys, fall, strong, weight="100.0")
    first, last = (float(word) for word in re.search(r"DDP: (\S+) to (\S+) in", shown).groups())
    assert last > first == 0.0
    assert "It begins with a guess that no robot can follow" in shown
    assert "hardly lowers the cost" not in shown


def test_a_task_whose_derivatives_take_longer_than_ddp_has_is_told_so_at_once():
    found = examine_task(make_task("swimmer"), 3, 0, lambda *_: None, seconds=1e-6)
    assert "Derivatives along one motion take about" in found.troubles[-1]
    assert "lock joints" in found.troubles[-1]
    assert len(found.costs) == 1


def test_a_motion_that_still_improves_when_time_is_up_is_told_so():
    found = examine_task(make_task("swimmer"), 3, 0, lambda *_: time.sleep(5.0), seconds=5.0)
    assert len(found.costs) == 2
    assert any("DDP stopped after 5 s" in note for note in found.notes)


def test_an_axis_that_turns_in_a_plane_is_moved_though_not_across_it(folder, capsys):
    axis = "sensors:\n  axis: {type: framezaxis, body: arm}\ncost:\n  - {sensor: axis}"
    assert "No control moves" not in check(folder, capsys, ("cost:", axis))


def write_legged_urdf(path, foot, wheels=False):
    """Writes four legs of two hinges, as a URDF has them: no free joint, floor, motors or mesh.

    A leg ends at the height `foot` [m], in a ball, or in a wheel that turns without end.
    """

    def link(name, mass, more):
        moments = 'ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"'.format(mass / 500)
        return f'<link name="{name}"><inertial><mass value="{mass}"/><inertia {moments}/>' + (
            f"</inertial>{more}</link>"
        )

    def hinge(parent, child, place, limits='lower="-2.5" upper="2.5" '):
        kind = "revolute" if limits else "continuous"
        return (
            f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{place}"/><axis xyz="0 1 0"/>'
            f'<limit {limits}effort="9" velocity="9"/></joint>'
        )

    def shape(place, geometry):
        return f'<collision><origin xyz="{place}"/><geometry>{geometry}</geometry></collision>'

    ball = '<sphere radius=".02"/>'
    # The root of many URDFs is a frame that weighs next to nothing, with moments no body has.
    parts = [
        '<link name="base"><inertial><mass value="1e-6"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" '
        'ixy="1e-6" ixz="1e-6" iyz="1e-6"/></inertial></link>',
        link("trunk", 4, shape("0 0 0", '<box size=".4 .2 .1"/>')),
        '<joint name="to_trunk" type="fixed"><parent link="base"/><child link="trunk"/></joint>',
        # A link without inertial weighs nothing, whatever its shape.
        f'<link name="cover">{shape("0 0 .05", """<box size=".3 .2 .02"/>""")}</link>',
        '<joint name="to_cover" type="fixed"><parent link="trunk"/><child link="cover"/></joint>',
    ]
    for name, x, y in (("lf", 1, 1), ("rf", 1, -1), ("lh", -1, 1), ("rh", -1, -1)):
        parts += [
            hinge("trunk", f"{name}_thigh", f"{x * 0.2} {y * 0.15} 0"),
            link(
                f"{name}_thigh",
                0.5,
                shape(f"0 0 {foot / 4}", '<cylinder radius=".02" length=".08"/>'),
            ),
            hinge(f"{name}_thigh", f"{name}_shank", f"0 0 {foot / 2}"),
            link(f"{name}_shank", 0.2, "" if wheels else shape(f"0 0 {foot / 2}", ball)),
        ]
        if wheels:
            parts.append(hinge(f"{name}_shank", f"{name}_wheel", f"0 0 {foot / 2}", limits=""))
            parts.append(link(f"{name}_wheel", 0.1, shape("0 0 0", ball)))
    path.write_text(f'<robot name="four">{"".join(parts)}</robot>')


def test_a_urdf_whose_legs_hang_gets_a_free_joint_a_floor_and_servos(folder, capsys):
    write_legged_urdf(folder / "four.urdf", foot=-0.3)
    main(["new", "mine", "--model", "four.urdf"])
    text = (folder / "mine" / "task.yaml").read_text()
    assert "# Legs, 4 (6.8 kg, a free base" in text
    assert "free_bodies: [base]" in text
    # The trunk touches nothing, and is drawn nevertheless.
    assert make_task("mine").dynamics.model.body("trunk").geomnum == 1
    main(["check", "mine", "--iterations", "10"])
    assert "DDP's motion does" in capsys.readouterr().out


def test_wheels_at_the_ends_of_legs_are_locked_and_stand_as_feet(folder, capsys):
    write_legged_urdf(folder / "four.urdf", foot=-0.3, wheels=True)
    main(["new", "mine", "--model", "four.urdf"])
    assert "Locked the wheels lf_wheel_joint, rf_wheel_joint" in capsys.readouterr().out
    text = (folder / "mine" / "task.yaml").read_text()
    assert "# Legs, 4 (7.2 kg" in text
    assert "lh_wheel_joint: {lock: 0}" in text


def test_a_robot_goes_where_its_hinges_move_its_feet(folder):
    write_legged_urdf(folder / "four.urdf", foot=-0.3)
    text = (folder / "four.urdf").read_text().replace('axis xyz="0 1 0"', 'axis xyz="1 0 0"')
    (folder / "four.urdf").write_text(text)
    main(["new", "mine", "--model", "four.urdf"])
    assert "index: y, target: {command: forward}" in (folder / "mine" / "task.yaml").read_text()


def test_limbs_that_reach_up_are_no_legs(folder):
    write_legged_urdf(folder / "four.urdf", foot=0.3)
    main(["new", "mine", "--model", "four.urdf"])
    assert "free_bodies" not in (folder / "mine" / "task.yaml").read_text()


def test_a_xacro_is_refused_with_what_turns_it_into_a_urdf(folder):
    (folder / "four.urdf.xacro").write_text("<robot/>")
    with pytest.raises(SystemExit, match=r"xacro four\.urdf\.xacro > four\.urdf"):
        main(["new", "mine", "--model", "four.urdf.xacro"])
