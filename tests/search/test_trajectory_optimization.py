# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""One solve is a pure function of its request, which is checked."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.ddp.solve import Status
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.marginals import Spread, sample_deviations, state_covariances
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.trajectory_optimization import optimize


def test_first_solve_lowers_the_cost_of_its_guess(short_swimmer, first_request):
    task, controls = short_swimmer, first_request.guess
    guess = task.dynamics.rollout(
        first_request.initial_state, lambda t, _: controls[t], task.horizon
    )
    result = optimize(short_swimmer, first_request)
    assert result.cost < task.trajectory_cost(guess)
    assert result.cost == result.modified_cost == result.iterations[-1].cost
    assert result.status is Status.ITERATION_LIMIT
    assert len(result.iterations) == 3


def test_a_solve_without_a_guess_starts_from_the_tasks_own_first_motion(short_swimmer):
    request = first_request(short_swimmer, 3, 2)
    drawn = generator(3, Stream.INITIAL_CONTROLS, 0)
    guess = short_swimmer.begin.controls(short_swimmer, short_swimmer.planned_horizon, drawn)
    given = optimize(short_swimmer, dataclasses.replace(request, guess=guess))
    own = optimize(short_swimmer, request)
    assert_array_equal(own.distribution.mean.states, given.distribution.mean.states)
    assert own.simulator_steps == given.simulator_steps


def test_a_solve_for_the_cost_alone_may_end_early(short_swimmer, first_request, next_request):
    early = dataclasses.replace(short_swimmer.optimizer, first_tolerance=0.05)
    task = dataclasses.replace(short_swimmer, optimizer=early)
    whole, short = (
        optimize(each, dataclasses.replace(first_request, max_iterations=30))
        for each in (short_swimmer, task)
    )
    assert short.status is Status.CONVERGED
    assert len(short.iterations) < len(whole.iterations)
    *others, last = short.iterations
    assert last.cost_reduction < 0.05 * last.cost
    assert all(each.cost_reduction >= 0.05 * each.cost for each in others)
    # What a policy has a part in goes on as before.
    adapted = [optimize(each, next_request).distribution for each in (short_swimmer, task)]
    assert_array_equal(adapted[0].mean.states, adapted[1].mean.states)


def test_distribution_is_centred_on_an_executed_trajectory(short_swimmer, next_request):
    q = optimize(short_swimmer, next_request).distribution
    states, controls = q.mean.states, q.mean.controls
    assert_array_equal(states[0], next_request.initial_state)
    for t, u in enumerate(controls):
        assert_array_equal(short_swimmer.dynamics.step(states[t], u), states[t + 1])


def test_distribution_carries_its_marginals(short_swimmer, first_request):
    q = optimize(short_swimmer, first_request).distribution
    spread = Spread(np.full(10, 0.01), np.zeros(10), short_swimmer.std_limit)
    expected = state_covariances(q.linear_dynamics, q.gains, q.control_covariances, spread)
    assert_array_equal(q.state_covariances, expected)
    assert_allclose(q.state_covariances[0], 1e-4 * np.eye(10))
    last = 2 * first_request.cost_scale * 1e-5 * np.eye(2)  # Quu of the last step is c_uu
    assert_allclose(q.control_covariances[-1], np.linalg.inv(last))


def test_limit_of_the_marginals_shrinks_with_alpha(short_swimmer, first_request):
    annealed = dataclasses.replace(short_swimmer.optimizer.marginals, std_limit_annealing=0.5)
    optimizer = dataclasses.replace(short_swimmer.optimizer, marginals=annealed)
    task = dataclasses.replace(short_swimmer, optimizer=optimizer)
    q = optimize(task, dataclasses.replace(first_request, cost_scale=0.25)).distribution
    limit = 0.25**0.5 * task.std_limit
    stds = np.sqrt(np.diagonal(q.state_covariances, axis1=1, axis2=2))
    assert np.all(stds <= limit * (1 + 1e-12))
    assert_allclose(stds.max(axis=0)[8:], limit[8:])  # the joints' velocities reach it


def test_modified_cost_is_alpha_c_less_the_averaged_log_density(short_swimmer, next_request):
    result = optimize(short_swimmer, next_request)
    rng = generator(next_request.seed, Stream.POLICY_DERIVATIVES, 1, 0)
    deviations = sample_deviations(next_request.previous, 10, rng)
    cost = PolicyCost(
        ScaledCost(short_swimmer.cost, 0.9),
        next_request.policy,
        short_swimmer.observation,
        deviations,
        next_request.previous.gains,
    )
    trajectory = result.distribution.mean
    assert_allclose(result.modified_cost, cost.values(trajectory).sum(), rtol=1e-13)
    assert result.cost == short_swimmer.trajectory_cost(trajectory)
    assert result.modified_cost < cost.values(next_request.previous.mean).sum()


