# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Situations with commands that are renewed as a policy learns: the same bits wherever it runs."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.search.test_checkpoints import bits
from tests.told_rotor import maker, write_task
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.settings import with_values
from vgps_ros.search import renewal
from vgps_ros.search.checkpoints import Checkpoints
from vgps_ros.search.methods import search
from vgps_ros.search.renewal import renew
from vgps_ros.search.settings import search_settings
from vgps_ros.search.situations import situations
from vgps_ros.search.solver_processes import SolverProcesses
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.search.workspace import Workspace
from vgps_ros.tasks import make_task

VALUES = {
    "iterations": 5,
    "situations": 4,
    "initial_ddp_iterations": 5,
    "visited_limit": 1.0,
    "policy_rollouts": 2,
    "disturb.payload": 0.1,
    "renew.share": 0.6,
    "renew.begin": 2,
    "renew.end": 1,
    "renew.seconds": 1.0,
    "renew.worst": 100.0,
    "renew.replay": 5,
    "keep.rollouts": 6,
    "keep.seconds": 1.0,
}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_task(tmp_path_factory.mktemp("told"))


@pytest.fixture(scope="module")
def task(path):
    return make_task(path)


def run(task, solve=None, checkpoints=None, **values):
    chosen = with_values(search_settings(task), {**VALUES, **values})
    return search("vgps", task, chosen, 6, solve or partial(optimize_all, task), checkpoints)


@pytest.fixture(scope="module")
def whole(task):
    return list(run(task))


def stayed(before, after):
    pairs = zip(before.solutions, after.solutions, strict=True)
    return [old.situation.is_same(new.situation) for old, new in pairs]


def test_situations_are_renewed_but_the_first_and_only_in_their_time(whole):
    kept = [stayed(a, b) for a, b in pairwise(whole)]
    assert all(each[0] for each in kept)
    assert [sum(each) for each in kept] == [2, 2, 2, 4]  # two of three are renewed in 2, 3 and 4


def test_solver_processes_change_no_bit(path, task, whole):
    with SolverProcesses(maker(path), 2) as processes:
        assert bits(list(run(task, processes.optimize_all))[-1]) == bits(whole[-1])


def test_a_run_that_is_killed_between_renewals_ends_with_the_same_bits(task, whole, tmp_path):
    begun = run(task, checkpoints=Checkpoints(tmp_path))
    for _ in range(3):
        next(begun)
    begun.close()
    said = []
    went_on = list(run(task, checkpoints=Checkpoints(tmp_path, said.append)))
    assert said == ["Going on from iteration 3 of 5."]
    assert bits(went_on[-1]) == bits(whole[-1])


def test_a_solve_that_diverges_in_another_process_says_so(path, task):
    work = Workspace(
        task, with_values(search_settings(task), VALUES), 3, partial(optimize_all, task)
    )
    good = replace(work.request(0, work.initial_solutions[0].situation, 0), guess=np.zeros((20, 1)))
    bad = replace(good, guess=np.full((20, 1), 1e12))
    with SolverProcesses(maker(path), 2) as processes:
        first, second = processes.optimize_all([bad, good])
    assert isinstance(first, DivergenceError)
    assert first.status == "diverged"
    (alone,) = optimize_all(task, [good])
    assert_array_equal(second.distribution.mean.states, alone.distribution.mean.states)


def without_guess_of(i, task):
    """Solves, but from a guess that diverges in situation i at first."""

    def solve(requests):
        changed = [
            replace(r, guess=np.full((20, 1), 1e12), guess_states=None)
            if r.iteration == 0 and r.trajectory_index == i
            else r
            for r in requests
        ]
        return optimize_all(task, changed)

    return solve


def test_a_situation_whose_first_solve_diverges_is_left_out_with_a_warning(task):
    first, *_, last = run(task, without_guess_of(2, task))
    assert len(first.initial_solutions) == len(last.solutions) == 3
    assert any(w.startswith("Situation 2 is left out: ") for w in first.warnings)
    assert not any("is left out" in warning for warning in last.warnings)


def test_the_first_situation_must_have_a_solution(task):
    with pytest.raises(DivergenceError):
        next(run(task, without_guess_of(0, task)))


@pytest.fixture
def work(task):
    def make(task=task, **values):
        chosen = with_values(search_settings(task), {**VALUES, **values})
        return Workspace(task, chosen, 3, partial(optimize_all, task))

    return make


def test_solutions_worse_than_the_limit_are_dropped(work, whole):
    before, policy = whole[0].solutions, whole[0].policy
    after, replaced = renew(work(), before, policy, 2)
    assert len(replaced) == 2
    assert sum(a is not b for a, b in zip(before, after, strict=True)) == 2
    kept, none = renew(work(**{"renew.worst": 1e-9}), before, policy, 2)
    assert not none
    assert all(a is b for a, b in zip(before, kept, strict=True))


def test_a_policy_whose_motions_diverge_leaves_the_situations_as_they_are(work, whole):
    policy, before = whole[0].policy, whole[0].solutions
    wild = replace(policy, parameters=1e30 * np.ones_like(policy.parameters))
    after, replaced = renew(work(), before, wild, 2)
    assert after == before
    assert not replaced


