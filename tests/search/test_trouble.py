# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A search goes on where it can, and says what it got over."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from vgps_ros.core.optimizer_settings import FitSettings
from vgps_ros.search.methods import search
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.tasks import make_task

SHORT = SearchSettings(
    iterations=2, hidden_units=(2,), initial_ddp_iterations=2, evaluation_rollouts=2
)


@pytest.fixture
def rotor():
    return make_task("rotor")


def run(task, settings, change=lambda request: request):
    solve = lambda requests: optimize_all(task, [change(r) for r in requests])  # noqa: E731
    return list(search("vgps", task, settings, 0, solve))


def test_a_solve_that_diverges_leaves_its_solution_as_it_was(rotor):
    def wild(request):
        if request.iteration != 1:
            return request
        return replace(request, guess=np.full((50, 1), 1e8), previous=None, policy=None)

    first, second = run(rotor, SHORT, wild)
    assert "Solution 0 of iteration 1 stays as it was: " in first.warnings[0]
    assert first.ddp_cost == first.initial_ddp_cost
    assert not any("stays as it was" in warning for warning in second.warnings)
    assert second.ddp_cost != first.ddp_cost


def test_a_fit_that_finds_nothing_better_keeps_the_network_and_says_so(rotor):
    """Near its end the rotor has little left to gain, and LBFGS gains it on few draws."""
    fit = FitSettings(optimizer="lbfgs", samples_per_step=10)
    iterations = run(
        rotor, replace(SHORT, iterations=6, alphas=(1.0, 10.0), fit=fit, visited_limit=0.0)
    )
    told = [any("found nothing better" in w for w in i.warnings) for i in iterations[1:]]
    networks = [iteration.policy.parameters for iteration in iterations]
    assert told == [np.array_equal(a, b) for a, b in pairwise(networks)]
    assert any(told)
