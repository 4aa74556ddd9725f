# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Task files with commands and a clock, and the sentence, with its line, for each fault of them."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.told_rotor import write_task
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks import make_task
from vgps_ros.tasks.environment import TaskEnvironment
from vgps_ros.wizard.task_check import examine_task

COMMANDED = sorted((Path(__file__).parents[2] / "config" / "commanded").glob("*.yaml"))


@pytest.mark.parametrize("path", COMMANDED, ids=[path.stem for path in COMMANDED])
def test_robots_of_one_speed_have_a_task_file_of_commanded_ones(path):
    task, usual = make_task(str(path)), make_task(path.stem)
    (forward,) = task.signals.commands
    assert (forward.source, forward.rest) == ("cmd_vel/linear/x", 0.0)
    assert task.dims["n_x"] == usual.dims["n_x"]
    names = (*usual.observation.names, *task.signals.names)
    assert task.observation.names == names


def test_a_policy_reads_the_state_then_the_commands_then_the_clock(tmp_path):
    task = make_task(write_task(tmp_path))
    assert task.signals.names == ("command/speed", "clock/sin", "clock/cos")
    assert task.observation.names == ("rotor/position", "rotor/velocity", *task.signals.names)
    assert task.dims["n_z"] == 3
    assert_array_equal(task.planned_context, task.signals.constant_context([0.5], 20))
    (speed,) = task.signals.commands
    assert (speed.lowest, speed.highest, speed.source, speed.unit) == (
        *(-1.0, 2.0),
        *("cmd_vel/angular/z", "rad/s"),
    )


def test_targets_follow_and_a_motor_counts_from_no_torque_whatever_the_pose(tmp_path):
    task = make_task(write_task(tmp_path)).commanded(np.array([2.0]))
    states, controls = np.tile([0.1, 1.0], (20, 1)), np.full((20, 1), 0.7)
    swing = np.maximum(0.3 * np.sin(2 * np.pi * (0.05 * np.arange(20) + 0.25)), 0.0)
    expected = (1.0 - 2.5) ** 2 + 0.1 * (0.1 - swing) ** 2 + 0.1 * 0.7**2
    assert_allclose(task.cost(states, controls), expected)
    still = task.commanded(np.zeros(1)).cost(states, controls)
    assert_allclose(still - 0.25, expected - (1.0 - 2.5) ** 2)


def test_controls_may_count_from_the_start_and_the_check_of_a_task_counts_so_too():
    task = make_task("quadruped")
    assert_allclose(task.cost.control_targets, task.initial_state[7:19])
    found = examine_task(task, 1, 0, lambda *_: None)
    parts = {name: first for name, first, _ in found.parts}
    assert parts["controls"] == 0.0  # the first motion holds the start
    assert_allclose(sum(optimized for *_, optimized in found.parts), found.costs[-1])


def test_an_environment_tells_commands_and_clock_of_the_step(tmp_path):
    environment = TaskEnvironment(write_task(tmp_path), torque_scale=1.0)
    first, _ = environment.reset(options={"exact": True})
    assert_allclose(first[2:], [0.5, 0.0, 1.0])
    second, *_ = environment.step(np.zeros(1))
    assert_allclose(second[3:], [np.sin(0.1 * np.pi), np.cos(0.1 * np.pi)])
    for _ in range(19):
        last, *_ = environment.step(np.zeros(1))
    assert np.isfinite(last).all()


