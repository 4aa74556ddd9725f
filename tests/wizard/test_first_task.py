# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The first task file of each kind of robot: it is taken for what it is, and starts soundly."""

from pathlib import Path

import numpy as np
import pytest

from tests.wizard.models import (
    ACROBOT,
    ARM,
    BOLTED,
    CART,
    CUBE,
    CUP,
    DRONE,
    FISH,
    FOUR,
    FOUR_BARS,
    HAND,
    HELD,
    LINK,
    SERVO,
    SPINNER,
    TWO,
    WEAK,
    on_soles,
    walker,
)
from vgps_ros.tasks import make_task
from vgps_ros.wizard.task_check import derivative_errors, explain_inexact_derivatives


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


def test_what_makes_derivatives_worthless_is_changed_and_activations_are_read(written):
    slack = ARM.replace("<option>", '<option solver="PGS" tolerance="1e-4" iterations="3">')
    lagging = slack.replace("<motor name=", '<general dyntype="filter" dynprm=".1" name=', 1)
    text, task = written(lagging)
    assert "solver: Newton, iterations: 100, tolerance: 1.0e-10" in text
    assert "elbow/activation" in task.observation.names


def test_friction_cones_are_pyramids_and_round_ones_need_a_closed_form(written):
    """As many of menagerie's quadrupeds have them elliptic, with an impratio of 100."""
    steep = walker(*FOUR, motor="position", extra=SERVO)
    steep = steep.replace("<option", '<option cone="elliptic" impratio="100"')
    text, task = written(steep)
    first = task.begin(task, task.initial_state, 30, np.random.default_rng(0)).trajectory
    assert np.quantile(derivative_errors(task, first), 0.9) < 1e-3
    round_cones = text.replace("cone: pyramidal", "cone: elliptic")
    assert round_cones != text
    Path("mine/task.yaml").write_text(round_cones)
    task = make_task("mine")
    errors = derivative_errors(task, first)
    assert np.quantile(errors, 0.9) < 1e-3
    assert not explain_inexact_derivatives(task, errors)
    by_differences = round_cones.replace("implicitfast", "implicit")
    assert by_differences != round_cones
    Path("mine/task.yaml").write_text(by_differences)
    task = make_task("mine")
    errors = derivative_errors(task, first)
    assert np.quantile(errors, 0.9) > 1.0
    assert "cone: pyramidal" in explain_inexact_derivatives(task, errors)[0]


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


def test_a_model_of_which_nothing_could_be_driven_is_refused_at_once(written):
    """As dm_control's swimmer.xml, to which a program adds all but the head."""
    base = "".join(
        f'<joint name="{axis}" type="slide" axis="{way}"/>'
        for axis, way in (("x", "1 0 0"), ("y", "0 1 0"))
    )
    head = f"<mujoco><worldbody><body>{base}<geom size='.1'/></body></worldbody></mujoco>"
    with pytest.raises(SystemExit, match="nothing but its base moves, and no actuator drives that"):
        written(head)
