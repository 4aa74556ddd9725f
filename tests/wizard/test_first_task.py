# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The first task file of each kind of robot: it is taken for what it is, and starts soundly."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from vgps_ros.programs.__main__ import main
from vgps_ros.tasks import make_task
from vgps_ros.wizard.task_check import derivative_errors, examine_task, explain_inexact_derivatives

GROUND = '<geom name="ground" type="plane" size="0 0 1"/>'
LEG = """
<body name="{name}_thigh" pos="{x} {y} 0">
  <joint name="{name}_roll" axis="1 0 0" range="-40 40"/>
  <joint name="{name}_hip" axis="0 1 0" range="-90 90"/>
  <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.2" contype="0" conaffinity="0"/>
  <body name="{name}_shank" pos="0 0 -.2"><joint name="{name}_knee" axis="0 1 0" range="0 150"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.18" contype="0" conaffinity="0"/>
    <geom name="{name}_foot" size=".02" pos="0 0 -.2"/></body>
</body>"""


WEAKER = 'ctrlrange="-25 25"'  # than what would shake these legs


def walker(*legs, motor="motor", extra=WEAKER, joint='<freejoint name="base"/>', armature=0.05):
    """Returns a trunk on legs, each of which has a name and a place."""
    joints = [f"{name}_{part}" for name, *_ in legs for part in ("roll", "hip", "knee")]
    return f"""<mujoco><compiler autolimits="true"/><option timestep="0.002"/>
    <default><joint damping=".5" armature="{armature}"/></default>
    <worldbody>{GROUND}<body name="trunk" pos="0 0 .6">{joint}
      <geom name="trunk" type="box" size=".2 .1 .05" mass="5"/>
      {"".join(LEG.format(name=name, x=x, y=y) for name, x, y in legs)}</body></worldbody>
    <actuator>{"".join(f'<{motor} name="{j}" joint="{j}" {extra}/>' for j in joints)}</actuator>
    </mujoco>"""


def on_soles(servo):
    """Returns a walker on two legs, whose soles are held level by ankles."""
    return re.sub(
        r'<geom name="(\w+)_foot" size=".02" pos="0 0 -.2"/>',
        r'<body name="\1_sole" pos="0 0 -.2"><joint name="\1_ankle" axis="0 1 0" range="-60 60"/>'
        r'<geom name="\1_foot" type="box" size=".08 .06 .01"/></body>',
        walker(*TWO, motor="position", extra=servo),
    ).replace(
        "</actuator>",
        "".join(
            f'<position name="{n}_ankle" joint="{n}_ankle" {servo}/>' for n in ("left", "right")
        )
        + "</actuator>",
    )


PLANE = (
    '<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>'
    '<joint name="pitch" axis="0 1 0"/>'
)
TWO = (("left", 0, 0.1), ("right", 0, -0.1))
FOUR = (("FL", 0.2, 0.1), ("FR", 0.2, -0.1), ("HL", -0.2, 0.1), ("HR", -0.2, -0.1))
SERVO = 'kp="60" kv="1" forcerange="-30 30" ctrlrange="-2.6 2.6"'
LATE = 'biastype="affine" dyntype="filterexact" dynprm=".1" forcerange="-30 30"'
LINK = '<geom type="capsule" size=".02" fromto="0 0 0 0 0 .4"/>'
ACROBOT = f"""<mujoco><worldbody><body name="upper" pos="0 0 2">
  <joint name="shoulder" axis="0 1 0"/>
  {LINK}<body name="lower" pos="0 0 .4"><joint name="elbow" axis="0 1 0"/>{LINK}</body>
  </body></worldbody><option><flag contact="disable"/></option>
  <actuator><motor name="elbow" joint="elbow" ctrlrange="-2 2" ctrllimited="true"/></actuator>
  </mujoco>"""
ARM = ACROBOT.replace(
    "<actuator>", '<actuator><motor joint="shoulder" ctrlrange="-9 9" ctrllimited="true"/>'
)
WEAK = f"""<mujoco><worldbody><body pos="0 0 2"><joint name="swing" axis="0 1 0"/>{LINK}</body>
  </worldbody><actuator><motor joint="swing" ctrlrange="-.5 .5" ctrllimited="true"/></actuator>
  </mujoco>"""