def test_a_sampled_first_motion_obeys_the_commands(tmp_path):
    sampling = "begin: {law: sampling, std: 1.0}\nsearch:"
    task = make_task(write_task(tmp_path, ("search:", sampling)))
    for speed in (-1.0, 2.0):
        here, rng = task.commanded(np.array([speed])), np.random.default_rng(0)
        motion = here.begin(here, here.initial_state, here.planned_horizon, rng).trajectory
        still = here.dynamics.rollout(here.initial_state, lambda *_: np.zeros(1), 20)
        assert here.trajectory_cost(motion) < 0.5 * here.trajectory_cost(still)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("command: speed", "command: sped", r"line 9, cost\[0\]\.target\.command: .*'speed'"),
        ("clock: {frequency: 1.0}\n", "", r"line 9, cost\[1\]\.target: the task has no clock"),
        ("command: speed", "command: speed, swing: 1.0", r"line 9, cost\[0\]\.target: exactly one"),
        ("command: speed, ", "", r"line 9, cost\[0\]\.target: exactly one of command, swing"),
        ("command: speed", "command: speed, phase: 0.5", r"line 9, .*phase: only a swing has a"),
        ("[-1.0, 2.0]", "[2.0, 2.0]", r"line 6, commands\.speed\.range: it is 2 to 2, but"),
        ("[-1.0, 2.0]", "[2.0, -1.0]", r"line 6, commands\.speed\.range: it is 2 to -1, but"),
        ("[-1.0, 2.0]", "[]", r"line 6, commands\.speed\.range: it is a list of 0, but"),
        ("[-1.0, 2.0]", "[-1.0, .nan]", r"line 6, commands\.speed\.range\[1\]: it is nan, but"),
        ("{command: speed, rest: 0.5}", "0.5", r"line 6, commands\.speed: no cost reads it, so"),
        ("speed: {r", "a/b: {r", r"line 6, commands\.a/b: its name must hold no slash"),
        (
            "clock: {",
            "  other: {range: [0, 1], from: cmd_vel/angular/z}\nclock: {",
            r"line 7, commands\.other\.from: speed comes from cmd_vel/angular/z already",
        ),
        ("angular/z", "angular/w", r"line 6, commands\.speed: .* must be cmd_vel/linear/x"),
        ("frequency: 1.0", "frequency: 0", r"line 7, clock\.frequency: it is 0, but"),
        ("frequency: 1.0", "frequency: .nan", r"line 7, clock\.frequency: it is nan, but"),
        ("frequency: 1.0", "frequency: 11", r"line 7, .* 0\.05 s it must be at most 10 Hz"),
        (
            "[commands, j",
            "[commands, commands, j",
            r"line 12, observe\[1\]: commands is read twice",
        ),
        ("pose: turned", "pose: turnd", r"line 11, cost\[2\]\.pose: .*'turned'"),
        ("phase: 0.25}", "phase: 0.25}, pose: turned", r"line 10, cost\[1\]\.pose: only a term of"),
        (
            "[commands, joint_positions, joint_velocities, clock]",
            "[commands, clock]",
            "line 12, observe: the policy reads nothing",
        ),
    ],
)
def test_a_fault_is_named_with_its_line_and_entry(tmp_path, old, new, message):
    with pytest.raises(InvalidInputError, match=message):
        make_task(write_task(tmp_path, (old, new)))


@pytest.mark.parametrize("entry", ["commands", "clock"])
def test_what_a_task_lacks_cannot_be_read(tmp_path, entry):
    text = [
        ("commands:\n  speed: {range: [-1.0, 2.0], from: cmd_vel/angular/z, unit: rad/s}\n", ""),
        ("clock: {frequency: 1.0}\n", ""),
        ("{command: speed, rest: 0.5}", "0.5"),
        ("{swing: 0.3, phase: 0.25}", "0.3"),
        ("[commands, joint_positions, joint_velocities, clock]", f"[joint_positions, {entry}]"),
    ]
    with pytest.raises(InvalidInputError, match=rf"line 9, observe\[1\]: the task has no {entry};"):
        make_task(write_task(tmp_path, *text))


def test_a_clock_that_stops_needs_commands_and_a_free_base_that_let_it_turn(tmp_path):
    assert make_task("quadruped").signals.stops
    stops = ("frequency: 1.0", "frequency: 1.0, stops: true")
    with pytest.raises(InvalidInputError, match=r"line 7, clock\.stops: only a robot on a free"):
        make_task(write_task(tmp_path, stops))
    alone = [
        stops,
        ("commands:\n  speed: {range: [-1.0, 2.0], from: cmd_vel/angular/z, unit: rad/s}\n", ""),
        ("{command: speed, rest: 0.5}", "0.5"),
        ("[commands, j", "[j"),
    ]
    with pytest.raises(InvalidInputError, match=r"line 5, clock\.stops: the clock would never"):
        make_task(write_task(tmp_path, *alone))
