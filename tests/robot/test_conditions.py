# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot has fallen where a reading is outside its range."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.simulation.robots import everything, random_states
from vgps_ros.robot.deployment import Conditions
from vgps_ros.simulation.dynamics import Simulations
from vgps_ros.simulation.readings import Readings

SIMULATIONS = Simulations(everything())


@pytest.fixture
def states(rng):
    """In all orientations, in rows of five."""
    return random_states(SIMULATIONS.model, rng, 20).reshape(4, 5, -1)


def test_one_reading_outside_its_range_is_enough(states):
    """The height of the base, and how upright its tail is."""
    readings = Readings(SIMULATIONS, ["base/z", "up/z"])
    fallen = Conditions(readings, np.array([0.27, 0.9]), np.array([0.34, np.inf]))
    height, upright = np.moveaxis(readings(states), -1, 0)
    expected = (height < 0.27) | (height > 0.34) | (upright < 0.9)
    assert_array_equal(fallen(states), expected)
    assert_array_equal(fallen(states[1, 2]), expected[1, 2])
    one_alone = np.stack([height < 0.27, height > 0.34, upright < 0.9]).sum(axis=0) == 1
    assert one_alone.any()
    assert not expected.all()


def test_on_its_bounds_a_robot_stands_and_a_state_that_diverged_has_not_fallen(states):
    height = Readings(SIMULATIONS, ["base/z"])
    states[0, :4, 2] = 0.3, 0.4, np.nan, 0.41
    fallen = Conditions(height, np.array([0.3]), np.array([0.4]))
    assert_array_equal(fallen(states[0, :4]), [False, False, False, True])


def test_without_conditions_nothing_falls(states):
    never = Conditions(Readings(SIMULATIONS, []), np.empty(0), np.empty(0))
    assert_array_equal(never(states), np.zeros((4, 5), dtype=bool))
