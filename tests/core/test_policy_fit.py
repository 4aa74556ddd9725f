# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core import policy_fit
from vgps_ros.core.augmentation import Augmentation, Mirror
from vgps_ros.core.marginals import sample_rollout_noise
from vgps_ros.core.observation import Observation
from vgps_ros.core.optimizer_settings import FitSettings
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.policy_fit import (
    Targets,
    draw_targets,
    fit_loss,
    fit_policy,
    initial_policy,
    objective,
    resample,
    with_best_noise,
)
from vgps_ros.core.policy_network import Standardization
from vgps_ros.core.records import Trajectory

NAMES = ("x0", "x1", "x2", "x3")


@pytest.fixture
def whole(coordinates):
    return coordinates(0, 1, 2, 3)


@pytest.fixture
def three(coordinates):
    """What `random_policy` reads."""
    return coordinates(0, 2, 3)


def start_of(architecture, observation, distributions, rng):
    return initial_policy(Standardization.of(architecture, observation, distributions), rng)


@pytest.fixture
def linear_target(random_distribution, rng):
    """q whose actions are N(K x + b, Σ) in every step, and its K, b, σ."""
    q = random_distribution(horizon=25)
    gain, bias = 3 * rng.standard_normal((2, 4)), 2 * rng.standard_normal(2)
    covariance = np.array([[8.0, 3.0], [3.0, 5.0]])
    states = 1.0 + q.mean.states * [1.0, 0.1, 5.0, 1.0]
    q = dataclasses.replace(
        q,
        mean=Trajectory(states, states[:-1] @ gain.T + bias),
        gains=np.tile(gain, (25, 1, 1)),
        control_covariances=np.tile(covariance, (25, 1, 1)),
    )
    return q, gain, bias, np.sqrt(np.diagonal(covariance))


def expected_objective(policy, q):
    """L(q, θ) ÷ T of a linear policy, with states and actions integrated out by hand."""
    ((weight, bias),) = policy.architecture.unpack(policy.parameters)
    errors = q.mean.states[:-1] @ weight.T + bias - q.mean.controls
    differences = weight - q.gains
    spread = differences @ q.state_covariances[:-1] @ np.swapaxes(differences, 1, 2)
    squares = errors**2 + np.diagonal(spread + q.control_covariances, axis1=1, axis2=2)
    density = -0.5 * squares / policy.noise_std**2 - np.log(np.sqrt(2 * np.pi) * policy.noise_std)
    return density.sum(axis=1).mean()


def test_objective_is_the_closed_form_in_expectation(
    random_policy, random_distribution, whole, rng
):
    policy, q = random_policy(observed=NAMES, hidden_units=()), random_distribution()
    draws = [objective(policy, draw_targets([q], whole, 200, rng)) for _ in range(200)]
    assert abs(np.mean(draws) - expected_objective(policy, q)) < 5 * np.std(draws) / np.sqrt(200)


def with_drawn_actions(q, targets, count, rng):
    """Returns the samples of Eq. 3."""
    noise = sample_rollout_noise(q, count, rng).reshape(targets.means.shape)
    return Targets(targets.inputs, targets.means + noise, np.zeros_like(noise))


def test_objective_is_the_mean_one_of_drawn_actions(random_policy, random_distribution, three, rng):
    """With a network, for which no closed form exists; drawn actions have more noise."""
    policy, q = random_policy(hidden_units=(5, 4), activation="tanh"), random_distribution()
    draws = [draw_targets([q], three, 200, rng) for _ in range(200)]
    integrated = [objective(policy, each) for each in draws]
    sampled = [objective(policy, with_drawn_actions(q, each, 200, rng)) for each in draws]
    error = np.hypot(np.std(integrated), np.std(sampled)) / np.sqrt(200)
    assert abs(np.mean(integrated) - np.mean(sampled)) < 5 * error
    assert np.std(integrated) < np.std(sampled)


