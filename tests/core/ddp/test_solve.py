# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import solve_discrete_are

from vgps_ros.core.ddp.backward_pass import backward_pass
from vgps_ros.core.ddp.forward_pass import Problem
from vgps_ros.core.ddp.solve import Status, centre_of_q, solve
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import Trajectory

PLAIN = DdpSettings(initial_regularization=0.0, regularization_floor=0.0)


@pytest.fixture
def swim(short_swimmer, rng):
    """Returns a function that optimises the swimmer from smooth random controls."""
    task = short_swimmer
    controls = task.begin.controls(task, task.horizon, rng)
    initial = task.dynamics.rollout(task.initial_state, lambda t, _: controls[t], task.horizon)

    def run(settings=task.optimizer.ddp, max_iterations=8, **options):
        return solve(task.dynamics, task.cost, initial, settings, max_iterations, **options)

    return run


def test_linear_quadratic_problem_converges_in_one_iteration(lq_problem, rng):
    problem = lq_problem()
    start = rng.standard_normal(problem.state_dim)
    initial = problem.rollout(start, lambda t, x: rng.standard_normal(2), problem.horizon)
    solution = solve(problem, problem, initial, PLAIN, 20)
    assert solution.status is Status.CONVERGED
    assert solution.status == "converged"
    assert [i.step_size for i in solution.iterations] == [1.0]
    assert solution.simulator_steps == (7 + 3 + 7) * problem.horizon
    gradient_step = backward_pass(problem.linear, problem.expand(solution.trajectory))
    assert_allclose(gradient_step.feedforward, 0.0, atol=1e-9)


def test_expected_reduction_of_a_linear_quadratic_iteration_is_the_real_one(lq_problem, rng):
    problem = lq_problem()
    initial = problem.rollout(rng.standard_normal(4), lambda t, x: np.ones(2), problem.horizon)
    (iteration,) = solve(problem, problem, initial, PLAIN, 20).iterations
    assert_allclose(iteration.expected_reduction, iteration.cost_reduction, rtol=1e-9)


def test_first_gain_of_a_long_horizon_tends_to_the_riccati_equation(lq_problem):
    problem = lq_problem(horizon=300, stationary=True)
    solution = solve(problem, problem, problem.at_rest(), PLAIN, 20)
    a, b, n = problem.linear.f_x[0], problem.linear.f_u[0], problem.state_dim
    q, r, s = (problem.hessians[0][i] for i in (np.s_[:n, :n], np.s_[n:, n:], np.s_[:n, n:]))
    p = solve_discrete_are(a, b, q, r, s=s)
    gain = -np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a + s.T)
    assert_allclose(solution.policy.gains[0], gain, rtol=0, atol=1e-8)


def test_costs_of_the_swimmer_fall_in_every_iteration(swim, short_swimmer):
    seen = []
    solution = swim(on_iteration=seen.append)
    first, *rest = solution.iterations
    costs = [first.cost + first.cost_reduction, first.cost, *(i.cost for i in rest)]
    assert np.all(np.diff(costs) < 0)
    assert solution.status is Status.ITERATION_LIMIT
    assert [i.index for i in solution.iterations] == list(range(1, 9))
    assert tuple(seen) == solution.iterations
    assert solution.cost == costs[-1] == short_swimmer.trajectory_cost(solution.trajectory)


def test_a_solve_ends_with_the_iteration_that_brings_too_small_a_share_of_all(swim):
    whole = np.array([i.cost_reduction for i in swim().iterations])
    shares = whole / np.cumsum(whole)
    tolerance = 1.01 * shares.min()
    solution = swim(tolerance=tolerance)
    reductions = [i.cost_reduction for i in solution.iterations]
    assert solution.status is Status.CONVERGED
    assert reductions == whole[: len(reductions)].tolist()
    assert shares[: len(reductions) - 1].min() >= tolerance
    assert len(swim(tolerance=0.999).iterations) == 2  # the first brings all that there is so far


def test_solution_is_around_its_own_trajectory(swim, short_swimmer):
    task = short_swimmer
    solution = swim(max_iterations=2)
    states, controls = solution.trajectory.states, solution.trajectory.controls
    replay = task.dynamics.rollout(states[0], lambda t, _: controls[t], task.horizon)
    linear, _ = task.dynamics.linearize(solution.trajectory)
    expected = backward_pass(linear, task.cost.expand(solution.trajectory))
    assert_array_equal(replay.states, states)
    assert_array_equal(solution.linear_dynamics.f_x, linear.f_x)
    assert_array_equal(solution.policy.gains, expected.gains)
    assert_array_equal(solution.policy.q_uu, expected.q_uu)


def test_gains_of_the_distribution_use_their_own_regularisation(swim, short_swimmer):
    settings = dataclasses.replace(short_swimmer.optimizer.ddp, distribution_regularization=0.5)
    solution = swim(settings, 1)
    expansion = short_swimmer.cost.expand(solution.trajectory)
    expected = backward_pass(solution.linear_dynamics, expansion, 0.5)
    assert_array_equal(solution.policy.gains, expected.gains)