def test_policy_narrows_the_distribution_by_its_precision(short_swimmer, next_request):
    """Quu of the last step is α c_uu + Σ_θ⁻¹."""
    q = optimize(short_swimmer, next_request).distribution
    expected = np.diag(0.9 * 2e-5 + 1 / next_request.policy.noise_std**2)
    assert_allclose(np.linalg.inv(q.control_covariances[-1]), expected, rtol=1e-10)


def test_scale_of_the_cost_does_not_change_what_is_found(short_swimmer, first_request):
    """Regularisation scales along; a power of two keeps every bit."""
    scaled = dataclasses.replace(first_request, cost_scale=0.25)
    one, quarter = optimize(short_swimmer, first_request), optimize(short_swimmer, scaled)
    assert_array_equal(one.distribution.mean.controls, quarter.distribution.mean.controls)
    assert_array_equal(
        4 * one.distribution.control_covariances[:, 0, 0],
        quarter.distribution.control_covariances[:, 0, 0],
    )
    assert quarter.cost == one.cost
    assert quarter.modified_cost == 0.25 * one.cost


def test_optimisation_is_a_pure_function_of_its_request(short_swimmer, first_request, next_request):
    first = optimize(short_swimmer, next_request).distribution
    optimize(short_swimmer, first_request)
    again = optimize(short_swimmer, next_request).distribution
    other = optimize(
        short_swimmer, dataclasses.replace(next_request, trajectory_index=1)
    ).distribution
    assert_array_equal(first.mean.states, again.mean.states)
    assert_array_equal(first.state_covariances, again.state_covariances)
    assert np.any(first.mean.states != other.mean.states)


def test_solve_can_be_watched_and_cancelled(short_swimmer, first_request):
    seen = []
    result = optimize(short_swimmer, first_request, seen.append, lambda: len(seen) == 1)
    assert result.status is Status.CANCELLED
    assert result.iterations == tuple(seen)


def changed(array, value):
    array = array.copy()
    array.flat[3] = value
    return array


def starting(request, state):
    return {"situation": dataclasses.replace(request.situation, initial_state=state)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: {"cost_scale": 0.0}, r"cost_scale is 0\.0, but it must be .* above 0\."),
        (lambda r: {"cost_scale": -1.0}, r"cost_scale is -1\.0"),
        (lambda r: {"cost_scale": np.nan}, r"cost_scale is nan"),
        (lambda r: {"max_iterations": 0}, r"max_iterations is 0"),
        (lambda r: starting(r, np.zeros(9)), r"initial_state has shape \(9,\)"),
        (lambda r: starting(r, changed(r.initial_state, np.nan)), r"initial_state is nan"),
        (lambda r: starting(r, np.zeros((10, 1))), r"initial_state .*shape"),
        (lambda r: {"guess": r.guess[:-1]}, r"guess\.controls has shape \(39, 2\)"),
        (lambda r: {"guess": changed(r.guess, np.inf)}, r"guess\.controls is inf at index 3"),
        (lambda r: {"guess": r.guess.T}, r"guess\.controls .*shape"),
    ],
)
def test_bad_first_request_is_refused(short_swimmer, first_request, change, message):
    bad = dataclasses.replace(first_request, **change(first_request))
    with pytest.raises(InvalidInputError, match=message):
        optimize(short_swimmer, bad)


@pytest.mark.parametrize("name", ["gains", "state_covariances"])
def test_bad_previous_distribution_is_refused(short_swimmer, next_request, name):
    q = next_request.previous
    for value, message in [
        (changed(getattr(q, name), np.nan), rf"previous\.{name} is nan at index 3"),
        (getattr(q, name)[1:], rf"previous\.{name} has shape"),
    ]:
        previous = dataclasses.replace(q, **{name: value})
        with pytest.raises(InvalidInputError, match=message):
            optimize(short_swimmer, dataclasses.replace(next_request, previous=previous))


def test_policy_without_previous_distribution_is_refused(short_swimmer, first_request, policy):
    with pytest.raises(InvalidInputError, match=r"policy but no previous distribution.*send both"):
        optimize(short_swimmer, dataclasses.replace(first_request, policy=policy))


def test_policy_that_does_not_fit_the_task_is_refused(short_swimmer, next_request, policy):
    observed = (*policy.architecture.observed[:-1], "tail/velocity")
    architecture = dataclasses.replace(policy.architecture, observed=observed)
    other = dataclasses.replace(policy, architecture=architecture)
    with pytest.raises(InvalidInputError, match=r"reads .*tail/velocity.* read root_y/pos"):
        optimize(short_swimmer, dataclasses.replace(next_request, policy=other))


def test_guess_that_diverges_is_an_error_with_advice(short_swimmer, first_request):
    wild = dataclasses.replace(first_request, guess=1e8 * first_request.guess)
    with pytest.raises(DivergenceError, match=r"start from smaller controls"):
        optimize(short_swimmer, wild)