SEGMENT = """<body pos="0 .1 0"><joint name="{0}" axis="0 0 1"/>
  <geom type="capsule" size=".01" fromto="0 0 0 0 .08 0"/>"""
FISH = f"""<mujoco><option density="1000"><flag gravity="disable"/></option><worldbody>
  <body name="head" pos="0 0 1"><freejoint name="root"/><geom type="ellipsoid" size=".02 .05 .02"/>
  {SEGMENT.format("neck")}{SEGMENT.format("tail")}</body></body></body>
  {{target}}</worldbody><actuator><position joint="neck" kp=".01"/><position joint="tail" kp=".01"/>
  </actuator></mujoco>"""
SPINNER = ARM.replace(
    "</worldbody>",
    '<body name="top" pos=".5 0 2"><joint name="spin" axis="0 1 0"/><geom size=".1"/></body>'
    "</worldbody>",
)
CUP = """<mujoco><worldbody><body name="cup" pos="0 0 1">
  <joint name="cup" type="slide" axis="0 0 1" stiffness="20" damping="3"/>
  <geom type="box" size=".1 .1 .01"/>
  <site name="target" pos="0 0 .1"/></body>
  <body name="ball" pos="0 0 1.2"><joint name="fall" type="slide" axis="0 0 1"/>
  <geom size=".03"/></body>
  </worldbody><actuator><motor joint="cup" ctrlrange="-9 9" ctrllimited="true"/>
  </actuator></mujoco>"""

ROTOR = '<site name="{0}{1}" pos="{0}.1 {1}.1 0"/>'
DRONE = f"""<mujoco><worldbody>{GROUND}<body name="drone" pos="0 0 1"><freejoint name="base"/>
  <geom type="box" size=".1 .1 .02" mass="1"/>
  {"".join(ROTOR.format(x, y) for x in "-+" for y in "-+")}</body></worldbody><actuator>
  {
    "".join(
        f'<motor site="{x}{y}" gear="0 0 2 0 0 0" ctrllimited="true" ctrlrange="0 9"/>'
        for x in "-+"
        for y in "-+"
    )
}</actuator></mujoco>"""
CART = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
  <body name="cart" pos="0 0 .1"><freejoint/><geom type="box" size=".2 .1 .05"/>
    <body name="wheel" pos=".2 0 -.05"><joint name="wheel" axis="0 1 0"/><geom size=".05"/></body>
  </body></worldbody><actuator><motor joint="wheel" ctrllimited="true" ctrlrange="-1 1"/></actuator>
  </mujoco>"""
FINGER = """<body pos="{0} 0 1"><joint name="f{0}_1" axis="0 1 0" range="0 90"/>{1}
  <body pos="0 0 .4"><joint name="f{0}_2" axis="0 1 0" range="0 90"/>{1}</body></body>"""
BAR = '<body name="{0}" pos="{1} 0 2"><joint name="{0}" axis="0 1 0"/>{2}{3}</body>'
COUPLER = BAR.format("coupler", 0, LINK, "")
FOUR_BARS = f"""<mujoco><worldbody>{BAR.format("crank", 0, LINK, COUPLER)}
  {BAR.format("rocker", 0.3, LINK, "")}</worldbody>
  <equality><connect body1="coupler" body2="rocker" anchor="0 0 .4"/></equality>
  <actuator><motor joint="crank" ctrlrange="-90 90" ctrllimited="true"/></actuator></mujoco>"""
HAND = f"""<mujoco><compiler autolimits="true"/><worldbody>
  {"".join(FINGER.format(x, LINK) for x in range(3))}</worldbody><actuator>
  {"".join(f'<motor joint="f{x}_{i}" ctrlrange="-9 9"/>' for x in range(3) for i in (1, 2))}
  </actuator></mujoco>"""

CUBE = '<body name="cube" pos=".4 .3 1"><freejoint/><geom type="box" size=".04 .04 .04"/></body>'
BOLTED = "".join(
    f'<joint name="b{a}" type="slide" axis="{v}" damping="1e11"/>'
    for a, v in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
)
MOUSE = '<body name="mouse" mocap="true" pos=".5 0 2"><geom size=".02" contype="0"/></body>'
HELD = ARM.replace("</worldbody>", f"{MOUSE}</worldbody>").replace(
    "</mujoco>", '<equality><weld body1="mouse" body2="lower"/></equality></mujoco>'
)


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Returns a function that writes a task for a model, and returns its text and the task."""
    monkeypatch.chdir(tmp_path)

    def write(model):
        (tmp_path / "robot.xml").write_text(model)
        main(["new", "mine", "--model", "robot.xml", "--overwrite"])
        return (tmp_path / "mine" / "task.yaml").read_text(), make_task("mine")

    return write


