# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The first task of a robot with legs: how it stands, what it is told, and what servos it gets."""

import re

import mujoco
import numpy as np
import pytest
import yaml

from tests.wizard.models import ARM, BALL, FOUR, GROUND, HEAD, LATE, PLANE, SERVO, TWO, walker


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