def test_objective_of_drawn_actions_is_the_mean_log_density(
    random_policy, random_distribution, three, rng
):
    policy, q = random_policy(), random_distribution()
    targets = with_drawn_actions(q, draw_targets([q], three, 3, rng), 3, rng)
    log_density = policy.log_density(targets.inputs, targets.means)
    assert_allclose(objective(policy, targets), log_density.mean(), rtol=1e-12)


def test_targets_pool_every_step_of_every_distribution(random_distribution, three, rng):
    qs = [random_distribution(horizon=3), random_distribution(horizon=5)]
    targets = draw_targets(qs, three, 4, rng)
    assert targets.inputs.shape == (32, 3)
    assert targets.means.shape == targets.variances.shape == (32, 2)
    variances = np.diagonal(qs[1].control_covariances, axis1=1, axis2=2)
    assert_array_equal(targets.variances[-5:], variances)


def test_a_late_sample_reads_a_state_and_has_the_control_of_the_one_after(
    random_distribution, whole, rng
):
    """Along exact linear dynamics the control is that of the state to which q leads."""
    q = random_distribution(horizon=6)
    now, late = (
        draw_targets([q], whole, 2, np.random.default_rng(1), share) for share in (0.0, 1.0)
    )
    assert_array_equal(now.inputs, late.inputs)  # nothing is told here
    f = q.linear_dynamics
    for sample in (slice(0, 6), slice(6, 12)):
        deviations = now.inputs[sample] - q.mean.states[:-1]
        for t in range(5):
            control = q.gains[t] @ deviations[t]
            after = f.f_x[t] @ deviations[t] + f.f_u[t] @ control
            expected = q.mean.controls[t + 1] + q.gains[t + 1] @ after
            assert_allclose(late.means[sample][t], expected)
        assert_array_equal(late.means[sample][5], now.means[sample][5])  # there is no later one
    some = draw_targets([q], whole, 200, rng, 0.3)
    exact = q.mean.controls + np.einsum(
        "tux,stx->stu", q.gains, some.inputs.reshape(200, 6, 4) - q.mean.states[:-1]
    )
    is_late = (np.abs(some.means.reshape(200, 6, 2) - exact) > 1e-9).any(axis=2)
    assert is_late[:, :5].mean() == pytest.approx(0.3, abs=0.06)


def test_a_late_sample_is_told_what_is_so_now(random_distribution, whole):
    context = np.arange(6.0)[:, None]
    q = dataclasses.replace(random_distribution(horizon=6), context=context)
    told = Observation.of(whole.readings, ["clock"], ["clock"])
    late = draw_targets([q], told, 2, np.random.default_rng(1), 1.0)
    assert_array_equal(late.inputs[:6, -1], [1.0, 2.0, 3.0, 4.0, 5.0, 5.0])


def test_best_noise_maximises_the_objective(random_policy, random_distribution, three, rng):
    policy = random_policy()
    targets = draw_targets([random_distribution()], three, 10, rng)
    best = with_best_noise(policy, targets).noise_std

    def at(noise):
        return objective(dataclasses.replace(policy, noise_std=noise), targets)

    for factor in ([0.99, 1], [1.01, 1], [1, 0.99], [1, 1.01], [0.5, 2]):
        assert at(best * factor) < at(best)


@pytest.mark.parametrize(
    ("optimizer", "iterations", "tolerance"), [("gauss_newton", 40, 1e-5), ("lbfgs", 40, 1e-5)]
)
def test_fit_recovers_a_linear_gaussian(
    linear_target, whole, rng, optimizer, iterations, tolerance
):
    q, gain, bias, std = linear_target
    settings = FitSettings(optimizer, 40, iterations)
    start = start_of(Architecture(NAMES, (), 2), whole, [q], rng)
    policy = fit_policy(start, whole, [q], settings, rng)
    states = q.mean.states
    errors = policy.mean(states) - (states @ gain.T + bias)
    assert np.sqrt((errors**2).mean(axis=0)).max() < tolerance * std.min()
    assert_allclose(policy.noise_std, std, rtol=max(tolerance, 1e-5))