@pytest.mark.parametrize(
    ("model", "kind", "words"),
    [
        (walker(*FOUR), "Legs, 4", ["command: turn", "clock: {frequency", "begin: {law: pd}"]),
        (walker(*TWO), "Legs, 2", ["swap: [[left, right]]", "begin: {law: path}"]),
        (walker(*TWO), "Legs, 2", ["up, turning, velocity, commands", '"velocity/*": 0.03']),
        # On two points it falls whatever its servos hold, on soles it stands, if they are not soft:
        (walker(*TWO, motor="position", extra=SERVO), "Legs, 2", ["begin: {law: path}"]),
        (on_soles(SERVO), "Legs, 2", ["begin: {law: pd}"]),
        (on_soles(SERVO.replace("60", "3")), "Legs, 2", ["begin: {law: path}"]),
        (walker(("mid", 0, 0)), "Legs, 1", ["clock: {frequency"]),
        (
            walker(("mid", 0, 0), extra='ctrlrange="-20 20"'),
            "Legs, 1",
            ["begin: {law: sampling", "mid_knee/position, target: 0", "when: moving"],
        ),
        (
            ACROBOT,
            "underactuated",
            ["elbow_axis, target: [0, 0, 1], weight: 0.25", "shoulder: 3.1416"],
        ),
        (ACROBOT, "underactuated", ["begin: {law: best}", "beyond: 0.2", "lookahead: 1 "]),
        (
            WEAK,
            "underactuated",
            [
                "swing: 3.1416",
                "swing_axis, target: [0, 0, 1], weight: 1",
                "horizon: 6 ",
                "lookahead: 2 ",
                "{control: all, weight: 0.8}",
            ],
        ),
        (WEAK.replace('"-.5 .5"', '"-9 9"'), "An arm", ["swing/position, target: 0.5"]),
        (WEAK.replace("motor", 'position kp="30"'), "An arm", ["swing/position, target: 0.5"]),
        (WEAK.replace("motor", 'position kp="30" forcerange="-.5 .5"'), "underactuated", []),
        (ARM, "its tip shall go where it is commanded", ["index: [x, z], target: [{command: x"]),
        (ARM.replace("</worldbody>", CUBE + "</worldbody>"), "An arm", ["shoulder/position"]),
        (ARM.replace("<joint", BOLTED + "<joint", 1), "An arm", ["index: [x, z]"]),
        (HELD, "An arm", ["remove_bodies: [mouse]"]),
        (FOUR_BARS, "An arm", ["crank/position, target: 0.5"]),
        (CART, "No feet were found", ["index: x, target: 1", "solref: [0.032, 1]"]),
        (HAND, "A hand, 3 fingers", ["f2_1/position, target: 0.5"]),
        (FISH.format(target=""), "A swimmer", ["index: y, target: -0.1"]),
        (
            FISH.format(target='<site name="target" pos="0 .3 1"/>'),
            "A swimmer",
            ["site: target, relative_to: {xbody: head}", '"root/r?": 1', "renew:"],
        ),
        (SPINNER, "it shall turn spin", ["sensor: spin/velocity", "begin: {law: best}"]),
        (SPINNER, "An arm", ["{joint: spin, as: sin_cos}", "joint_positions: {except: [spin]}"]),
        (CUP, "An arm", ["xbody: ball, relative_to: {site: target}", "index: [z]"]),
        (CUP, "An arm", ["solref: [0.017, 1]", "begin: {law: best}", "std_limit: {"]),
    ],
)
def test_each_kind_of_robot_gets_the_task_that_it_is_meant_for(written, model, kind, words):
    text, task = written(model)
    assert kind in text
    for word in words:
        assert word in text
    assert np.isfinite(task.initial_state).all()


