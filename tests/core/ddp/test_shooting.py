# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Solves that begin with a trajectory which does not satisfy the dynamics."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.ddp.forward_pass import Problem, _while_closing, forward_pass
from vgps_ros.core.ddp.solve import Status, solve
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import Trajectory

PLAIN = DdpSettings(initial_regularization=0.0, regularization_floor=0.0)


@pytest.fixture
def guess(rng):
    """Returns a function that draws states and controls, which no robot can follow."""

    def draw(problem):
        states = rng.standard_normal((problem.horizon + 1, problem.state_dim))
        return Trajectory(states, rng.standard_normal((problem.horizon, 2)))

    return draw


@pytest.fixture
def first_steps(lq_problem, guess):
    """Returns a function that tries steps from a guess, and the gaps before them."""

    def run(cost=lambda problem: problem):
        problem = lq_problem()
        initial = guess(problem)
        gaps = problem.gaps(initial)
        whole = Problem(problem, cost(problem))
        around = whole.around(initial, gaps=gaps)
        policy = whole.local_policy(around, 0.0)
        tried = forward_pass(whole, around, policy)
        return problem, around, tried

    return run


def test_a_whole_step_solves_the_dense_problem_whatever_the_gaps(lq_problem, guess):
    problem = lq_problem(horizon=15)
    initial = guess(problem)
    solution = solve(problem, problem, initial, PLAIN, 20, gaps=problem.gaps(initial))
    states, controls = problem.optimum(initial.states[0])
    assert solution.iterations[0].step_size == 1.0
    assert_allclose(solution.trajectory.controls, controls, rtol=0, atol=1e-9)
    assert_allclose(solution.trajectory.states[:-1], states, rtol=0, atol=1e-9)
    assert_allclose(problem.gaps(solution.trajectory), 0.0, atol=1e-9)


def test_the_model_knows_what_closing_the_gaps_costs(first_steps):
    _, around, (step,) = first_steps()
    assert step.gaps is None
    assert_allclose(step.expected_reduction, around.cost - step.cost, rtol=1e-9)


@pytest.mark.parametrize("slope", [-3.0, -0.4, 0.001, 2.0])
def test_the_worth_of_the_gaps_is_the_least_that_leaves_half_of_it(lq_problem, guess, slope):
    """Where the cost rises by r while they close, 2 r; where it falls, nothing."""
    problem = lq_problem()
    initial = guess(problem)
    gaps = problem.gaps(initial)
    whole = Problem(problem, problem)
    around = whole.around(initial, gaps=gaps)
    policy = whole.local_policy(around, 0.0)
    model, _ = _while_closing(gaps, around, policy)
    # The same gaps and policy, with gradients of the cost that make its slope another one.
    scale = slope / model.slope
    e = around.expansion
    tilted = dataclasses.replace(e, c_x=scale * e.c_x, c_u=scale * e.c_u)
    found, worth = _while_closing(gaps, dataclasses.replace(around, expansion=tilted), policy)
    rise = -found.expected_reduction(1.0)
    assert_allclose(rise, slope + 0.5 * model.curvature, rtol=1e-9)
    assert worth == pytest.approx(max(0.0, 2.0 * rise))
    half = found.expected_reduction(1.0) + worth
    assert half == pytest.approx(worth / 2) if rise > 0.0 else worth == 0.0


class Steeper:
    """A cost whose curvature is understated, so that whole steps overshoot."""

    def __init__(self, problem):
        self.problem, self.values = problem, problem.values

    def expand(self, trajectory):
        e = self.problem.expand(trajectory)
        scaled = {name: 0.02 * getattr(e, name) for name in ("c_xx", "c_uu", "c_ux")}
        return dataclasses.replace(e, **scaled)


def test_a_shorter_step_closes_its_share_of_the_gaps(first_steps):
    problem, around, tried = first_steps(Steeper)
    assert len(tried) > 2
    for step in tried:
        left = (1.0 - step.step_size) * around.gaps if step.gaps is not None else 0.0
        assert_allclose(problem.gaps(step.trajectory), left, atol=1e-9)


@pytest.mark.parametrize("is_closed", [False, True])
def test_what_a_shorter_step_leaves_of_gaps_is_closed_by_feedback_where_that_is_cheap(
    lq_problem, guess, rng, is_closed
):
    problem = lq_problem()
    initial = guess(problem)  # whose gaps are large
    if is_closed:
        controls = initial.controls
        nearby = problem.rollout(initial.states[0], lambda t, x: controls[t], problem.horizon)
        noise = 1e-3 * rng.standard_normal(nearby.states.shape)
        initial = Trajectory(nearby.states + noise, controls)
    gaps, whole = problem.gaps(initial), Problem(problem, Steeper(problem))
    around = whole.around(initial, gaps=gaps)
    policy = whole.local_policy(around, 0.0)
    *rejected, beside, taken = forward_pass(whole, around, policy)
    assert not any(step.is_accepted for step in rejected)
    # The closed one is the result, or beside it.
    closed, left = (taken, beside) if is_closed else (beside, taken)
    assert left.is_accepted
    assert closed.is_accepted == is_closed
    assert closed.step_size == left.step_size < 1.0
    assert closed.expected_reduction == left.expected_reduction
    assert_allclose(left.gaps, (1.0 - left.step_size) * gaps)
    (followed,) = problem.follow_each(initial.states[0], [left.trajectory], policy.gains)
    assert closed.gaps is None
    assert_array_equal(closed.trajectory.states, followed.states)
    assert closed.cost == problem.values(followed).sum()


def test_gaps_change_nothing_about_q_once_they_are_closed(lq_problem, guess):
    problem = dataclasses.replace(lq_problem(), limit=0.5)
    initial = guess(problem)
    executed = problem.rollout(initial.states[0], lambda t, _: np.zeros(2), problem.horizon)
    solve_closely = partial(solve, problem, problem, cost_tolerance=1e-14)
    settings = DdpSettings()
    with_gaps = solve_closely(initial, settings, 100, gaps=problem.gaps(initial))
    without = solve_closely(executed, settings, 100)
    assert not with_gaps.policy.free.all()
    assert_array_equal(with_gaps.policy.free, without.policy.free)
    for name in ("gains", "q_uu"):
        expected = getattr(without.policy, name)
        assert_allclose(getattr(with_gaps.policy, name), expected, rtol=1e-8, atol=1e-8)
    assert_allclose(with_gaps.trajectory.controls, without.trajectory.controls, atol=1e-6)


def test_gaps_that_stay_open_are_an_error_with_advice(lq_problem, guess):
    problem = lq_problem()
    initial = guess(problem)
    stuck = DdpSettings(initial_regularization=1e9)

    class Shaking:
        """A cost that grows wherever the trajectory goes."""

        expand = staticmethod(problem.expand)

        def values(self, trajectory):
            return np.full(problem.horizon, 1e9)

    with pytest.raises(DivergenceError, match=r"No robot can follow .* gaps .*begin") as caught:
        solve(problem, Shaking(), initial, stuck, 5, gaps=problem.gaps(initial))
    assert caught.value.status == "open_gaps"


def test_a_cancelled_solve_says_so_though_gaps_are_open(lq_problem, guess):
    problem = lq_problem()
    initial = guess(problem)
    options = {"gaps": problem.gaps(initial), "is_cancelled": lambda: True}
    assert solve(problem, problem, initial, PLAIN, 5, **options).status is Status.CANCELLED
