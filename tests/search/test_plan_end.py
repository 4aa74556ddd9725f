# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Short plans that know what comes after their end swing up and walk; others do not."""

from dataclasses import replace

import numpy as np
import pytest

from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.records import Trajectory
from vgps_ros.search.mpc import MpcSettings, Planner
from vgps_ros.search.optimization_request import first_request, initial_motion
from vgps_ros.search.plan_end import PlanEnd
from vgps_ros.tasks import make_task


def driven(task, seconds, **settings):
    """Returns the states of a robot that plans of half a second drive, a plan each second step."""
    planner = Planner(task, MpcSettings(horizon=0.5, ddp=task.optimizer.ddp, **settings))
    plan, states = planner.first_plan(), [task.initial_state]
    for step in range(round(seconds / task.dynamics.time_step)):
        if step and step % 2 == 0:
            plan = planner.next_plan(plan, states[-1], step)
        control = planner.control(plan, states[-1], step)
        states.append(task.dynamics.step(states[-1], control))
    return np.array(states)


@pytest.fixture(scope="module")
def walker():
    return make_task("walker")


@pytest.fixture(scope="module")
def solution(walker):
    begun = initial_motion(walker, first_request(walker, 0, 50))
    cost = walker.cost.starting_at(0, walker.planned_horizon)
    return solve(walker.dynamics, cost, begun.trajectory, walker.optimizer.ddp, 50)


def test_a_walker_walks_by_short_plans_alone(walker):
    states = driven(walker, 2.5)
    assert not walker.fallen(states).any()
    assert walker.distance(states[0], states[-1]) > 1.2


def test_without_what_comes_after_their_end_it_dives(walker):
    assert walker.fallen(driven(walker, 1.2, end_weight=0.0)).any()


@pytest.mark.parametrize(("weight", "upright"), [(1.0, True), (0.0, False)])
def test_a_cart_pole_swings_up_only_if_plans_know_what_comes_after_them(weight, upright):
    task = make_task("cart_pole")
    states = driven(task, 6.0, end_weight=weight)
    ends = task.cost(states[-50:], np.zeros((50, task.dims["n_u"])))
    assert (ends.max() < 0.05) == upright


def test_the_derivatives_of_the_end_are_those_of_its_cost(walker, solution):
    plan = solution.trajectory.first(50)
    to = walker.cost.starting_at(0, 50)
    ended = PlanEnd(walker, solution, 0.5).added(to, walker.cost, plan)
    expansion, plain = ended.expand(plan), to.expand(plan)
    np.testing.assert_array_equal(expansion.c[:-1], plain.c[:-1])

    def cost(deviation):
        states = plan.states.copy()
        states[-2] += deviation
        return ended.values(Trajectory(states, plan.controls)).sum()

    eps = 1e-4 * np.eye(walker.dims["n_dx"])
    slopes = [(cost(e) - cost(-e)) / 2e-4 for e in eps]
    np.testing.assert_allclose(slopes, expansion.c_x[-1], rtol=1e-6, atol=1e-5)
    curvatures = [(cost(e) - 2.0 * cost(0.0) + cost(-e)) / 1e-8 for e in eps]
    np.testing.assert_allclose(curvatures, np.diag(expansion.c_xx[-1]), rtol=1e-4, atol=1e-3)


def test_how_far_a_walker_has_come_does_not_matter(walker, solution):
    end = PlanEnd(walker, solution, 1.0)
    here = solution.trajectory.states[30]
    far = here.copy()
    far[0] += 1e3
    near, moved = end.motion(here, 20), end.motion(far, 20)
    np.testing.assert_allclose(moved.controls, near.controls, atol=1e-6)
    np.testing.assert_allclose(moved.states[:, 1:], near.states[:, 1:], atol=1e-8)


def test_after_a_whole_turn_of_a_pole_all_is_as_before():
    task = make_task("cart_pole")
    cost = task.cost.starting_at(0, task.planned_horizon)
    begun = initial_motion(task, first_request(task, 0, 20))
    found = solve(task.dynamics, cost, begun.trajectory, task.optimizer.ddp, 20)
    end, here = PlanEnd(task, found, 1.0), found.trajectory.states[20] + 0.01
    turn = np.array([0.0, 4.0 * np.pi, 0.0, 0.0])
    near, again = end.motion(here, 20), end.motion(here + turn, 20)
    np.testing.assert_allclose(again.controls, near.controls, atol=1e-6)
    to, plan = task.cost.starting_at(0, 20), found.trajectory.first(20)
    far = replace(plan, states=plan.states + turn)
    one, other = (end.added(to, task.cost, each).expand(each) for each in (plan, far))
    np.testing.assert_allclose(other.c_x, one.c_x, rtol=1e-6, atol=1e-8)


def test_what_comes_after_costs_what_the_cost_of_now_says(walker, solution):
    end, plan = PlanEnd(walker, solution, 1.0), solution.trajectory.first(50)
    to = walker.cost.starting_at(0, 50)
    faster = replace(walker.cost, targets=walker.cost.targets * [1.5, 1.0])
    slow, fast = (end.added(to, cost, plan).expand(plan).c_x[-1] for cost in (walker.cost, faster))
    speed = walker.dynamics.model.nv  # of root_x, the first velocity
    assert fast[speed] < slow[speed] - 1.0  # more speed is worth more where the target is higher