def test_motors_that_would_throw_light_joints_about_become_servos_as_strong(written):
    """A joint of inertia I is accelerated by τ / I."""
    light, _ = written(walker(*FOUR, armature=0.001))
    assert "remove_actuators" in light
    assert "limit: 25" in light
    heavy, _ = written(walker(*FOUR, armature=0.1))
    assert "remove_actuators" not in heavy
    arm, _ = written(ARM)
    assert "remove_actuators" not in arm


def test_legs_start_bent_with_their_feet_on_the_ground(written):
    one_way = walker(*TWO).replace('axis="0 1 0" range="-90 90"', 'axis="0 1 0" range="0 90"')
    for legs, robot in ((FOUR, walker(*FOUR)), (TWO, walker(*TWO)), (TWO, one_way)):
        _, task = written(robot)
        model = task.dynamics.model
        bent = {model.joint(j).name: model.jnt_qposadr[j] for j in range(model.njnt)}
        assert all(task.initial_state[i] > 0.2 for name, i in bent.items() if "knee" in name)
        feet = [name for name in task.cost_names if name.startswith("foot_")]
        assert len([name for name in feet if name.endswith("/z")]) == len(legs)
        assert len([name for name in feet if "_speed/" in name]) == 2 * len(legs)
        # Feet touch the ground and nothing else, and those of four legs stand apart.
        touching = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
        names = [f"{name}_foot" for name, *_ in legs]
        assert [model.geom(i).name for i in touching] == ["ground", *names]
        data = mujoco.MjData(model)
        data.qpos[:] = task.initial_state[: model.nq]
        mujoco.mj_kinematics(model, data)
        assert (np.ptp([data.geom(name).xpos[1] for name in names]) > 0.25) == (legs is FOUR)
        assert not task.fallen(task.initial_state[None])[0]
        assert task.dynamics.time_step == pytest.approx(4 * model.opt.timestep)


def test_feet_that_are_meshes_stand_on_the_ground_by_their_lowest_vertex(written):
    """A wedge's box reaches below it once it is turned."""
    wedge = '<asset><mesh name="wedge" vertex="0 .03 0 0 -.03 0 .1 0 0 .1 0 .08"/></asset>'
    robot = walker(*FOUR).replace('_foot" size=".02"', '_foot" type="mesh" mesh="wedge"')
    _, task = written(robot.replace("<worldbody>", f"{wedge}<worldbody>"))
    model = task.dynamics.model
    data = mujoco.MjData(model)
    data.qpos[:] = task.initial_state[: model.nq]
    mujoco.mj_kinematics(model, data)
    mesh, lowest = model.mesh_vert, []
    for name in ("FL_foot", "FR_foot", "HL_foot", "HR_foot"):
        turn = data.geom(name).xmat.reshape(3, 3)
        lowest.append((data.geom(name).xpos + mesh[: model.mesh_vertnum[0]] @ turn.T)[:, 2].min())
    assert min(lowest) == pytest.approx(0.0, abs=1e-3)


def test_six_joints_that_carry_a_robot_anywhere_become_a_free_one(written):
    six = "".join(
        f'<joint name="{kind}_{axis}" type="{kind}" axis="{place}"/>'
        for kind in ("slide", "hinge")
        for axis, place in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    )
    text, task = written(walker(*FOUR, extra=SERVO, joint=six, motor="position"))
    assert "free_bodies: [trunk]" in text
    assert [c.name for c in task.signals.commands] == ["forward", "sideways", "turn"]
    plane, _ = written(walker(*FOUR, extra=SERVO, joint=PLANE, motor="position"))
    assert "free_bodies" not in plane


