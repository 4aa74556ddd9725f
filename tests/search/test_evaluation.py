# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What an evaluation draws, and how it sums up; its costs themselves are in test_vgps.py."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.search.evaluation import Evaluation, evaluate
from vgps_ros.search.metrics import evaluation_metrics
from vgps_ros.search.rollouts import Executions


def test_noise_costs_what_its_variance_says(short_swimmer):
    """Without the velocity's term a policy of noise alone costs T w_u Σ σ²."""
    architecture = Architecture(short_swimmer.observation.names, (), 2)
    noise_std = np.array([30.0, 50.0])
    policy = GaussianPolicy(architecture, np.zeros(20), noise_std)
    cost = dataclasses.replace(short_swimmer.cost, weights=np.zeros(1))
    task = dataclasses.replace(short_swimmer, cost=cost)
    costs = evaluate([task], policy, 200, Executions(0), 1).stochastic_costs
    error = costs.std() / np.sqrt(200)
    assert costs.mean() == pytest.approx(40 * 1e-5 * noise_std @ noise_std, abs=5 * error)


def test_iterations_and_seeds_draw_anew(short_swimmer, policy):
    def costs(seed, iteration):
        return evaluate([short_swimmer], policy, 3, Executions(seed), iteration).stochastic_costs

    assert_array_equal(costs(0, 1), costs(0, 1))
    assert not np.intersect1d(costs(0, 1), costs(0, 2)).size
    assert not np.intersect1d(costs(0, 1), costs(1, 1)).size


def test_rollouts_that_are_kept_are_those_that_would_be_drawn_anew(short_swimmer, policy):
    """The next iteration learns from those of an evaluation, however many it wants of them."""
    kept = Executions(0)
    costs = evaluate([short_swimmer], policy, 3, kept, 1).stochastic_costs
    for count in (2, 5, 4):
        found, anew = (e.of(short_swimmer, policy, count, 2, 0) for e in (kept, Executions(0)))
        for part in ("noise", "states", "controls"):
            assert_array_equal(getattr(found, part), getattr(anew, part))
        assert_array_equal(found.scored().costs.sum(axis=1)[:3], costs[:count])
        assert found.steps == count * short_swimmer.horizon
    other = dataclasses.replace(policy, noise_std=2.0 * policy.noise_std)
    louder = kept.of(short_swimmer, other, 3, 2, 0)
    assert_array_equal(louder.noise, 2.0 * anew.noise[:3])
    assert not np.intersect1d(louder.states[:, -1], found.states[:, -1]).size


@pytest.mark.parametrize(
    ("costs", "mean", "median", "survival"),
    [
        ([1.0, 2.0, 6.0], 3.0, 2.0, 1.0),
        ([1.0, 2.0, np.inf], 20_001.0, 2.0, 2 / 3),
        ([1.0, 3.0, np.inf, np.inf], 30_001.0, np.inf, 0.5),
        ([1.0, 3.0, 5.0, 1e9], 15_002.25, 5.0, 1.0),
    ],
)
def test_no_rollout_counts_more_in_the_mean_than_one_that_diverged(costs, mean, median, survival):
    found = Evaluation(
        np.array([1.0, 3.0]), np.array(costs), np.array([True, False]), np.isfinite(costs)
    )
    assert evaluation_metrics(found, initial_ddp_cost=6.0) == {
        "deterministic_cost": 2.0,
        "deterministic_survival": 0.5,
        "stochastic_cost_mean": pytest.approx(mean),
        "stochastic_cost_median": median,
        "stochastic_survival": pytest.approx(survival),
    }