@pytest.mark.parametrize("optimizer", ["gauss_newton", "lbfgs"])
@pytest.mark.parametrize("bias", [True, False])
def test_fit_of_a_network_increases_the_objective(
    random_distribution, coordinates, rng, optimizer, bias
):
    qs = [random_distribution(horizon=20), random_distribution(horizon=20)]
    two = coordinates(1, 2)
    architecture = Architecture(two.names, (5,), 2, hidden_bias=bias, output_bias=bias)
    start = start_of(architecture, two, qs, rng)
    targets = draw_targets(qs, two, 200, rng)
    improved = with_best_noise(start, targets)
    settings = FitSettings(optimizer=optimizer, iterations=60)
    policy = fit_policy(start, two, qs, settings, rng)
    assert objective(policy, targets) > objective(improved, targets) > objective(start, targets)


@pytest.mark.parametrize("hidden_units", [(), (5,), (5, 3)])
@pytest.mark.parametrize("hidden_bias", [True, False])
@pytest.mark.parametrize("output_bias", [True, False])
def test_standardised_units_change_neither_weights_nor_loss(
    linear_target, random_policy, three, rng, hidden_units, hidden_bias, output_bias
):
    q = linear_target[0]
    policy = random_policy(
        hidden_units=hidden_units, hidden_bias=hidden_bias, output_bias=output_bias
    )
    scaling = Standardization.of(policy.architecture, three, [q])
    standard = scaling.to_standard(policy.parameters)
    assert_allclose(scaling.to_raw(standard), policy.parameters, rtol=1e-12, atol=1e-12)

    targets = draw_targets([q], three, 5, rng)
    loss = fit_loss(scaling, targets).at(standard).value
    expected = np.log(with_best_noise(policy, targets).noise_std / scaling.output_scale).sum()
    assert_allclose(loss, expected, rtol=1e-10)


def test_a_feedback_that_asks_for_more_than_the_limits_is_taught_as_they_are(
    random_distribution, whole, rng
):
    """In contact a gain may ask for 40 times the limit; the fit's noise would be as large."""
    q = random_distribution(horizon=10)
    steep = dataclasses.replace(q, gains=1e3 * q.gains)
    limits = np.full(2, -1.0), np.full(2, 1.0)
    start = start_of(Architecture(NAMES, (5,), 2), whole, [q], rng)

    def noise(**taught):
        policy = fit_policy(start, whole, [steep], FitSettings(iterations=20), rng, **taught)
        return policy.noise_std

    widest = np.diagonal(q.control_covariances, axis1=1, axis2=2).max(axis=0)
    assert (noise(limits=limits) < np.sqrt(4.0 + widest)).all()
    assert (noise() > 10.0 * np.sqrt(4.0 + widest)).all()


def test_same_generator_gives_the_same_bits(random_distribution, whole):
    q, architecture = random_distribution(horizon=10), Architecture(NAMES, (5,), 2)

    def fit(seed):
        rng = np.random.default_rng(seed)
        start = start_of(architecture, whole, [q], rng)
        return fit_policy(start, whole, [q], FitSettings(iterations=50), rng)

    assert_array_equal(fit(1).parameters, fit(1).parameters)
    assert_array_equal(fit(1).noise_std, fit(1).noise_std)
    assert np.all(fit(1).parameters != fit(2).parameters)


@pytest.mark.parametrize(("optimizer", "draws"), [("lbfgs", 3)], ids=str)
def test_samples_are_drawn_anew_as_often_as_set(
    random_distribution, whole, rng, monkeypatch, optimizer, draws
):
    """LBFGS every 25 iterations, and once more for the noise."""
    q, drawn = random_distribution(), []

    def counted(*args) -> Targets:
        drawn.append(draw_targets(*args))
        return drawn[-1]

    monkeypatch.setattr(policy_fit, "draw_targets", counted)
    start = start_of(Architecture(NAMES, (5,), 2), whole, [q], rng)
    settings = FitSettings(optimizer=optimizer, iterations=75)
    fit_policy(start, whole, [q], settings, rng)
    assert len(drawn) == draws + 1
    assert len({t.inputs.tobytes() for t in drawn}) == draws + 1


