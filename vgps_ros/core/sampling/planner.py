# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Improves a plan of controls by samples around it, without derivatives.

A sample adds a random spline to the plan,

    u_i = clip(ū + W ε_i),    ε_i ~ N(0, σ²) at each knot,

where W interpolates between knots, and no sample of a set is the plan itself but the first. By
predictive sampling (Howell et al., arXiv 2212.00541) the best sample is the next plan. By the
cross-entropy method (Kobilarov, IJRR 2012) the mean of the elites is, and their spread is the σ of
the next set.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vgps_ros.core.records import Array

METHODS = ("predictive", "cross_entropy")
# The samples' standard deviations reach from σ down to this share of it, since a rough search finds
# new motions and a fine one finishes them.
_FINEST = 0.1

PlanCost = Callable[[Array], Array]
"""Maps plans (N, H, n_u) to their costs (N,); inf for one that diverges."""


@dataclass(frozen=True)
class Sampler:
    """Samples plans around a plan, and keeps what is better.

    Attributes:
        method: one of METHODS.
        steps: H, the number of controls of a plan.
        knots: number of knots of the random splines, at least 2.
        samples: number of samples of a set, the plan itself included.
        iterations: number of sets, one after another.
        elites: number of samples that the cross-entropy method fits.
        std: σ of each control, shape (n_u,).
        low: smallest value of each control, shape (n_u,).
        high: largest value of each.
    """

    method: str
    steps: int
    knots: int
    samples: int
    iterations: int
    elites: int
    std: Array
    low: Array
    high: Array

    def improved(
        self, plan: Array, cost: PlanCost, rng: np.random.Generator
    ) -> tuple[Array, float]:
        """Returns a plan that costs no more than the one given, shape (H, n_u), and its cost."""
        spline = interpolation(self.steps, self.knots)
        std: Any = self.std * np.geomspace(1.0, _FINEST, self.samples)[:, None, None]
        best, least = plan, np.inf
        for _ in range(self.iterations):
            noise = rng.standard_normal((self.samples, self.knots, len(self.std))) * std
            noise[0] = 0.0
            plans = np.clip(plan + spline @ noise, self.low, self.high)
            costs = cost(plans)
            order = np.argsort(costs, kind="stable")
            if costs[order[0]] < least:
                best, least = plans[order[0]], float(costs[order[0]])
            if self.method == "predictive":
                plan = best
                continue
            elites = order[: self.elites]
            plan = plans[elites].mean(axis=0)
            std = np.maximum(noise[elites].std(axis=0), _FINEST * self.std)
        return best, least


def interpolation(steps: int, knots: int) -> Array:
    """Returns W, which maps values at equally spaced knots to all steps, shape (steps, knots)."""
    at = np.linspace(0.0, knots - 1.0, steps)
    return np.maximum(1.0 - np.abs(at[:, None] - np.arange(knots)), 0.0)