def test_legs_start_from_no_keyframe_in_which_they_crouch(written):
    pose = "0 0 {} 1 0 0 0 0 -{} {} 0 -{} {}"
    for name, low, is_used in (
        ("squat", pose.format(0.3, *(1.4, 2.5) * 2), False),
        ("stand", pose.format(0.5, *(0.4, 0.8) * 2), True),
    ):
        key = f'<keyframe><key name="{name}" qpos="{low}"/></keyframe></mujoco>'
        text, task = written(walker(*TWO).replace("</mujoco>", key))
        assert ("keyframe: " + name in text) == is_used
        assert task.initial_state[2] > 0.35


def test_two_legs_in_a_plane_are_a_biped_unless_one_stands_far_before_the_other(written):
    beside, task = written(walker(*TWO, joint=PLANE))
    apart, _ = written(walker(("fore", 0.4, 0), ("hind", -0.4, 0), joint=PLANE))
    assert "begin: {law: path}" in beside
    assert "sensor_noise" not in beside
    assert "ddp_iterations: 24}" in beside
    assert "begin: {law: pd}" in apart
    assert "ddp_iterations: 16}" in apart
    assert not task.fallen(task.initial_state[None])[0]


def test_posture_counts_more_on_one_or_two_feet_than_on_four(written):
    """A leap that is fast at once costs a hopper more than to gain speed step by step."""
    found = []
    for legs in ([("mid", 0, 0)], TWO, FOUR):
        terms = yaml.safe_load(written(walker(*legs))[0])["cost"]
        weights = {term.get("sensor"): term["weight"] for term in terms}
        found.append([weights[name] for name in ("velocity", "up", "height")])
    hopper, biped, four = found
    assert hopper == pytest.approx(biped, rel=0.02)
    assert biped[0] > 1.2 * four[0]
    assert [biped[1], four[1]] == [50, 20]
    assert biped[2] > 1.2 * four[2]


def test_a_wall_is_no_ground(written):
    wall = GROUND + '<geom name="wall" type="plane" size="0 0 1" pos="3 0 0" zaxis="-1 0 0"/>'
    text, _ = written(walker(*TWO).replace(GROUND, wall))
    assert "only_contacts: [[ground, left_foot], [ground, right_foot]]" in text


def test_the_two_sides_swing_in_turn_and_mirror_each_other(written):
    text, task = written(walker(*FOUR))
    assert "swap: [[FL, FR], [HL, HR]]" in text
    assert "FL_roll" in text.partition("flip:")[2].partition("\n")[0]
    assert "FL_hip" not in text.partition("flip:")[2].partition("\n")[0]
    # A foot's slip counts while it is down, which is while it does not swing.
    phases = np.array([[0.0, 0.0, 0.0, np.sin(p), np.cos(p)] for p in np.linspace(0.1, 6.2, 9)])
    following, names = task.cost.following, list(task.cost_names)
    for foot in range(1, 5):
        slips = following.factors(phases)[:, names.index(f"foot_{foot}_speed/x")]
        lifts = following.added(phases)[:, names.index(f"foot_{foot}/z")]
        assert ((slips > 0.0) != (lifts > 0.0)).all()
    assert task.augmentation.mirror is not None


def test_a_foot_that_is_a_whole_shank_may_move_in_its_middle_while_it_is_down(written):
    """As the ant's feet are: its end stands, while the capsule turns about it."""
    foot = '<geom name="{name}_foot" size=".02" pos="0 0 -.2"/>'
    robot = walker(*FOUR)
    for name, *_ in FOUR:
        whole = f'<geom name="{name}_foot" type="capsule" size=".02" fromto="0 0 0 0 0 -.2"/>'
        assert foot.format(name=name) in robot
        robot = robot.replace(foot.format(name=name), whole)
    text, _ = written(robot)
    assert "foot_4" in text
    assert "stance" not in text


HEAD = """<body name="torso_head" pos="0 {y} .1"><joint name="torso_head" axis="0 1 0"/>
<geom size=".04" mass=".2"/></body>"""


