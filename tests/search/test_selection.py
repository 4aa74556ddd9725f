# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The policy that a search with renewed situations ends with is the best of those it tried."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.limited_pendulum import write_task as write_pendulum
from tests.told_rotor import write_task
from vgps_ros.core.settings import with_values
from vgps_ros.search import methods
from vgps_ros.search.checkpoints import Checkpoints
from vgps_ros.search.methods import search
from vgps_ros.search.selection import Performance, is_evaluated, sound_step, try_policy
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.tasks import make_task

VALUES = {
    "iterations": 4,
    "situations": 3,
    "initial_ddp_iterations": 5,
    "renew.share": 0.5,
    "renew.begin": 2,
    "renew.seconds": 1.0,
    "renew.worst": 100.0,
    "keep.rollouts": 5,
    "keep.seconds": 2.0,
}


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    return make_task(write_task(tmp_path_factory.mktemp("told")))


@pytest.fixture(scope="module")
def settings(task):
    return with_values(search_settings(task), VALUES)


def test_success_counts_first_and_then_the_error_and_the_later_one_of_equals():
    good, better = Performance(None, 3, 0.9, 0.5), Performance(None, 4, 0.95, 0.7)
    assert better.beats(good)
    assert not good.beats(better)
    closer = replace(good, loss=0.4)
    assert closer.beats(good)
    assert not good.beats(closer)
    assert replace(good, k=5).beats(good)


@pytest.mark.parametrize(
    ("success", "loss", "taken"),
    [(0.9, 0.6, True), (0.86, 0.4, True), (0.86, 0.6, False), (0.84, 0.4, False)],
)
def test_calibrated_commands_may_cost_a_rollout_only_where_they_lower_the_error(
    success, loss, taken
):
    best, calibrated = Performance(None, 4, 0.9, 0.5), Performance(None, 4, success, loss)
    assert calibrated.is_no_worse_than(best) == taken


def test_policies_are_tried_in_the_second_half_of_a_search_that_renews(settings):
    assert [is_evaluated(settings, k) for k in (1, 2, 3, 4)] == [False, False, True, True]
    assert not is_evaluated(with_values(settings, {"renew.share": 0.0}), 4)
    assert not is_evaluated(with_values(settings, {"keep.rollouts": 0}), 4)


def test_the_same_policy_is_tried_in_the_same_rollouts_in_each_iteration(task, settings):
    (*_, last) = search("vgps", task, settings, 0, partial(optimize_all, task))
    first, second = (try_policy(task, settings, 0, last.policy, k) for k in (3, 4))
    assert (first.success, first.loss) == (second.success, second.loss)
    other = try_policy(task, settings, 1, last.policy, 3)
    assert other.loss != first.loss
    idle = replace(last.policy, parameters=np.zeros_like(last.policy.parameters))
    assert try_policy(task, settings, 0, idle, 3).loss > first.loss


def test_the_best_policy_is_kept_at_the_end_and_after_a_stop(task, settings, tmp_path, monkeypatch):
    """Iteration 3 is called the best one here; the rollouts behind such a figure are real above."""

    def called(task, settings, seed, policy, k):
        return replace(try_policy(task, settings, seed, policy, k), success=1.0 if k == 3 else 0.2)

    monkeypatch.setattr(methods, "try_policy", called)
    run = partial(search, "vgps", task, settings, 0, partial(optimize_all, task))
    *_, third, last = run()
    assert_array_equal(last.policy.parameters, third.policy.parameters)
    assert third.warnings[-1].endswith("iteration 3 obeyed in 100 % of 5 rollouts.")
    assert last.warnings[-1].endswith(
        "20 % of 5 rollouts. That of iteration 3 is kept, which obeyed in 100 % of 5 rollouts."
    )
    begun = run(checkpoints=Checkpoints(tmp_path))
    for _ in range(3):
        next(begun)
    begun.close()
    monkeypatch.setattr(methods, "_LITTLE", 1.1)  # then 100 % is little, too
    (*_, again) = run(checkpoints=Checkpoints(tmp_path))
    assert again.warnings[-1].endswith(
        "That is little: another --seed may do better, since seeds differ much."
    )
    assert_array_equal(again.policy.parameters, last.policy.parameters)
    assert again.policy_digest == last.policy_digest


def test_a_policy_to_begin_with_is_kept_where_none_is_better(task, settings, monkeypatch):
    """It is called the best one here; all others are what their rollouts say, or worse."""

    def called(task, settings, seed, policy, k):
        found = try_policy(task, settings, seed, policy, k)
        return found if k else replace(found, success=2.0)

    monkeypatch.setattr(methods, "try_policy", called)
    (first, *_) = search("vgps", task, settings, 0, partial(optimize_all, task))
    run = search("vgps", task, settings, 1, partial(optimize_all, task), None, first.policy)
    (*_, last) = run
    assert_array_equal(last.policy.parameters, first.policy.parameters)
    assert "The first policy is kept, which obeyed in 200 %" in last.warnings[-1]


def test_a_step_that_ruins_the_policy_is_taken_as_far_as_it_does_not(task, settings):
    """Half of the way to a policy that drives much too hard is as bad, a quarter of it is not."""
    (*_, last) = search("vgps", task, settings, 0, partial(optimize_all, task))
    good = last.policy
    size = np.abs(good.parameters).max()
    many = with_values(settings, {"keep.rollouts": 20})
    least = try_policy(task, many, 0, good, 3).success - 0.25
    assert least > 0.0

    def step(by, k=3):
        return sound_step(task, many, 0, good, far(by), k)

    def far(by):
        return replace(good, parameters=good.parameters + by * size)

    assert step(1e-6).parameters[0] != good.parameters[0]
    ruined = 1e3
    assert try_policy(task, many, 0, far(ruined), 3).success < least
    assert step(ruined) is good
    by = next(by for by in np.geomspace(1e-3, 1e3, 60) if is_ruined(task, many, far(by), least))
    taken = step(by)
    assert try_policy(task, many, 0, taken, 3).success >= least
    half, quarter = (good.parameters + share * by * size for share in (0.5, 0.25))
    assert any(np.allclose(taken.parameters, one) for one in (half, quarter))
    early = far(ruined)
    assert sound_step(task, many, 0, good, early, 2) is early  # when no policy is tried


def is_ruined(task, settings, policy, least):
    return try_policy(task, settings, 0, policy, 3).success < least


def test_without_commands_the_policy_of_the_least_cost_is_kept(tmp_path):
    task = make_task(write_pendulum(tmp_path))
    settings = with_values(search_settings(task), {**VALUES, "situations": 2})
    (*_, last) = search("vgps", task, settings, 0, partial(optimize_all, task))
    idle = replace(last.policy, parameters=np.zeros_like(last.policy.parameters))
    one, other = (try_policy(task, settings, 0, policy, 4) for policy in (last.policy, idle))
    assert one.success == other.success == 1.0  # nothing is a fall
    best, worse = sorted((one, other), key=lambda each: each.loss)
    assert 0.0 < best.loss < worse.loss
    assert best.beats(worse)
    assert not worse.beats(best)
    hangs = task.cost(task.initial_state[None], np.zeros((1, 1))).mean()
    assert other.loss == pytest.approx(hangs, rel=0.1)  # a step that never moves
    assert "in each step of 5 rollouts" in one.summary(task, settings)
