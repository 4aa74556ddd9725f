# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The marginals of q against its rollouts."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.limited_pendulum import write_task
from vgps_ros.search.methods import search
from vgps_ros.search.metrics import LARGEST_COVERAGE, LEAST_COVERAGE, coverage
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.trajectory_optimization import optimize, optimize_all
from vgps_ros.tasks import make_task

QUICK = SearchSettings(iterations=1, initial_ddp_iterations=5, evaluation_rollouts=1)


@pytest.fixture
def rotor():
    return make_task("rotor")


@pytest.fixture
def q(rotor):
    request = replace(first_request(rotor, 0, 20), guess=np.zeros((50, 1)))
    return optimize(rotor, request).distribution


def mean_coverage(task, q):
    return np.mean([coverage(task, q, np.random.default_rng(i)) for i in range(300)])


def test_two_standard_deviations_cover_a_linear_robot_as_a_gaussian(rotor, q):
    assert mean_coverage(rotor, q) == pytest.approx(0.9545, abs=0.01)


def test_marginals_half_as_wide_as_they_should_be_cover_the_least(rotor, q):
    """Starts come from the marginal, so its first one stays as it is."""
    narrow = q.state_covariances / 4.0
    narrow[0] *= 4.0
    found = mean_coverage(rotor, replace(q, state_covariances=narrow))
    assert found == pytest.approx(LEAST_COVERAGE, abs=0.02)


def test_a_rollout_that_diverges_is_not_covered(rotor, q):
    assert coverage(rotor, replace(q, gains=q.gains + 1e6), np.random.default_rng(0)) < 0.1


def test_noise_that_the_limits_of_controls_cut_is_told_of(tmp_path):
    """Of a spread of 6.9 N·m the motor gives less than 2."""
    weak = ("target: 1.5, weight: 100.0", "target: 0.2, weight: 1.0"), ("1.0e-3", "0.1")
    task = make_task(write_task(tmp_path, *weak))
    for alpha, is_told in ((100.0, False), (0.1, True)):
        settings = replace(QUICK, iterations=2, alphas=(alpha,))
        _, found = search("vgps", task, settings, 0, partial(optimize_all, task))
        assert (found.coverage >= LARGEST_COVERAGE) == is_told
        assert any("reaches the controls' limits" in w for w in found.warnings) == is_told


def test_marginals_that_do_not_hold_are_told_of(short_swimmer):
    """A tenth of the spread that the noise really has."""
    limit = np.where(np.isfinite(short_swimmer.std_limit), 0.1, 1.0) * short_swimmer.std_limit
    tight = replace(short_swimmer, std_limit=limit)
    settings = replace(QUICK, iterations=2, alphas=(0.3,))
    for task, told in ((short_swimmer, False), (tight, True)):
        first, found = search("vgps", task, settings, 0, partial(optimize_all, task))
        assert not any("the linear model is inaccurate" in warning for warning in first.warnings)
        assert (found.coverage < LEAST_COVERAGE) == told
        assert (
            any("the linear model is inaccurate" in warning for warning in found.warnings) == told
        )
