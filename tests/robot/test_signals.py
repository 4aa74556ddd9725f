# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Commands and the clock."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.robot.signals import Command, CommandSettings, Signals

FORWARD, HEIGHT = Command("forward", -0.5, 1.0), Command("height", 0.2, 0.4, unit="m")
BOTH = Signals((FORWARD, HEIGHT), frequency=2.0, time_step=0.05)
REST = [0.0, 0.2]


def test_a_command_at_rest_is_the_value_nearest_to_zero():
    assert_array_equal(BOTH.rest, REST)
    assert Command("back", -2.0, -1.0).rest == -1.0
    assert_allclose(BOTH.nominal, [0.25, 0.3])


def test_the_clock_turns_at_its_frequency():
    expected = (0.3 + 0.1 * np.arange(26)) % 1.0
    apart = np.abs(BOTH.phases(26, 0.3) - expected)
    assert_allclose(np.minimum(apart, 1.0 - apart), 0.0, atol=1e-12)


def test_the_phase_at_a_time_goes_on_from_step_to_step():
    start = 1_790_000_000_000_000_000  # of this century [ns]
    steps = [BOTH.phase_at(start + 50_000_000 * t) for t in range(5)]
    apart = np.abs(steps - BOTH.phases(5, steps[0]))
    assert_allclose(np.minimum(apart, 1.0 - apart), 0.0, atol=1e-6)
    assert BOTH.phase_at(0) == 0.0
    assert BOTH.phase_at(125_000_000) == pytest.approx(0.25)


def test_a_phase_is_read_back_from_a_context():
    assert BOTH.phase_of(BOTH.constant_context([0.5, 0.2], 1, first=0.7)[0]) == pytest.approx(0.7)
    assert Signals(BOTH.commands).phase_of(np.array([0.5, 0.2])) == 0.0


def test_a_task_may_have_a_clock_alone():
    alone = Signals((), frequency=2.0, time_step=0.05)
    assert alone.names == ("clock/sin", "clock/cos")
    assert_allclose(
        alone.constant_context([], 3), [[0, 1], *([np.sin(a), np.cos(a)] for a in _angles(1, 2))]
    )


def _angles(*steps):
    return [0.2 * np.pi * step for step in steps]


def test_a_context_has_the_commands_and_then_the_clock():
    assert BOTH.names == ("command/forward", "command/height", "clock/sin", "clock/cos")
    found = BOTH.context(np.array([[0.5, 0.2], REST]), np.array([0.125, 0.25]))
    half = np.sqrt(0.5)
    assert_allclose(found, [[0.5, 0.2, half, half], [*REST, 1.0, 0.0]], atol=1e-12)


def test_a_clock_that_stops_is_zero_while_all_commands_are_at_rest():
    stops = replace(BOTH, stops=True)
    commands, phases = np.array([REST, [0.5, 0.2], [0.0, 0.3]]), np.array([0.1, 0.1, 0.1])
    found, turning = stops.context(commands, phases), BOTH.context(commands, phases)
    assert_array_equal(found[0], [*REST, 0.0, 0.0])
    assert_array_equal(found[1:], turning[1:])
    assert_array_equal(stops.context(commands[0], phases[0]), found[0])
    assert_array_equal(stops.constant_context(REST, 3), [found[0]] * 3)
    assert stops.phase_of(found[0]) == 0.0


def test_without_a_clock_a_context_has_the_commands_alone_and_without_both_nothing():
    commands = np.array([[0.5, 0.3]])
    assert_array_equal(Signals(BOTH.commands).context(commands, np.zeros(1)), commands)
    assert Signals().constant_context([], 4).shape == (4, 0)


def test_commands_that_are_held_let_the_clock_go_on():
    found = BOTH.constant_context([0.5, 0.3], 3, first=0.25)
    assert_array_equal(found[:, :2], [[0.5, 0.3]] * 3)
    assert_allclose(found[:, 2], np.cos(_angles(0, 1, 2)))


def test_draws_fill_the_ranges_and_a_share_of_them_is_at_rest(rng):
    settings = CommandSettings(still=0.25)
    draws = np.array([BOTH.draw(rng, settings) for _ in range(4000)])
    still = (draws == REST).all(axis=1)
    assert still.mean() == pytest.approx(0.25, abs=0.03)
    assert_allclose(draws[~still].min(axis=0), [-0.5, 0.2], atol=0.01)
    assert_allclose(draws[~still].max(axis=0), [1.0, 0.4], atol=0.01)
    assert ((draws >= [-0.5, 0.2]) & (draws <= [1.0, 0.4])).all()
    # One command alone is at rest in a share of .3, less where both would be, more where one stays.
    alone = (draws[~still] == REST).mean(axis=0)
    assert_allclose(alone, 0.3 - 0.3**2 / 2, atol=0.03)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ([0.5], "1 values are given, but the task has 2 commands: forward, height"),
        ([1.5, 0.3], "command forward is 1.5, but it must be from -0.5 to 1"),
        ([0.5, 0.1], "command height is 0.1, but it must be from 0.2 to 0.4 m"),
        ([np.nan, 0.3], "command forward is nan"),
    ],
)
def test_commands_from_outside_are_checked(values, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        BOTH.check(values)
    assert_array_equal(BOTH.check((0.5, 0.3)), [0.5, 0.3])
