# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 on a short walk: lookahead, demonstration and falls reach every part."""

import dataclasses
from functools import partial

import numpy as np
import pytest

from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.tasks import make_task


@pytest.fixture(scope="module")
def short_walker():
    return dataclasses.replace(make_task("walker"), horizon=50, lookahead=10)


def test_a_short_walk_is_learned_over_the_scored_horizon(short_walker):
    settings = dataclasses.replace(
        search_settings(short_walker),
        iterations=2,
        initial_ddp_iterations=3,
        evaluation_rollouts=3,
        hidden_units=(5,),
    )
    iterations = list(
        search("vgps", short_walker, settings, 0, partial(optimize_all, short_walker))
    )
    last = iterations[-1]
    q = last.solutions[0].distribution
    assert q.mean.horizon == 60
    scored = q.mean.first(50)
    assert last.ddp_cost == short_walker.trajectory_cost(scored)
    demonstrated = short_walker.trajectory_cost(short_walker.begin.motion.first(50))
    assert last.initial_ddp_cost < demonstrated
    assert last.evaluation.stochastic_survived.shape == (3,)
    stds = np.sqrt(np.diagonal(q.state_covariances, axis1=1, axis2=2))
    assert np.all(stds <= short_walker.std_limit * (1 + 1e-12))


def test_several_starts_have_a_demonstration_each(short_walker):
    settings = dataclasses.replace(
        search_settings(short_walker),
        iterations=1,
        initial_ddp_iterations=1,
        evaluation_rollouts=1,
        situations=3,
    )
    (only,) = search("vgps", short_walker, settings, 10, partial(optimize_all, short_walker))
    starts = [solution.distribution.mean.states[0] for solution in only.solutions]
    assert len({start.tobytes() for start in starts}) == 3
    assert not any(short_walker.fallen(s.distribution.mean.states).any() for s in only.solutions)
