# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What networks of others read, by their contract, and which contracts are refused."""

from collections import deque

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.contract import VELOCITY_COMMANDS, Contract

JOINTS = ("hip", "knee")
SAID = {
    "joint_names": "hip,knee",
    "default_joint_pos": "0.1,-0.2",
    "observation_names": "base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,actions,"
    "command,gait_phase,up",
    "observation_terms_scale": "2.000,0.250,1.000,1.000,0.050,1.000,2.000;2.000;0.250,1.000,1.000",
    "observation_terms_clip": ",".join(["-inf;inf"] * 4 + ["-1.500;1.500"] + ["-inf;inf"] * 4),
    "observation_terms_flatten_history_dim": ",".join(["1.000"] * 9),
}


def assembled(frames, lags, by_time):
    """What a network reads of the terms of each step, the newest last."""
    if by_time:
        return np.concatenate([term for lag in lags for term in frames[-1 - lag]])
    return np.concatenate([frames[-1 - lag][i] for i in range(9) for lag in lags])


@pytest.mark.parametrize(
    ("said", "lags", "by_time"),
    [
        ({}, (0,), False),
        ({"observation_terms_history_length": "3.000"}, (2, 1, 0), False),
        ({"observation_terms_lags": "0;1;3", "observation_order": "time"}, (0, 1, 3), True),
    ],
)
def test_each_number_stands_in_its_place(said, lags, by_time, rng):
    contract = Contract({**SAID, **said}, "The file")
    numbers = dict(zip(contract.observed, range(100), strict=False))
    memory, frames = None, deque(maxlen=4)
    for step in range(6):
        inputs = rng.standard_normal((1, len(numbers)))
        value = {name: inputs[0, i] for name, i in numbers.items()}

        def group(pattern, of, own=value):
            return np.array([own[pattern.format(each)] for each in of])

        rotation = Rotation.from_quat(group("the free base/q{}", "xyzw"))
        action = np.zeros(2) if memory is None else memory.action[0]
        terms = [
            2.0 * rotation.inv().apply(group("the free base/v{}", "xyz")),
            0.25 * group("the free base/w{}", "xyz"),
            rotation.inv().apply([0.0, 0.0, -1.0]),
            group("{}/position", JOINTS) - [0.1, -0.2],
            0.05 * np.clip(group("{}/velocity", JOINTS), -1.5, 1.5),
            action,
            [2.0, 2.0, 0.25] * group("cmd_vel/{}", ("linear/x", "linear/y", "angular/z")),
            group("clock/{}", ("sin", "cos")),
            group("{}", ["up"]),
        ]
        if not step:
            frames.extend([terms] * 4)
        frames.append(terms)
        memory = contract.remembered(inputs, memory)
        found = contract.read(memory)[0]
        np.testing.assert_allclose(found, assembled(frames, lags, by_time), atol=1e-12)
        memory = memory._replace(action=rng.standard_normal((1, 2)))
    assert contract.observed[-5:] == (
        *("cmd_vel/linear/x", "cmd_vel/linear/y", "cmd_vel/angular/z", "clock/sin", "clock/cos"),
    )


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ({"observation_terms_scale": "1,2"}, "'observation_terms_scale' .* 2 values, .* be 9"),
        ({"observation_terms_scale": "1;2"}, "'base_lin_vel' .* 2 scales, but 3 numbers"),
        ({"observation_terms_scale": "much"}, "must be numbers, separated by commas"),
        ({"observation_terms_scale": "nan"}, "'base_lin_vel' is nan at index 0"),
        ({"observation_terms_clip": "1;-1"}, "A clip of The file must be a lowest and a highest"),
        ({"observation_terms_history_length": "1e9"}, "'base_lin_vel' of The file has a history"),
        ({"observation_terms_history_length": "nan"}, "'base_lin_vel' of The file has a history"),
        ({"observation_terms_history_length": "-2"}, "'base_lin_vel' of The file has a history"),
        ({"observation_terms_lags": "0.5"}, "'base_lin_vel' of The file has a history"),
        (
            {
                "observation_terms_history_length": "2",
                "observation_terms_flatten_history_dim": "0.000",
            },
            "'base_lin_vel' of The file is not flattened",
        ),
        (
            {
                "observation_terms_history_length": ",".join("123456789"),
                "observation_order": "time",
            },
            "different histories",
        ),
        (
            {
                "observation_terms_lags": "999",
                "joint_names": ",".join(f"j{i}" for i in range(100)),
                "default_joint_pos": "0",
            },
            "remembers 1000 steps of 315 numbers",
        ),
        ({"observation_order": "tme"}, "Did you mean 'time'"),
        (
            {
                "observation_names": ",".join(["joint_pos"] * 90_000),
                "observation_terms_scale": "1",
                "observation_terms_clip": "-1;1",
                "observation_terms_flatten_history_dim": "1",
            },
            "reads more than 100000 numbers",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_the_terms_name(said, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        Contract({**SAID, **said}, "The file")


OWN_CLOCK = {
    "joint_names": "hip,knee",
    "observation_names": "phase_cos,phase_sin,command,phase",
    "control_period": "0.02",
    "phase_initial": "0,0.5",
    "phase_rest": "0.5",
    "phase_frequency": "1.25,1.75,1.5",
}


def test_a_policys_own_clock_follows_commands_and_rests(rng):
    """As MuJoCo Playground drives its Apollo: two feet, which rest at half a turn."""
    contract = Contract(OWN_CLOCK, "The file")
    assert (contract.remembers, contract.observed) == (True, VELOCITY_COMMANDS)
    memory, angles, told = None, np.array([0.0, np.pi]), rng.uniform(-1, 1, (60, 1, 3))
    told[20:30], told[30:40] = 0.0, 3.0
    for step, command in enumerate(told):
        again = contract.remembered(command, memory)  # a state that comes twice
        memory = contract.remembered(command, memory)
        np.testing.assert_array_equal(memory.action, again.action)
        length = np.linalg.norm(command)
        shown = angles if length >= 0.01 else np.full(2, np.pi)
        turns = angles / (2 * np.pi) if length >= 0.01 else [0.5, 0.5]
        wanted = [*np.cos(shown), *np.sin(shown), *command[0], *np.minimum(turns, 1.0)]
        np.testing.assert_allclose(contract.read(memory)[0], wanted, atol=1e-12)
        angles = angles + 2 * np.pi * 0.02 * (1.25 + 0.5 * min(length, 1.5) / 1.5)
        assert step < 55 or angles.min() > 2 * np.pi


def test_a_phase_runs_once_over_a_motion(rng):
    """As of rl_sar's charleston; it reads no command, and begins anew with the policy."""
    said = {"joint_names": "hip", "observation_names": "phase", "control_period": "0.02"}
    contract, memory, found = Contract({**said, "phase_frequency": "0.5"}, "The file"), None, []
    assert contract.observed == ()
    for _ in range(150):
        memory = contract.remembered(np.empty((1, 0)), memory)
        found += contract.read(memory).ravel().tolist()
    np.testing.assert_allclose(found, np.minimum(0.01 * np.arange(150), 1.0), atol=1e-12)
    assert contract.read(contract.remembered(np.empty((1, 0)), None)) == 0.0


@pytest.mark.parametrize(
    "said",
    [{"phase_frequency": "1,2"}, {"phase_frequency": "-1"}, {"control_period": "0"},
     {"phase_rest": "0,0.5"}],
)  # fmt: skip
def test_a_clock_of_another_kind_is_refused(said):
    with pytest.raises(InvalidInputError, match="no other way in which a clock follows commands"):
        Contract({**OWN_CLOCK, **said}, "The file")