@pytest.mark.parametrize("y", [0.0, 0.03])
@pytest.mark.parametrize(("left", "right"), [("left", "right"), ("l", "r"), ("L", "R")])
def test_a_mirror_is_found_wherever_along_its_axis_a_joint_is_anchored(written, left, right, y):
    """Letters as short as l and r are words of their own, as no torso has them."""
    robot = walker((left, 0, 0.1), (right, 0, -0.1))
    robot = robot.replace('mass="5"/>', f'mass="5"/>{HEAD.format(y=y)}')
    _, task = written(robot.replace("</actuator>", '<motor joint="torso_head"/></actuator>'))
    names, mirror = task.observation.names, task.augmentation.mirror
    for name, image, sign in (
        (f"{left}_hip/position", f"{right}_hip/position", 1.0),
        (f"{right}_roll/velocity", f"{left}_roll/velocity", -1.0),
        ("torso_head/position", "torso_head/position", 1.0),
    ):
        i = names.index(name)
        assert (names[mirror.inputs[i]], mirror.input_signs[i]) == (image, sign)


def test_a_robot_stands_on_a_height_field_under_it(written):
    """A plateau of 0.2 m, lower ground around it."""
    rows = "0 0 0 0 0  0 1 1 1 0  0 1 1 1 0  0 1 1 1 0  0 0 0 0 0"
    asset = (
        f'<asset><hfield name="h" nrow="5" ncol="5" size="4 4 .2 .1" elevation="{rows}"/></asset>'
    )
    robot = walker(*FOUR)
    text, _ = written(robot)
    raised = robot.replace(GROUND, '<geom name="ground" type="hfield" hfield="h"/>')
    higher, task = written(raised.replace("<worldbody>", f"{asset}<worldbody>"))
    heights = [float(re.search(r"sensor: height.*target: ([\d.]+)", t)[1]) for t in (text, higher)]
    assert heights[1] == pytest.approx(heights[0] + 0.2, abs=0.01)
    data = mujoco.MjData(task.dynamics.model)
    data.qpos[:] = task.initial_state[: len(data.qpos)]
    mujoco.mj_forward(task.dynamics.model, data)
    feet = [data.geom(f"{name}_foot").xpos[2] for name, *_ in FOUR]
    assert np.allclose(feet, 0.22, atol=0.01)


def test_joints_that_are_not_alike_have_no_mirror(written):
    text, _ = written(walker(("left", 0, 0.1), ("right", 0.05, -0.1)))
    assert "mirror" not in text


def test_wide_short_legs_are_two_as_well(written):
    """Microduck's feet are farther from each other than its hips are from the ground."""
    robot = walker(("left", 0, 0.25), ("right", 0, -0.25))
    text, _ = written(robot.replace('type="box" size=".2 .1 .05"', 'type="box" size=".1 .3 .05"'))
    assert "Legs, 2" in text
    assert "[joint_positions, joint_velocities, up, turning, velocity, commands, clock]" in text


def weight_of(text):
    return float(text.partition("{control: all, pose: start, weight: ")[2].partition("}")[0])


def test_stiff_servos_pay_for_what_a_step_takes_and_not_for_their_little_force(written):
    """A servo moves its joint by what it is told: where 3 N·m are .05 rad a step takes more."""
    weights = [
        weight_of(written(walker(*FOUR, motor="position", extra=SERVO.replace("30", force)))[0])
        for force in ("3", "10")
    ]
    assert weights[0] == weights[1]
    angle = (3.0 / weights[0]) ** 0.5
    assert 0.5 < angle < 0.7


def test_soft_servos_without_a_limit_get_targets_as_far_as_their_load_asks(written):
    free = 'kp="{}" kv="1" ctrlrange="-2.6 2.6"'
    stiff, soft, softest = (
        weight_of(written(walker(*FOUR, motor="position", extra=free.format(k)))[0])
        for k in (600, 20, 0.1)
    )
    assert softest < soft < stiff
    assert softest == pytest.approx(3.0 / np.pi**2, rel=0.05)  # further means nothing


