# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""One iteration of DDP: its motion, its gains, and what it costs."""

import numpy as np
import pytest

from vgps_ros.core.ddp.solve import Status, improve, solve
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import Trajectory

PLAIN = DdpSettings(initial_regularization=0.0, regularization_floor=0.0)


def test_a_linear_quadratic_problem_is_solved_with_its_optimal_gains(lq_problem, rng):
    problem = lq_problem()
    start = rng.standard_normal(problem.state_dim)
    motion = problem.rollout(start, lambda t, x: rng.standard_normal(2), problem.horizon)
    found, optimum = (
        improve(problem, problem, motion, PLAIN),
        solve(problem, problem, motion, PLAIN, 20),
    )
    np.testing.assert_allclose(found.trajectory.controls, optimum.trajectory.controls, rtol=1e-9)
    np.testing.assert_allclose(found.gains, optimum.policy.gains, rtol=1e-9)
    assert found.cost == pytest.approx(optimum.cost)
    again = improve(problem, problem, found.trajectory, PLAIN)
    assert again.status is Status.CONVERGED
    assert again.trajectory is found.trajectory


def test_it_makes_the_step_of_a_solve_with_half_the_derivatives(short_swimmer, rng, monkeypatch):
    task, expanded = short_swimmer, []
    controls = task.begin.controls(task, task.horizon, rng)
    linearize = type(task.dynamics).linearize

    def counted(self, trajectory):
        expanded.append(trajectory)
        return linearize(self, trajectory)

    monkeypatch.setattr(type(task.dynamics), "linearize", counted)
    motion = task.dynamics.rollout(task.initial_state, lambda t, _: controls[t], task.horizon)
    found = improve(task.dynamics, task.cost, motion, task.optimizer.ddp)
    assert expanded == [motion]
    expected = solve(task.dynamics, task.cost, motion, task.optimizer.ddp, 1)
    assert len(expanded) == 3
    np.testing.assert_array_equal(found.trajectory.controls, expected.trajectory.controls)
    assert (found.cost, found.status) == (expected.cost, Status.ITERATION_LIMIT)


def test_what_is_cancelled_returns_the_motion_with_gains_around_it(lq_problem, rng):
    problem = lq_problem()
    start = rng.standard_normal(problem.state_dim)
    motion = problem.rollout(start, lambda t, x: np.zeros(2), problem.horizon)
    found = improve(problem, problem, motion, PLAIN, is_cancelled=lambda: True)
    assert found.status is Status.CANCELLED
    assert found.trajectory is motion
    assert np.isfinite(found.gains).all()


def test_a_motion_that_diverges_is_refused(short_swimmer):
    task = short_swimmer
    states = np.full((task.horizon + 1, task.dims["n_x"]), np.nan)
    motion = Trajectory(states, np.zeros((task.horizon, task.dims["n_u"])))
    with pytest.raises(DivergenceError, match="is not finite, at step 0"):
        improve(task.dynamics, task.cost, motion, task.optimizer.ddp)