def test_known_derivatives_change_nothing(swim, short_swimmer, rng):
    task = short_swimmer
    controls = task.begin.controls(task, task.horizon, np.random.default_rng(20131205))
    initial = task.dynamics.rollout(task.initial_state, lambda t, _: controls[t], task.horizon)
    linear, steps = task.dynamics.linearize(initial)
    given, plain = swim(max_iterations=2, linear_dynamics=linear), swim(max_iterations=2)
    assert_array_equal(given.trajectory.states, plain.trajectory.states)
    assert plain.simulator_steps - given.simulator_steps == steps
    # The others are those of two more expansions, and of each step that was tried.
    sizes = np.array([i.step_size for i in plain.iterations])
    tried = 1 + np.log(sizes) / np.log(0.5)
    rollout = task.horizon * task.dynamics.substeps
    assert plain.simulator_steps == 3 * steps + round(tried.sum()) * rollout


def test_where_quu_is_indefinite_there_is_no_q(lq_problem):
    problem = lq_problem()
    concave = dataclasses.replace(problem, hessians=-problem.hessians)
    whole = Problem(concave, concave)
    with pytest.raises(
        DivergenceError, match=r"not positive definite at dis.*=0.1; raise"
    ) as caught:
        centre_of_q(whole, whole.around(concave.at_rest()), 0.1)
    assert caught.value.status == "indefinite_quu"


def test_regularisation_never_falls_below_its_floor(swim, short_swimmer):
    settings = dataclasses.replace(short_swimmer.optimizer.ddp, regularization_floor=0.003)
    logged = [i.regularization for i in swim(settings).iterations]
    assert logged[0] == 0.01
    assert min(logged) == 0.003


def test_cancelled_solve_keeps_what_it_has(swim, short_swimmer):
    done = []
    solution = swim(on_iteration=done.append, is_cancelled=lambda: len(done) >= 2)
    assert solution.status is Status.CANCELLED
    assert len(solution.iterations) == 2
    assert solution.cost == done[-1].cost
    assert solution.policy.complete


class Uphill:
    """A cost whose reported gradient points the wrong way."""

    def __init__(self, problem):
        self.values = problem.values
        self._expand = problem.expand

    def expand(self, trajectory):
        e = self._expand(trajectory)
        return dataclasses.replace(e, c_x=-e.c_x, c_u=-e.c_u)


def test_step_that_no_size_accepts_ends_without_descent(lq_problem):
    problem = lq_problem()
    solution = solve(problem, Uphill(problem), problem.at_rest(), DdpSettings(), 5)
    assert solution.status is Status.NO_DESCENT
    assert solution.iterations == ()
    assert_array_equal(solution.trajectory.controls, 0.0)


def test_line_search_shortens_a_step_that_is_too_long(lq_problem):
    problem = lq_problem()

    class Flattened:
        """A cost whose curvature is understated tenfold, so that full steps overshoot."""

        values = staticmethod(problem.values)

        def expand(self, trajectory):
            e = problem.expand(trajectory)
            scaled = {name: 0.1 * getattr(e, name) for name in ("c_xx", "c_uu", "c_ux")}
            return dataclasses.replace(e, **scaled)

    solution = solve(problem, Flattened(), problem.at_rest(), PLAIN, 1)
    (iteration,) = solution.iterations
    assert iteration.step_size < 1.0
    assert np.log2(iteration.step_size) == round(np.log2(iteration.step_size))
    assert iteration.cost_reduction > 0.1 * iteration.expected_reduction > 0


def test_diverging_initial_trajectory_is_an_error_with_advice(short_swimmer):
    task = short_swimmer
    states = np.full((task.horizon + 1, 10), np.nan)
    initial = Trajectory(states, np.zeros((task.horizon, 2)))
    with pytest.raises(DivergenceError, match=r"initial trajectory diverges; start from smaller"):
        solve(task.dynamics, task.cost, initial, task.optimizer.ddp, 5)


def test_concave_cost_is_an_error_with_advice(lq_problem):
    problem = lq_problem()
    concave = dataclasses.replace(problem, hessians=-problem.hessians)
    with pytest.raises(DivergenceError, match=r"Quu is not positive definite .*raise it"):
        solve(concave, concave, concave.at_rest(), DdpSettings(), 5)


def test_quu_that_stays_indefinite_ends_by_its_name(lq_problem):
    problem = lq_problem()
    # No regularisation that a solve tries is as large as this curvature, but that of q is.
    concave = dataclasses.replace(problem, hessians=-1e14 * problem.hessians)
    settings = DdpSettings(distribution_regularization=1e30)
    solution = solve(concave, concave, concave.at_rest(), settings, 5)
    assert solution.status is Status.INDEFINITE_QUU
    assert_array_equal(solution.trajectory.controls, 0.0)
    with pytest.raises(DivergenceError, match=r"no inverse that is a covariance.*raise") as caught:
        solution.policy.control_covariances()
    assert caught.value.status == "indefinite_quu"


@pytest.mark.parametrize("floor", [0.0, 1e10])
def test_a_search_that_finds_nothing_ends_whatever_the_floor(lq_problem, floor):
    problem = lq_problem()
    settings = DdpSettings(regularization_floor=floor)
    solution = solve(problem, Uphill(problem), problem.at_rest(), settings, 2**32 - 1)
    assert solution.status is Status.NO_DESCENT


def test_cost_that_is_not_finite_is_named(lq_problem):
    problem = lq_problem()
    gradients = problem.gradients.copy()
    gradients[3, 0] = np.inf
    infinite = dataclasses.replace(problem, gradients=gradients)
    message = r"The cost has a \w+ that is not finite, at step 3: start from smaller"
    with np.errstate(invalid="ignore"), pytest.raises(DivergenceError, match=message) as caught:
        solve(infinite, infinite, problem.at_rest(), DdpSettings(), 5)
    assert caught.value.status == "infinite_cost"