def test_servos_are_scored_from_their_pose_and_each_motor_by_its_own_limit(written):
    strong = walker(*FOUR, motor="position", extra=SERVO.replace("30", "60"))
    assert weight_of(written(strong)[0]) == 3.0  # whose force is greatest 1 rad away
    weight = weight_of(written(walker(*FOUR, motor="position", extra=SERVO))[0])
    late = walker(*FOUR, motor="general", extra=f'gainprm="60" biasprm="0 -60 -1" {LATE}')
    text, task = written(late)
    lead = 1 + (2 * np.pi * 0.1 * task.signals.frequency) ** 2  # at which 1 rad of the servo moves
    assert lead > 2
    assert weight_of(text) == pytest.approx(weight / lead, rel=0.05)
    # Its noise is no wilder for that: policies hear no motion through one beyond its limits.
    assert task.search["alphas"] == pytest.approx([0.4 * lead, 1.2 * lead], rel=0.05)
    strong = walker(*TWO, extra='ctrlrange="-10 10"').replace(
        'joint="left_knee" ctrlrange="-10 10"', 'joint="left_knee" ctrlrange="-20 20"'
    )
    text, task = written(strong)
    weights = dict(zip(task.actuated_joint_names, task.cost.control_weights, strict=True))
    assert weights["left_hip"] == pytest.approx(4 * weights["left_knee"], rel=0.05)


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


SIX = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0")  # axes, as of a UR5
SIX_JOINTS = f"""<mujoco><worldbody>{
    "".join(
        f'<body pos="0 0 {length if i else 0.2}"><joint name="j{i}" axis="{axis}"/>'
        f'<geom type="capsule" size=".03" fromto="0 0 0 0 0 {length}"/>'
        for i, (axis, length) in enumerate(zip(SIX, (0.1, 0.4, 0.4, 0.1, 0.1, 0.1), strict=True))
    )
}<site name="tool" pos="0 0 .1"/>{"</body>" * 6}</worldbody>
<option><flag contact="disable"/></option><actuator>{
    "".join(f'<position joint="j{i}" kp="900" kv="90"/>' for i in range(6))
}</actuator></mujoco>"""


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


def test_what_makes_derivatives_worthless_is_changed_and_activations_are_read(written):
    slack = ARM.replace("<option>", '<option solver="PGS" tolerance="1e-4" iterations="3">')
    lagging = slack.replace("<motor name=", '<general dyntype="filter" dynprm=".1" name=', 1)
    text, task = written(lagging)
    assert "solver: Newton, iterations: 100, tolerance: 1.0e-10" in text
    assert "elbow/activation" in task.observation.names


def test_friction_cones_are_pyramids_whose_derivatives_are_exact(written):
    """As many of menagerie's quadrupeds have them elliptic, with an impratio of 100."""
    steep = walker(*FOUR, motor="position", extra=SERVO)
    steep = steep.replace("<option", '<option cone="elliptic" impratio="100"')
    text, task = written(steep)
    first = task.begin(task, task.initial_state, 30, np.random.default_rng(0)).trajectory
    assert np.quantile(derivative_errors(task, first), 0.9) < 1e-3
    assert not explain_inexact_derivatives(task, derivative_errors(task, first))
    round_cones = text.replace("cone: pyramidal", "cone: elliptic")
    assert round_cones != text
    Path("mine/task.yaml").write_text(round_cones)
    task = make_task("mine")
    errors = derivative_errors(task, first)
    assert np.quantile(errors, 0.9) > 1.0
    assert "cone: pyramidal" in explain_inexact_derivatives(task, errors)[0]


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
        SystemExit, match=r"^vgps new: --lock FL_rol=0.5: 'FL_rol' matches no joint"
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


def test_a_swimmer_reads_its_target_in_its_own_frame_alone(written):
    _, task = written(FISH.format(target='<site name="target" pos="0 .3 1"/>'))
    state = task.initial_state
    turned = np.concatenate([[0.3, 0.3, 1, np.sqrt(0.5), 0, 0, np.sqrt(0.5)], state[7:]])
    there = task.observation(np.stack([state, turned]))  # 0.3 m ahead of it, as it has turned left
    assert "to_target/y" in task.observation.names
    assert there[0] == pytest.approx(there[1], abs=1e-9)


