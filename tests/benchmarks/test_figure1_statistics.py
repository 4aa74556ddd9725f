# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The statistics over seeds, by hand and against the library that made them known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.figure1.statistics import CEILING, iqm, last_multiples, multiples, profile
from vgps_ros.search.seed_statistics import probability_of_improvement


def test_a_policy_that_fell_or_diverged_counts_as_the_ceiling():
    found = multiples(np.array([[20.0, 1e7, np.inf, np.nan]]), np.full((1, 4), 10.0))
    assert_allclose(found, [[2.0, CEILING, CEILING, CEILING]])


def test_the_iqm_leaves_out_a_quarter_at_either_end():
    found = np.array([[1.0], [2.0], [8.0], [CEILING]])
    band = iqm(found)
    assert_allclose(band.middle, 4.0)
    assert_allclose([band.low, band.high], [[1.0], [CEILING]], rtol=1e-6)
    alone = iqm(found[1:2])
    assert_allclose([alone.middle, alone.low, alone.high], 2.0)


def test_a_seed_ends_at_the_mean_of_its_last_five_iterations():
    assert_allclose(last_multiples(np.array([[9.0, 9.0, 1.0, 1.0, 1.0, 1.0, 32.0]])), [2.0])


def test_a_profile_counts_each_panel_alike():
    panels = [np.array([1.0, 3.0]), np.array([1.0, 1.0, 1.0, 3.0])]
    assert_allclose(profile(panels, np.array([0.5, 2.0, 3.0])).middle, [0.0, 0.625, 1.0])


def test_two_that_fall_are_alike_and_no_panel_outweighs_another():
    ours = [np.array([1.0, CEILING]), np.array([1.0])]
    theirs = [np.array([2.0, CEILING, CEILING, CEILING]), np.array([2.0, 0.5])]
    first = (4 + 3 * 0.5) / 8
    band = probability_of_improvement(ours, theirs)
    assert_allclose(band.middle, (first + 0.5) / 2)
    assert band.low < band.middle < band.high


def test_two_that_never_end_are_alike():
    assert probability_of_improvement([np.array([np.inf])], [np.array([np.inf])]).middle == 0.5


def test_they_are_those_of_rliable(rng):
    """Which counts what is larger as better, and needs as many seeds in each panel."""
    library = pytest.importorskip(
        "rliable.library", reason="pip install -r requirements/comparison.txt", exc_type=ImportError
    )
    metrics = pytest.importorskip("rliable.metrics")
    np.random.seed(0)  # noqa: NPY002  rliable draws from it
    ours, theirs = 1.0 + rng.exponential(size=(2, 20, 2))
    options = {"reps": 4000}
    value, interval = library.get_interval_estimates(
        {"": np.log(ours[:, :1])}, lambda x: np.array([metrics.aggregate_iqm(x)]), **options
    )
    band = iqm(ours[:, :1])
    assert_allclose(np.log(band.middle), value[""])
    assert_allclose(np.log([band.low, band.high]), interval[""], atol=0.05)
    levels = np.array([1.5, 2.5])
    above, interval = library.create_performance_profile({"": ours}, levels, **options)
    band = profile(list(ours.T), levels)
    assert_allclose(band.middle, 1.0 - above[""])
    assert_allclose([band.high, band.low], 1.0 - interval[""], atol=0.03)
    value, interval = library.get_interval_estimates(
        {"": (-ours, -theirs)}, metrics.probability_of_improvement, **options
    )
    band = probability_of_improvement(list(ours.T), list(theirs.T))
    assert_allclose(band.middle, value[""])
    assert_allclose([[band.low], [band.high]], interval[""], atol=0.03)
