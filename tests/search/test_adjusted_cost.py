# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Costs with other targets and weights, as the planner takes them."""

from dataclasses import replace

import numpy as np
import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.search.mpc import MpcSettings, Planner, adjustable
from vgps_ros.tasks import make_task


def test_the_readings_values_are_those_of_the_task_and_change_nothing():
    task = make_task("quadruped")
    changed = adjustable(task.cost)
    # Velocities and turning follow commands, and the feet the clock.
    assert changed.names[:2] == ("height/z", "up/x")
    assert changed.targets[:2].tolist() == [0.27, 0.0]
    same = changed(changed.targets, changed.weights)
    np.testing.assert_array_equal(same.targets, task.cost.targets)
    np.testing.assert_array_equal(same.weights, task.cost.weights)


def test_another_target_and_weight_change_the_cost_of_that_reading_alone(swimmer):
    changed = adjustable(swimmer.cost)
    states, controls = np.tile(swimmer.initial_state, (3, 1)), np.zeros((3, 2))
    assert changed.names == ("velocity/x",)
    found = changed([2.0], [3.0])(states, controls)
    np.testing.assert_allclose(found, 3.0 * 2.0**2)  # at rest


def test_what_changes_with_time_is_left_alone(swimmer):
    steps = 5
    targets = np.linspace(0.0, 1.0, steps)[:, None]
    moving = replace(swimmer.cost, targets=targets, weights=np.ones((steps, 1)))
    assert adjustable(moving).names == ()
    at_the_end = replace(swimmer.cost, weights=np.eye(steps)[:, -1:])
    assert adjustable(at_the_end).names == ()


@pytest.mark.parametrize(("targets", "weights"), [([1.0, 2.0], [1.0]), ([1.0], [])])
def test_too_few_or_too_many_values_are_refused(swimmer, targets, weights):
    with pytest.raises(InvalidInputError, match=r"the cost has 1 readings .*: velocity/x"):
        adjustable(swimmer.cost)(targets, weights)


def test_a_plan_follows_another_target(swimmer):
    planner = Planner(swimmer, MpcSettings(horizon=0.4, ddp=swimmer.optimizer.ddp))
    first = planner.first_plan()

    def speed():
        plan = first
        for _ in range(5):
            plan = planner.next_plan(plan, swimmer.initial_state, 0)
        return plan.trajectory.states[-1, 0] - plan.trajectory.states[0, 0]

    forwards = speed()
    planner.cost = adjustable(swimmer.cost)([-1.0], [1.0])
    assert speed() <= 0.0 < forwards  # its tail, at rest, is the cheaper motion
