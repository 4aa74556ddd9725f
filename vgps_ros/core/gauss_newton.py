# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Minimises the M-step's loss by damped Gauss-Newton steps (Levenberg and Marquardt).

    s = −(G + λ d I)⁻¹ ∇F,    d the mean of G's diagonal.

A step takes one pass over all samples for the gradient, and some conjugate gradients over a part of
them, since the curvature need not be exact. λ falls where the quadratic model was right, and grows
where it was not.

Each step has new samples, and so the fit cannot lean on those that it has seen: from one draw it
comes closer to that draw's optimum, but q, which adapts to the network, then ends at a poorer one
(docs/evidence/benchmarks.md). New samples tell as well when to end: once the last step has gained
less on them than a tolerance.
"""

from collections.abc import Iterator

import numpy as np

from vgps_ros.core.fit_loss import FitLoss, Point
from vgps_ros.core.records import Array

_FIRST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e6
# Conjugate gradients in a step. More of them solve a model better that is only a model.
_INNER_ITERATIONS = 15


def minimize_gauss_newton(
    start: Array, losses: Iterator[FitLoss], iterations: int, tolerance: float
) -> Array:
    """Returns the θ that the steps reach from `start`.

    Args:
        start: θ, shape (num_parameters,).
        losses: F(θ) over new samples, without end.
        iterations: the most steps.
        tolerance: the least gain of a step that is worth another one [nat].
    """
    theta, damping = start, _FIRST_DAMPING
    before = None
    for _ in range(iterations):
        loss = next(losses)
        here = loss.at(theta)
        if before is not None:
            gain = loss.value(before) - here.value
            if not gain >= tolerance:
                return theta if gain > 0 else before
        before = theta
        theta, damping = _step(theta, loss, here, damping)
    return theta


def _step(theta: Array, loss: FitLoss, here: Point, damping: float) -> tuple[Array, float]:
    """Returns a θ of lower loss and the next λ; the same θ if there is none."""
    if not np.isfinite(here.value):
        return theta, damping
    curvature = loss.curvature(theta, here.weights)
    while damping <= _LARGEST_DAMPING:
        step = curvature.solve(here.gradient, damping, _INNER_ITERATIONS)
        gain = here.value - loss.value(theta + step)
        if gain > 0:
            expected = -float(step @ (here.gradient + 0.5 * curvature.times(step)))
            factor = 0.2 if gain > 0.75 * expected else 3.0 if gain < 0.25 * expected else 1.0
            return theta + step, factor * damping
        damping *= 8.0
    return theta, _FIRST_DAMPING
