# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives averaged over samples of q, against the expectations of a Gaussian."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

from vgps_ros.core.ddp.mean_derivatives import mean_derivatives
from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.marginals import sample_joint_deviations
from vgps_ros.core.records import LinearDynamics


@dataclass
class Polynomial:
    """Two states and a control: x' = x + a x³ + b x y² + e x u, y' = y + u + g u² + |x|."""

    space = StateSpace(2)
    a: float = 0.0
    b: float = 0.0
    e: float = 0.0
    g: float = 0.0
    kink: float = 0.0
    limit: float = np.inf

    @property
    def control_limits(self):
        return np.array([-self.limit]), np.array([self.limit])

    def after(self, z):
        x, y, u = np.moveaxis(z, -1, 0)
        first = x + self.a * x**3 + self.b * x * y**2 + self.e * x * u
        return np.stack([first, y + u + self.g * u**2 + self.kink * np.abs(x)], axis=-1)

    def linearize(self, trajectory):
        x, y = trajectory.states[:-1].T
        u = trajectory.controls[:, 0]
        assert np.all(np.abs(u) <= self.limit)
        f_x = np.tile(np.eye(2), (len(u), 1, 1))
        f_x[:, 0, 0] += 3 * self.a * x**2 + self.b * y**2 + self.e * u
        f_x[:, 0, 1] += 2 * self.b * x * y
        f_x[:, 1, 0] += self.kink * np.sign(x)
        f_u = np.stack([self.e * x, 1 + 2 * self.g * u], axis=1)[:, :, None]
        return LinearDynamics(f_x, f_u), 5 * len(u)


@pytest.fixture
def q(random_distribution):
    return random_distribution(n_x=2, n_u=1)


def joint_covariances(q):
    sigma, gains = q.state_covariances[:-1], q.gains
    both = np.concatenate([np.tile(np.eye(2), (len(gains), 1, 1)), gains], axis=1)
    covariances = both @ sigma @ np.swapaxes(both, 1, 2)
    covariances[:, 2:, 2:] += q.control_covariances
    return covariances


def stacked(linear):
    return np.concatenate([linear.f_x, linear.f_u], axis=2)


@pytest.mark.parametrize("count", [2, 10])
def test_two_samples_are_exact_where_the_dynamics_are_quadratic(q, rng, count):
    dynamics = Polynomial(e=0.7, g=0.3)
    found, steps = mean_derivatives(dynamics, q, count, 1.0, rng)
    assert_allclose(stacked(found), stacked(dynamics.linearize(q.mean)[0]), atol=1e-12)
    assert steps == count * 5 * q.mean.horizon


@pytest.mark.parametrize("width", [0.5, 1.0])
def test_the_mean_tends_to_the_gaussian_expectation_of_a_cubic(q, rng, width):
    dynamics, (x, y) = Polynomial(a=0.4, b=0.8), q.mean.states[:-1].T
    s = width**2 * joint_covariances(q)
    expected = stacked(Polynomial().linearize(q.mean)[0])
    expected[:, 0, 0] += 3 * 0.4 * (x**2 + s[:, 0, 0]) + 0.8 * (y**2 + s[:, 1, 1])
    expected[:, 0, 1] += 2 * 0.8 * (x * y + s[:, 0, 1])
    found, _ = mean_derivatives(dynamics, q, 20_000, width, rng)
    scale = 1 + np.trace(s, axis1=1, axis2=2)[:, None, None]
    assert np.abs((stacked(found) - expected) / scale).max() < 0.08
    # By Stein's identity it is the slope of a linear fit to samples of f.
    delta = np.concatenate(sample_joint_deviations(q, 100_000, rng), axis=2) * width
    z, at_mean = np.hstack([q.mean.states[:-1], q.mean.controls]), dynamics.linearize(q.mean)[0]
    rest = dynamics.after(z + delta) - np.einsum("tij,stj->sti", stacked(at_mean), delta)
    slopes = stacked(at_mean) + np.einsum("sti,stj->tij", rest, delta) / len(delta) @ np.linalg.inv(
        s
    )
    assert np.abs((slopes - expected) / scale).max() < 0.08


def test_the_slope_at_a_kink_is_the_share_of_samples_on_either_side(q, rng):
    found, _ = mean_derivatives(Polynomial(kink=1.0), q, 20_000, 1.0, rng)
    std = np.sqrt(q.state_covariances[:-1, 0, 0])
    share = norm.cdf(q.mean.states[:-1, 0] / std)
    assert_allclose(found.f_x[:, 1, 0], 2 * share - 1, atol=0.03)


def test_samples_have_the_covariance_of_q_and_come_in_pairs(q, rng):
    deviations, controls = sample_joint_deviations(q, 100_000, rng)
    delta = np.concatenate([deviations, controls], axis=2)
    assert_array_equal(delta[:50_000], -delta[50_000:])
    found = np.einsum("sti,stj->tij", delta, delta) / len(delta)
    expected = joint_covariances(q)
    stds = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    assert np.abs((found - expected) / (stds[:, :, None] * stds[:, None, :])).max() < 0.02


def test_samples_stay_within_the_limits_of_the_controls(q, rng):
    inside = replace(q, mean=replace(q.mean, controls=np.clip(q.mean.controls, -0.1, 0.1)))
    found, _ = mean_derivatives(Polynomial(e=0.7, limit=0.1), inside, 4, 1.0, rng)
    assert np.isfinite(stacked(found)).all()  # `Polynomial` checks them


def test_samples_at_which_nothing_can_be_differentiated_are_named(q, rng):
    cubic = Polynomial(a=np.inf)
    with pytest.raises(
        DivergenceError, match=r"step 0, .* 3 times as wide .* leave out dynamics_sam"
    ):
        mean_derivatives(cubic, q, 2, 3.0, rng)
