# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The importance-sampled objective against densities and sums written out anew."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import approx_fprime
from scipy.stats import norm

from vgps_ros.core.policy_network import Standardization
from vgps_ros.search.comparators import gps
from vgps_ros.search.comparators.gps import (
    ImportanceSamples,
    estimated_cost,
    guided_objective,
    log_weights,
    maximize,
    mixture_log_density,
)

COUNT, HORIZON = 6, 5


@pytest.fixture
def policies(random_policy):
    return [random_policy(hidden_units=(4,)) for _ in range(3)]


@pytest.fixture
def scaling(policies, coordinates, random_distribution):
    shape, observation = policies[0].architecture, coordinates(0, 2, 3)
    return Standardization.of(shape, observation, [random_distribution()])


@pytest.fixture
def samples(rng, policies):
    """Rollouts that the second policy drew, with arbitrary inputs and costs."""
    inputs = rng.standard_normal((COUNT, HORIZON, 3))
    policy = policies[1]
    noise = policy.noise_std * rng.standard_normal((COUNT, HORIZON, 2))
    controls = policy.mean(inputs) + noise
    log_q = np.cumsum(policy.log_density(inputs, controls), axis=1)
    return ImportanceSamples(inputs, controls, rng.uniform(0, 3, (COUNT, HORIZON)), log_q)


def density_of_prefix(policy, samples, i, t):
    """π(ζ_i,1:t), as a product over steps and controls."""
    factors = [
        norm.pdf(samples.controls[i, s], policy.mean(samples.inputs[i, s]), policy.noise_std)
        for s in range(t + 1)
    ]
    return np.prod(factors)


def test_weights_are_ratios_of_gaussian_densities(policies, samples):
    found = np.exp(log_weights(policies[0], samples))
    expected = [
        [
            density_of_prefix(policies[0], samples, i, t)
            / density_of_prefix(policies[1], samples, i, t)
            for t in range(HORIZON)
        ]
        for i in range(COUNT)
    ]
    assert_allclose(found, expected, rtol=1e-9)


def test_the_mixture_is_the_weighted_sum_of_its_parts(policies, samples):
    counts = [3, 1, 2]
    steps = [p.log_density(samples.inputs, samples.controls) for p in policies]
    found = np.exp(mixture_log_density(steps, counts))
    expected = [
        [
            sum(
                n / 6 * density_of_prefix(p, samples, i, t)
                for n, p in zip(counts, policies, strict=True)
            )
            for t in range(HORIZON)
        ]
        for i in range(COUNT)
    ]
    assert_allclose(found, expected, rtol=1e-9)


def test_a_part_without_rollouts_counts_for_nothing(policies, samples):
    steps = [p.log_density(samples.inputs, samples.controls) for p in policies]
    assert_allclose(mixture_log_density(steps[:2], [4, 0]), np.cumsum(steps[0], axis=1))


def test_the_estimate_is_exact_where_the_policy_drew_the_rollouts(policies, samples):
    drawn_by = policies[1]
    assert_allclose(estimated_cost(drawn_by, samples), samples.costs.mean(axis=0).sum())
    # Then every weight is 1, and Z_t is the number of rollouts.
    regularized = guided_objective(drawn_by, [samples], regularization=2.0)
    expected = 2.0 * HORIZON * np.log(COUNT) - samples.costs.mean(axis=0).sum()
    assert_allclose(regularized, expected)


def test_the_estimate_is_unbiased_as_rollouts_grow(rng, policies):
    """One step, with a cost whose mean under the target is known."""
    n, target = 200_000, policies[0]
    inputs = np.broadcast_to(rng.standard_normal(3), (n, 1, 3))
    mean = target.mean(inputs[0, 0])
    broad = 2.0 * target.noise_std
    controls = mean + broad * rng.standard_normal((n, 1, 2))
    log_q = norm.logpdf(controls, mean, broad).sum(axis=2)
    costs = np.sum(controls**2, axis=2)
    estimate = estimated_cost(target, ImportanceSamples(inputs, controls, costs, log_q))
    assert_allclose(estimate, np.sum(mean**2 + target.noise_std**2), rtol=0.02)


def test_the_loss_is_the_objective_in_standardised_units_with_its_gradient(
    policies, samples, scaling
):
    policy, w_r = policies[0], 0.3
    theta = scaling.to_standard(policy.parameters)
    log_sigma = np.log(policy.noise_std / scaling.output_scale)
    loss = gps._Loss(samples, w_r, scaling)
    value, gradient = loss.at(theta, log_sigma)
    assert_allclose(-HORIZON * value, guided_objective(policy, [samples], w_r), rtol=1e-9)
    point = np.concatenate([theta, log_sigma])
    slopes = approx_fprime(point, lambda p: loss.at(p[: len(theta)], p[len(theta) :])[0], 1e-6)
    assert_allclose(gradient, slopes, rtol=1e-4, atol=1e-5)


def test_the_search_moves_parameters_and_logarithms_of_the_noise_in_standardised_units(
    policies, samples, scaling, monkeypatch
):
    policy, step = policies[0], 1e-4
    theta = scaling.to_standard(policy.parameters)
    log_sigma = np.log(policy.noise_std / scaling.output_scale)
    _, slope = gps._Loss(samples, 0.3, scaling).at(theta, log_sigma)

    def descend(start, value_and_gradient, iterations):
        return start - step * value_and_gradient(start)[1]

    monkeypatch.setattr(gps, "minimize_lbfgs", descend)
    moved = maximize(policy, [samples, samples], 0.3, scaling, iterations=1)
    by_theta, by_log_sigma = np.split(-2 * step * slope, [len(theta)])
    assert_allclose(moved.parameters, scaling.to_raw(theta + by_theta), rtol=1e-12)
    assert_allclose(moved.noise_std, policy.noise_std * np.exp(by_log_sigma), rtol=1e-12)
    monkeypatch.setattr(gps, "minimize_lbfgs", lambda start, *_: start * np.nan)
    assert maximize(policy, [samples], 0.3, scaling, iterations=1) is policy


def test_the_search_raises_the_objective(policies, samples, scaling):
    policy = policies[0]
    better = maximize(policy, [samples, samples], 1e-2, scaling, iterations=30)
    values = [guided_objective(p, [samples, samples], 1e-2) for p in (policy, better)]
    assert values[1] > values[0]
    assert_allclose(values[0], 2 * guided_objective(policy, [samples], 1e-2))
