# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The situations that a search draws, and what it learns in them."""

from functools import partial

import numpy as np
import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import with_values
from vgps_ros.search.methods import search
from vgps_ros.search.settings import SearchSettings, search_settings
from vgps_ros.search.situations import situations
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.tasks import make_task


def test_situations_start_on_the_way_of_the_first_motion_each_with_its_push():
    walker = make_task("walker")
    chosen = {"situations": 5, "disturb.start_before": 1.0, "disturb.push": 10.0}
    found = situations(walker, with_values(SearchSettings(), chosen), 3)
    assert len({each.initial_state.tobytes() for each, _ in found}) == 5
    np.testing.assert_array_equal(found[0][0].initial_state, walker.initial_state)
    assert {each.disturbance.push for each, _ in found} == {(10.0, 0.0), (-10.0, 0.0)}
    for each, guess in found[1:]:
        np.testing.assert_array_equal(guess.states[0], each.initial_state)
        assert guess.controls.shape == (walker.planned_horizon, 6)
        gaps = walker.dynamics.gaps(guess)
        assert np.abs(gaps).max() < 1e-9  # a motion of the undisturbed robot
    later = [each.initial_state[0] for each, _ in found]
    assert 0.0 <= min(later) < 0.3 < max(later) < 1.0  # metres that it has come by then


def test_more_situations_leave_the_first_ones_disturbances_as_they_are():
    task = make_task("cart_pole")
    chosen = {"disturb.push": 1.0, "disturb.push_before": 1.0, "disturb.payload": 0.2}
    few, many = (
        [s.disturbance for s, _ in situations(task, with_values(SearchSettings(), values), 3)]
        for values in ({**chosen, "situations": n} for n in (2, 4))
    )
    assert few == many[:2]
    assert len(set(many)) == 4


@pytest.mark.parametrize("method", ["vgps", "adaptive_gps", "adapted_weighted_dagger"])
def test_methods_learn_from_disturbed_robots(method):
    task = make_task("rotor")
    chosen = {
        "situations": 2,
        "iterations": 2,
        "hidden_units": (3,),
        "initial_ddp_iterations": 5,
        "disturb.push": 1.0,
        "disturb.payload": 0.1,
        "supervised_iterations": 20,
    }
    settings = with_values(search_settings(task), chosen)
    last = list(search(method, task, settings, 0, partial(optimize_all, task)))[-1]
    for (each, _), solution in zip(situations(task, settings, 0), last.solutions, strict=True):
        mean = solution.distribution.mean
        assert solution.situation.is_same(each)
        assert np.abs(each.of(task).dynamics.gaps(mean)).max() < 1e-12
        assert np.abs(task.dynamics.gaps(mean)).max() > 1e-4


def test_a_motion_that_follows_no_law_has_no_later_start():
    settings = with_values(SearchSettings(), {"disturb.start_before": 1.0, "situations": 2})
    with pytest.raises(InvalidInputError, match="follows no law that could go on"):
        situations(make_task("swimmer"), settings, 0)


@pytest.mark.parametrize("late", [{"disturb.push_before": 4.0}, {"disturb.push_duration": 4.1}])
def test_a_push_must_end_within_the_horizon(late):
    task, push = make_task("cart_pole"), {"disturb.push": 1.0}
    situations(task, with_values(SearchSettings(), {**push, "disturb.push_before": 3.9}), 0)
    with pytest.raises(InvalidInputError, match="but the horizon ends after 4 s"):
        situations(task, with_values(SearchSettings(), {**push, **late}), 0)


def test_one_situation_alone_has_no_later_start():
    settings = with_values(SearchSettings(), {"disturb.start_before": 1.0})
    with pytest.raises(InvalidInputError, match="set situations to 2 or more"):
        situations(make_task("walker"), settings, 0)