@pytest.mark.parametrize(("cap", "expected"), [(0, [0, 0, 0, 0, 0]), (3, [0, 2, 3, 3, 3])])
def test_samples_of_replaced_solutions_are_kept_up_to_a_number(task, tmp_path, cap, expected):
    saved = []

    class Watched(Checkpoints):
        def save(self, run, state):
            super().save(run, state)
            saved.extend([len(state.last.replay)] if state.last else [])

    list(run(task, checkpoints=Watched(tmp_path), **{"renew.replay": cap}))
    assert saved == expected


def test_commands_of_situations_are_drawn_but_the_first_one_has_the_tasks(task):
    chosen = {"situations": 30, "commands.still": 0.3}
    found = [s for s, _ in situations(task, with_values(search_settings(task), chosen), 0)]
    assert_array_equal(found[0].context, task.planned_context)
    speeds = np.array([each.context[:, 0] for each in found[1:]])
    changes = (np.diff(speeds) != 0.0).sum(axis=1)
    assert set(changes) == {0}
    assert ((speeds >= -1.0) & (speeds <= 2.0)).all()
    assert (speeds == 0.0).all(axis=1).any()


def test_situations_that_all_have_no_solution_are_warned_of(tmp_path):
    fallen = "fallen: [{sensor: rotor/position, above: 1.0}]\ncommands:"
    lift = ("{command: speed, rest: 0.5}", "{command: speed, rest: 9.0}")
    hopeless = make_task(write_task(tmp_path, ("commands:", fallen), lift))
    first = next(run(hopeless))
    assert any(w.startswith("In each first solution the robot falls") for w in first.warnings)


SWING = """\
model: rotor.xml
control_period: 0.05
horizon: 1.0
start: {std: {position: 0.05, velocity: 0.05}, varied: {position: 0.5, velocity: 0.5}}
cost:
  - {sensor: rotor/cos, target: -0.6}
  - {sensor: rotor/sin, target: 0.8}
  - {sensor: rotor/velocity, weight: 0.01}
  - {control: all, weight: 0.01}
observe: [{joint: rotor, as: sin_cos}, joint_velocities]
search: {hidden_units: [4], evaluation_rollouts: 2}
"""


@pytest.fixture(scope="module")
def swing(tmp_path_factory):
    """A rotor without commands, which turns to an angle; two angles a turn apart are the same."""
    folder = tmp_path_factory.mktemp("swing")
    write_task(folder)
    (folder / "task.yaml").write_text(SWING)
    return make_task(str(folder / "task.yaml"))


def begun(swing, solve=None):
    chosen = with_values(search_settings(swing), {**VALUES, "renew.share": 0.3})
    return Workspace(swing, chosen, 3, solve or partial(optimize_all, swing))


def test_a_situation_without_commands_takes_over_a_better_motion_a_turn_apart(swing):
    work = begun(swing)
    policy, solutions = work.first_policy(), list(work.initial_solutions)
    start = solutions[0].situation.initial_state + np.array([2 * np.pi, 0.0])
    still = swing.dynamics.rollout(start, lambda *_: np.zeros(1), swing.horizon)
    distribution = replace(solutions[0].distribution, mean=still)
    situation = replace(solutions[0].situation, initial_state=start)
    cost, best = swing.trajectory_cost(still), solutions[0].cost
    solutions[0] = replace(solutions[0], situation=situation, distribution=distribution, cost=cost)
    after, replaced = renew(work, solutions, policy, 2)
    assert len(replaced) == 1
    assert after[0].situation.is_same(situation)
    assert after[0].cost < best + 0.1 * (cost - best)
    assert np.abs(after[0].distribution.mean.states[:, 0] - start[0]).max() < np.pi


def test_a_policy_without_commands_that_fails_is_led_by_a_known_law(swing):
    asked = []

    def solve(requests):
        asked.extend(requests)
        return optimize_all(swing, requests)

    work = begun(swing, solve)
    policy, solutions = work.first_policy(), work.initial_solutions
    idle = replace(policy, parameters=np.zeros_like(policy.parameters))
    asked.clear()
    renew(work, solutions, idle, 2)
    (new,) = [r for r in asked if not r.situation.is_same(solutions[r.trajectory_index].situation)]
    assert_array_equal(new.guess_states[0], new.initial_state)
    here = new.situation.of(swing)
    own = here.dynamics.rollout(new.initial_state, lambda *_: np.zeros(1), swing.horizon)
    led = replace(own, states=new.guess_states, controls=new.guess)
    assert swing.trajectory_cost(led) < 0.5 * swing.trajectory_cost(own)


def test_without_commands_the_costliest_of_four_motions_has_the_new_situation(swing, monkeypatch):
    seen, drive = [], renewal._roll_out_policy

    def driven(*arguments):
        seen.append(drive(*arguments))
        return seen[-1]

    monkeypatch.setattr(renewal, "_roll_out_policy", driven)
    work = begun(swing)
    after, _ = renew(work, work.initial_solutions, work.first_policy(), 2)
    changed = zip(after, work.initial_solutions, strict=True)
    (new,) = [a.situation for a, b in changed if not a.situation.is_same(b.situation)]
    assert len(seen) == 4
    assert len({each.error for each in seen}) == 4
    worst = max(seen, key=lambda each: each.error)
    assert (new.initial_state == worst.states).all(axis=1).any()
