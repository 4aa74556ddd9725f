# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Records to messages and files and back: every array, bit for bit."""

import json
import re

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from vgps_msgs.msg import RobotModel

from tests.motors import robot
from vgps_ros.core.checks import arrays_of
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.conversions import (
    check_robot,
    command_from_msg,
    command_to_msg,
    distribution_from_msg,
    distribution_to_msg,
    policy_from_msg,
    policy_to_msg,
    robot_of,
)
from vgps_ros.simulation.controls import controls_of
from vgps_ros.storage.run_folder import load_policy, save_policy


def same_bits(one, other):
    ours, theirs = arrays_of(one), arrays_of(other)
    return ours.keys() == theirs.keys() and all(
        ours[name].tobytes() == theirs[name].tobytes() and ours[name].shape == theirs[name].shape
        for name in ours
    )


def test_a_distribution_crosses_bit_for_bit(random_distribution, swimmer):
    q = random_distribution()
    message = distribution_to_msg(q, swimmer.deployment, 3, 7, Time(sec=5))
    assert len(arrays_of(q)) == 8
    assert same_bits(distribution_from_msg(message), q)
    place = (message.task, message.trajectory_index, message.iteration, message.header.stamp.sec)
    assert place == ("swimmer", 3, 7, 5)
    assert message.control_jacobians.tobytes() == q.linear_dynamics.f_u.tobytes()


@pytest.mark.parametrize(
    ("name", "values", "sentence"),
    [
        ("state_jacobians", [1.0], "state_jacobians has 1 values, but shape (6, 4, 4) needs 96"),
        ("gains", np.full(48, np.nan), "gains is nan at index 0"),
    ],
)
def test_a_distribution_that_does_not_fit_is_refused(
    random_distribution, swimmer, name, values, sentence
):
    message = distribution_to_msg(random_distribution(), swimmer.deployment, 0, 0, Time())
    setattr(message, name, list(values))
    with pytest.raises(InvalidInputError, match=re.escape(sentence)):
        distribution_from_msg(message)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": 2}, "It has the format 2, but this version reads formats up to 1; use"),
        ({"controls": ["hip"]}, "its controls[0] is 'hip', but here it is 'front_joint'; start"),
        ({"controls": ["front_joint"]}, "its controls[1] is 'none', but here it is 'back_joint'"),
        ({"states": ["a\nb"]}, r"its states[0] is 'a\nb', but here it is 'root_x/position'"),
        ({"digest": "0" * 64}, "is for another model: its digest is '000000000000', but here"),
    ],
)
def test_numbers_of_another_robot_are_refused_and_those_of_an_unknown_one_are_not(
    swimmer, change, sentence
):
    own = robot_of(swimmer.deployment)
    check_robot("It", own, own)
    check_robot("It", RobotModel(), own)
    for name, value in change.items():
        check_robot("It", RobotModel(format=1), own)
        with pytest.raises(InvalidInputError, match=re.escape(sentence)):
            check_robot("It", RobotModel(**{name: value}), own)


def test_a_policy_crosses_and_is_kept_with_every_field(random_policy, tmp_path):
    policy = random_policy(hidden_units=(5, 3), activation="tanh", output_bias=False)
    save_policy(policy, "swimmer", tmp_path / "policy.json")
    kept, task = load_policy(tmp_path / "policy.json")
    assert task == "swimmer"
    for read in (policy_from_msg(policy_to_msg(policy, "swimmer", 1, Time())), kept):
        assert read.architecture == policy.architecture
        assert same_bits(read, policy)


@pytest.mark.parametrize("observed", [[1, 2, 3], ["x0", "x0", "x3"], "x0x", None])
def test_a_policy_file_that_names_no_readings_is_refused(random_policy, tmp_path, observed):
    """Older ones have indices."""
    path = tmp_path / "policy.json"
    save_policy(random_policy(), "swimmer", path)
    content = json.loads(path.read_text())
    assert content["observed"] == ["x0", "x2", "x3"]
    path.write_text(json.dumps(content | {"observed": observed}))
    with pytest.raises(InvalidInputError, match="is not a policy of vgps_ros"):
        load_policy(path)


def test_a_policy_that_does_not_fit_is_refused(random_policy):
    message = policy_to_msg(random_policy(), "swimmer", 1, Time())
    message.noise_std = [1.0]
    with pytest.raises(InvalidInputError, match=r"noise_std has 1 values"):
        policy_from_msg(message)


def test_a_command_holds_each_kind_in_its_field_and_takes_a_feed_forward():
    controls = controls_of(
        robot(
            '<motor joint="{}" gear="50"/>',
            '<position joint="{}" kp="60" kv="4" gear="2"/>',
            '<velocity joint="{}" kv="5"/>',
        )
    )
    control = np.array([0.1, 0.8, 3.0])
    message = command_to_msg(control, controls, Time())
    np.testing.assert_array_equal(message.effort, [5.0, np.nan, np.nan])
    np.testing.assert_array_equal(message.position, [np.nan, 0.4, np.nan])
    np.testing.assert_array_equal(message.velocity, [np.nan, np.nan, 3.0])
    np.testing.assert_allclose(command_from_msg(message, controls), control, rtol=1e-15)
    # k_p = 60 · 2² and k_d = 4 · 2² at the joint, and one unit of control is 60 · 2 N·m.
    message.effort[1], message.velocity[1] = 12.0, 0.5
    expected = control.copy()
    expected[1] += (12.0 + 4 * 4 * 0.5) / 120.0
    np.testing.assert_allclose(command_from_msg(message, controls), expected, rtol=1e-15)
    message.position[1] = np.nan
    with pytest.raises(InvalidInputError, match=r"joint_command.position is nan at index 1"):
        command_from_msg(message, controls)
    message.position = []
    with pytest.raises(InvalidInputError, match=r"joint_command.position has 0 values"):
        command_from_msg(message, controls)
