# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The damping of Gauss-Newton steps and their end, on losses whose gains are chosen."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.fit_loss import _step, minimize_gauss_newton

GRADIENT = np.array([1.0, -2.0])


class Curvature:
    """G = I, so that a step is −∇F ÷ (1 + λ)."""

    def __init__(self):
        self.inner = []

    def solve(self, gradient, damping, iterations):
        self.inner.append(iterations)
        return -gradient / (1.0 + damping)

    def times(self, step):
        return step


def loss_with(gain):
    """A loss of 10 at θ = 0, that falls by `gain(step)`."""
    curvature = Curvature()
    return SimpleNamespace(
        inner=curvature.inner,
        value=lambda theta: 10.0 - gain(theta),
        curvature=lambda theta, weights: curvature,
        at=lambda theta: here(),
    )


def here(value=10.0):
    return SimpleNamespace(value=value, gradient=GRADIENT, weights=None)


def expected(step):
    """What the quadratic model expects a step to gain."""
    return -(step @ GRADIENT + 0.5 * step @ step)


@pytest.mark.parametrize(
    ("share", "factor"), [(2.0, 0.2), (0.8, 0.2), (0.7, 1.0), (0.3, 1.0), (0.2, 3.0)]
)
def test_the_damping_follows_how_much_of_what_the_model_expects_is_gained(share, factor):
    loss = loss_with(lambda step: share * expected(step))
    theta, damping = _step(np.zeros(2), loss, here(), 0.5)
    assert_allclose(theta, -GRADIENT / 1.5)
    assert damping == pytest.approx(factor * 0.5)
    assert loss.inner == [15]


def test_a_step_that_gains_nothing_is_tried_again_with_more_damping():
    loss = loss_with(lambda step: expected(step) if np.abs(step).max() < 0.25 else -1.0)
    theta, damping = _step(np.zeros(2), loss, here(), 0.125)
    assert_allclose(theta, -GRADIENT / 9.0)  # λ = 0.125, 1, 8
    assert damping == pytest.approx(0.2 * 8.0)


@pytest.mark.parametrize("gain", [-1.0, 0.0, np.nan])
def test_where_no_step_gains_the_start_stays(gain):
    theta, damping = _step(np.ones(2), loss_with(lambda _: gain), here(), 1.0)
    assert_allclose(theta, 1.0)
    assert damping == 1e-3


@pytest.mark.parametrize(
    ("gain", "is_kept"), [(0.5, True), (0.05, True), (0.0, False), (-1.0, False), (np.nan, False)]
)
def test_a_fit_ends_with_the_better_of_its_last_two_by_new_samples(gain, is_kept):
    """The second loss finds that the first step has gained so much, where 0.1 is worth another."""
    first = loss_with(expected)
    moved = -GRADIENT / 1.001
    second = loss_with(lambda theta: 0.0 if (theta == moved).all() else -gain)
    last = loss_with(lambda theta: 0.0)
    found = minimize_gauss_newton(np.zeros(2), iter([first, second, last]), 3, 0.1)
    assert bool(second.inner) == (gain >= 0.1)  # another step, which gains nothing and is not made
    assert_allclose(found, moved if is_kept else 0.0)