def test_a_fit_that_has_converged_draws_no_more_samples(linear_target, whole, rng, monkeypatch):
    q, drawn = linear_target[0], []

    def counted(*args) -> Targets:
        drawn.append(draw_targets(*args))
        return drawn[-1]

    monkeypatch.setattr(policy_fit, "draw_targets", counted)
    start = start_of(Architecture(NAMES, (), 2), whole, [q], rng)
    fit_policy(start, whole, [q], FitSettings(iterations=10_000), rng)
    assert len(drawn) < 20


def test_draws_come_as_often_as_they_are_probable(rng):
    inputs = np.arange(4.0)[:, None]
    targets = Targets(inputs, 10 * inputs, 100 * inputs)
    draws = resample(targets, np.array([0.5, 0.2, 0.0, 0.3]), 10_000, rng)
    first, second = next(draws), next(draws)
    counts = np.bincount(first.inputs[:, 0].astype(int), minlength=4)
    assert_allclose(counts / 10_000, [0.5, 0.2, 0.0, 0.3], atol=5 * 0.5 / 100)
    assert_array_equal(first.means, 10 * first.inputs)
    assert_array_equal(first.variances, 100 * first.inputs)
    assert first.inputs.tobytes() != second.inputs.tobytes()


@pytest.mark.parametrize("share", [1.0, 0.25, 0.0])
def test_a_share_of_the_replayed_samples_counts(linear_target, whole, rng, share):
    """The noise tells their weight: they alone have a spread of 1000."""
    q, _, _, std = linear_target
    count = 5 * len(q.gains)
    replay = draw_targets([q], whole, 20, rng)
    wide = dataclasses.replace(replay, variances=replay.variances + 1000.0)
    start = start_of(Architecture(NAMES, (), 2), whole, [q], rng)
    settings = FitSettings(samples_per_step=5, replayed=share)
    policy = fit_policy(start, whole, [q], settings, rng, replay=[wide])
    replayed = share * len(replay.inputs)
    expected = std**2 + 1000.0 * replayed / (replayed + count)
    assert_allclose(policy.noise_std**2, expected, rtol=1e-3)


def test_a_sample_is_mirrored_as_often_as_not(rng):
    mirror = Mirror(np.array([1, 0, 2]), np.array([1.0, 1.0, -1.0]), np.array([1, 0]), -np.ones(2))
    samples = tuple(rng.standard_normal((10_000, n)) for n in (3, 2, 2))
    inputs, means, variances = Augmentation(np.zeros(3), mirror)(samples, rng)
    swapped = mirror(samples)
    is_swapped = (inputs == swapped[0]).all(axis=1)
    assert 0.45 < is_swapped.mean() < 0.55
    for found, there, here in zip((inputs, means, variances), swapped, samples, strict=True):
        assert_array_equal(found, np.where(is_swapped[:, None], there, here))
    for twice, once in zip(mirror(swapped), samples, strict=True):
        assert_array_equal(twice, once)
    assert_array_equal(swapped[0][0], samples[0][0][[1, 0, 2]] * [1, 1, -1])


@pytest.mark.parametrize(("residual", "precision"), [(0.01, 1.0), (1.0, 1.0), (3.0, 10.0)])
def test_at_a_constant_alpha_the_noise_tends_to_what_the_page_on_the_method_says(
    residual, precision
):
    policy = GaussianPolicy(Architecture(("x0",), (), 1), np.zeros(2), np.array([7.0]))
    for _ in range(3000):
        q_variance = 1.0 / (policy.noise_std[0] ** -2 + precision)  # as each q-step adds α H
        one = np.ones((1, 1))
        targets = Targets(one, residual * one, q_variance * one)
        policy = with_best_noise(policy, targets)
    told = 0.5 * (residual**2 + np.sqrt(residual**4 + 4.0 * residual**2 / precision))
    assert_allclose(policy.noise_std[0] ** 2, told, rtol=1e-9)
    page = (Path(__file__).parents[2] / "docs" / "explanation" / "method.md").read_text()
    assert "tends to σ² = ½[r² + √(r⁴ + 4r²/(αH))]" in page
