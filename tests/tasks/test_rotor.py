# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The rotor is a linear-quadratic problem."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.tasks import make_task


@pytest.fixture(scope="module")
def task():
    return make_task("rotor")


def test_dynamics_are_linear(task, rng):
    """Semi-implicit Euler: ω' = ω + h (u − d ω) / (I + h d), φ' = φ + h ω'."""
    h, damping = task.dynamics.time_step, 0.2
    inertia = task.dynamics.model.body("rotor").inertia
    mass = task.dynamics.model.body("rotor").mass[0]
    about_axis = inertia.max() + mass * 0.25**2
    for _ in range(5):
        (angle, rate), u = rng.standard_normal(2), rng.standard_normal()
        new_rate = rate + h * (u - damping * rate) / (about_axis + h * damping)
        found = task.dynamics.step(np.array([angle, rate]), np.array([u]))
        assert_allclose(found, [angle + h * new_rate, new_rate], rtol=1e-9)


def test_ddp_finds_its_optimum_in_one_iteration(task):
    start = task.dynamics.rollout(
        task.initial_state, lambda t, x: np.zeros((1, 1)), task.planned_horizon
    )
    settings = DdpSettings(initial_regularization=0.0)
    solution = solve(task.dynamics, task.cost, start, settings, 5)
    assert_allclose(solution.iterations[0].cost, solution.cost, rtol=1e-6)


def test_cost_is_written_out(task):
    state, control = np.array([[0.5, -2.0]]), np.array([[3.0]])
    assert_allclose(task.cost(state, control), [3.0**2 + 0.5**2 + 0.1 * 2.0**2])
    assert_array_equal(task.cost.rest(2), [0.0, 0.0])