def test_a_drone_begins_in_the_air_where_its_rotors_hold_it(written):
    text, task = written(DRONE)
    assert "begin: {law: pd}" in text
    motion = task.begin(task, task.initial_state, 100, np.random.default_rng(0)).trajectory
    assert motion.controls == pytest.approx(9.81 / 8, rel=1e-6)
    assert motion.states[:, 2] == pytest.approx(1.0, abs=1e-6)


def test_a_nose_along_y_is_noticed(written):
    places = [(name, -y, x) for name, x, y in FOUR]
    turned = walker(*places).replace('size=".2 .1 .05"', 'size=".1 .2 .05"')
    turned = turned.replace(
        "</body></worldbody>",
        '<body name="head" pos="0 .4 0"><geom size=".05"/></body></body></worldbody>',
    )
    for old, new in (("1 0 0", "other"), ("0 1 0", "1 0 0"), ("other", "0 1 0")):
        turned = turned.replace(f'axis="{old}"', f'axis="{new}"')
    text, _ = written(turned)
    assert "index: y, target: {command: forward}" in text


def test_meshes_whose_files_are_missing_are_dropped_and_named(written, capsys):
    shown = ARM.replace("<worldbody>", '<asset><mesh name="m" file="gone.obj"/></asset><worldbody>')
    geom = '<geom type="mesh" mesh="m" {}/>'
    text, _ = written(
        shown.replace(LINK, LINK + geom.format('contype="0" conaffinity="0" mass="0"'), 1)
    )
    assert "drop: [visual]" in text
    capsys.readouterr()
    text, _ = written(shown.replace(LINK, LINK + geom.format(""), 1))
    assert "drop: [meshes]" in text
    said = capsys.readouterr().out
    assert "Without meshes, since " in said
    assert "gone.obj" in said


def test_only_free_bodies_are_no_robot(written):
    with pytest.raises(SystemExit) as stop:
        written(
            '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
        )
    assert "no hinge or slide that a motor could drive" in str(stop.value)


BALL = '<body name="{0}" pos="2 0 .1"><freejoint/><geom size=".1"/><site name="{0}"/></body>'


def test_what_moves_beside_legs_is_removed_unless_it_is_a_target(written):
    """With it go its own motor, its place in keyframes, and the sensor of it."""
    ball = BALL.format("ball") + '<body name="door"><joint name="door"/><geom size=".1"/></body>'
    model = walker(*FOUR).replace("</worldbody>", f"{ball}</worldbody>")
    model = model.replace("</actuator>", '<motor name="door" joint="door"/></actuator>')
    places = f"0 0 .6 1 0 0 0 {'0 ' * 12} 2 0 .1 1 0 0 0 0"
    model = model.replace(
        "</mujoco>",
        '<sensor><framepos name="ball" objtype="site" objname="ball"/></sensor>'
        f'<keyframe><key name="home" qpos="{places}"/></keyframe></mujoco>',
    )
    text, task = written(model)
    assert "remove_bodies: [ball, door]" in text
    assert "only_contacts: [[ground, " in text
    assert (task.dynamics.model.nv, task.dynamics.model.nu) == (18, 12)
    text, task = written(model.replace('"ball"', '"target"'))
    assert "remove_bodies: [door]" in text
    assert "only_contacts" not in text
    assert task.dynamics.model.nv == 24


def test_a_model_of_which_nothing_could_be_driven_is_refused_at_once(written):
    """As dm_control's swimmer.xml, to which a program adds all but the head."""
    base = "".join(
        f'<joint name="{axis}" type="slide" axis="{way}"/>'
        for axis, way in (("x", "1 0 0"), ("y", "0 1 0"))
    )
    head = f"<mujoco><worldbody><body>{base}<geom size='.1'/></body></worldbody></mujoco>"
    with pytest.raises(SystemExit, match="nothing but its base moves, and no actuator drives that"):
        written(head)
