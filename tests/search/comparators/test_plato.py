# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Model predictive control as the policy's teacher: what it does, and what is learned of it."""

from functools import partial

import numpy as np
import pytest

from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.settings import with_values
from vgps_ros.search.comparators.plato import Teacher, plato
from vgps_ros.search.methods import search
from vgps_ros.search.mpc import MpcSettings, Planner
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.settings import search_settings
from vgps_ros.search.situations import situations
from vgps_ros.search.trajectory_optimization import optimize, optimize_all
from vgps_ros.search.workspace import Workspace
from vgps_ros.tasks import make_task

COUNT, STEPS = 2, 30


@pytest.fixture
def taught(short_swimmer, policy):
    """A teacher of the swimmer for 30 steps, without noise, and its q."""
    q = optimize(short_swimmer, first_request(short_swimmer, 0, 3)).distribution
    planner = Planner(short_swimmer, MpcSettings(0.5, ddp=short_swimmer.optimizer.ddp))
    teacher = Teacher(planner, 5, policy, q, np.zeros((COUNT, STEPS, 2)))
    return teacher, planner, q


def test_it_does_what_its_newest_plan_does_and_plans_as_often_as_asked(
    taught, short_swimmer, monkeypatch
):
    teacher, planner, _ = taught
    plans, made = [], planner.next_plan

    def noted(*arguments, **options):
        plans.append(made(*arguments, **options))
        return plans[-1]

    monkeypatch.setattr(planner, "next_plan", noted)
    starts = np.stack([short_swimmer.initial_state, short_swimmer.initial_state + 0.05])
    states, controls, _ = short_swimmer.dynamics.rollouts(starts, teacher, STEPS)
    np.testing.assert_array_equal(teacher.actions, controls)
    assert [plan.start for plan in plans] == [t for t in range(0, STEPS, 5) for _ in range(COUNT)]
    for i, t in np.ndindex(COUNT, STEPS):
        plan = plans[COUNT * (t // 5) + i]
        np.testing.assert_array_equal(controls[i, t], planner.control(plan, states[i, t], t))


def test_noise_moves_the_robot_but_is_not_taught(taught, short_swimmer, policy, rng):
    _, planner, q = taught
    noise = rng.standard_normal((COUNT, STEPS, 2))
    teacher = Teacher(planner, 5, policy, q, noise)
    x = np.stack([short_swimmer.initial_state] * COUNT)
    np.testing.assert_allclose(teacher(0, x) - teacher.actions[:, 0], noise[:, 0], atol=1e-9)
    assert np.isnan(teacher.actions[:, 1:]).all()


def test_where_no_plan_is_found_the_solution_drives_on_until_its_end(
    taught, short_swimmer, monkeypatch
):
    teacher, planner, q = taught

    def fails(*_, **__):
        raise DivergenceError("none")

    monkeypatch.setattr(planner, "next_plan", fails)
    x = q.mean.states[None, 7]
    np.testing.assert_allclose(teacher(7, np.repeat(x, COUNT, axis=0))[0], q.mean.controls[7])
    after = len(q.gains)
    beyond = Teacher(planner, 5, None, q, np.zeros((1, after + 1, 2)))
    np.testing.assert_array_equal(beyond(after, x), 0.0)
    assert np.isnan(beyond.actions).all()


@pytest.fixture(scope="module")
def walker():
    return make_task("walker")


def test_a_lesson_ends_where_the_robot_falls(walker):
    """Plans of a tenth of a second let the walker fall; what follows its fall teaches nothing."""
    values = {"teacher.horizon": 0.1, "teacher.plan_every": 10, "policy_rollouts": 1}
    values |= {"initial_ddp_iterations": 5, "supervised_iterations": 5, "teacher.noise": 0.5}
    settings = with_values(search_settings(walker), values)
    work = Workspace(walker, settings, 0, partial(optimize_all, walker))
    first = plato(work, None, 1)
    lessons = plato(work, first, 2)
    assert 0 < len(lessons.states) < walker.horizon
    assert lessons.states.shape[1] == walker.dims["n_x"]
    assert lessons.actions.shape == (len(lessons.states), walker.dims["n_u"])
    assert np.isfinite(lessons.states).all()
    assert np.isfinite(lessons.actions).all()
    assert not walker.fallen(lessons.states).any()


def test_the_teacher_answers_pushes_that_it_does_not_know(walker):
    """The pushed walker costs less than under the solution's own feedback, which bears one push."""
    chosen = with_values(search_settings(walker), {"disturb.push": 30.0})
    q = optimize(walker, first_request(walker, 0, 20)).distribution
    steps, start, costs = 150, walker.initial_state[None], {}

    def feedback(t, x):
        return q.mean.controls[t] + (x - q.mean.states[t]) @ q.gains[t].T

    for seed in (0, 1):
        ((situation, _),) = situations(walker, chosen, seed)
        planner = Planner(walker, MpcSettings(1.5, ddp=walker.optimizer.ddp))
        laws = Teacher(planner, 5, None, q, np.zeros((1, steps, 6))), feedback
        runs = (situation.of(walker).dynamics.rollouts(start, law, steps) for law in laws)
        paid = [walker.cost(states[:, :-1], controls).sum() for states, controls, _ in runs]
        costs[situation.disturbance.push[0]] = paid
    assert costs[30.0][0] < 0.95 * costs[30.0][1]
    assert costs[-30.0][0] < 0.3 * costs[-30.0][1]


def test_a_few_lessons_make_a_policy_that_swims(swimmer):
    """Where DAGGER's policy, which drives itself, stands still (docs/evidence/comparison.md)."""
    values = {"iterations": 2, "policy_rollouts": 2, "teacher.plan_every": 10}
    values |= {"supervised_iterations": 5, "initial_ddp_iterations": 40}
    settings = with_values(search_settings(swimmer), values)
    last = list(search("plato", swimmer, settings, 0, partial(optimize_all, swimmer)))[-1]
    assert last.evaluation.deterministic_costs.max() < 1.2 * last.initial_ddp_cost
    assert np.median(last.evaluation.stochastic_costs) < 1.3 * last.initial_ddp_cost
