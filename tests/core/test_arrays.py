# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Records as arrays by name, and back."""

import numpy as np
from numpy.testing import assert_array_equal

from vgps_ros.core.checks import arrays_of, first_steps, from_arrays
from vgps_ros.core.records import TrajectoryDistribution


def test_a_record_is_read_back_from_its_arrays(random_distribution):
    q = random_distribution()
    arrays = arrays_of(q)
    assert arrays["linear_dynamics.f_u"] is q.linear_dynamics.f_u
    again = arrays_of(from_arrays(TrajectoryDistribution, arrays))
    assert again.keys() == arrays.keys()
    assert all(np.array_equal(again[name], values) for name, values in arrays.items())


def test_the_first_steps_keep_one_state_more_than_controls(random_distribution):
    q = random_distribution(horizon=6)
    cut = q.first(2)
    assert all(
        np.array_equal(values, arrays_of(first_steps(q, 2))[name])
        for name, values in arrays_of(cut).items()
    )
    assert_array_equal(q.mean.first(3).controls, q.mean.controls[:3])
    assert_array_equal(cut.mean.states, q.mean.states[:3])
    assert_array_equal(cut.state_covariances, q.state_covariances[:3])
    assert_array_equal(cut.mean.controls, q.mean.controls[:2])
    assert_array_equal(cut.linear_dynamics.f_x, q.linear_dynamics.f_x[:2])
