# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plans over a receding horizon: their warm start, their feedback, and which of them drives."""

import time
from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from tests.nodes.conftest import told  # noqa: F401
from vgps_ros.core.ddp.solve import Status
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Trajectory
from vgps_ros.search.mpc import MpcSettings, Plan, PlanFollower, Planner, adjustable
from vgps_ros.tasks import make_task


@pytest.fixture(scope="module")
def planner(swimmer):
    ddp = swimmer.optimizer.ddp
    return Planner(swimmer, MpcSettings(0.4, ddp=ddp, plan_age_limit=0.1, end_weight=0.0))


@pytest.fixture(scope="module")
def first(planner):
    return planner.first_plan()


def drive(task, horizon, steps):
    """Runs a task in closed loop; returns its states and controls."""
    states, controls = [task.initial_state], []
    for step in range(steps):
        controls.append(horizon.control(states[-1], step)[0])
        states.append(task.dynamics.step(states[-1], controls[-1]))
    return np.array(states), np.array(controls)


def test_on_the_plan_its_controls_are_followed_and_off_it_the_gains_bring_back(planner, first):
    x, u, gains = first.trajectory.states, first.trajectory.controls, first.gains
    moved = replace(first, start=7)
    np.testing.assert_array_equal(planner.control(moved, x[3], 10), u[3])
    shift = np.linspace(-0.1, 0.1, 10)
    expected = u[3] + gains[3] @ shift
    np.testing.assert_allclose(planner.control(moved, x[3] + shift, 10), expected, rtol=1e-9)


def test_a_later_plan_costs_no_more_than_the_rest_of_the_old_one_and_no_torques(
    planner, first, swimmer
):
    state = first.trajectory.states[5]
    plan = planner.next_plan(first, state, 5)
    kept = first.trajectory.controls[5:]
    controls = np.concatenate([kept, np.zeros((5, 2))])
    continued = swimmer.dynamics.rollout(state, lambda t, _: controls[t], planner.steps)
    assert plan.start == 5
    np.testing.assert_array_equal(plan.trajectory.states[0], state)
    assert plan.cost < swimmer.trajectory_cost(continued)


def test_a_plan_that_the_robot_has_left_gives_way_to_a_cheaper_motion(planner, first, swimmer):
    lost = replace(first, gains=np.full_like(first.gains, 1e3))
    state = swimmer.initial_state + 0.1
    plan = planner.next_plan(lost, state, 5)
    resting = swimmer.dynamics.rollout(state, lambda *_: np.zeros(2), planner.steps)
    assert plan.cost < swimmer.trajectory_cost(resting)


def test_where_a_plan_has_ended_servos_hold_their_place():
    task = make_task("quadruped")
    planner = Planner(task, MpcSettings(horizon=0.2, ddp=task.optimizer.ddp))
    start = task.initial_state
    wild = np.full((1, task.dynamics.control_dim), 2.0)  # a plan of one step that nobody needs
    states = np.stack([start, task.dynamics.step(start, wild[0])])
    gains = np.zeros((1, task.dynamics.control_dim, task.dims["n_dx"]))
    ended = Plan(0, Trajectory(states, wild), gains, 0.0, Status.CONVERGED)
    plan = planner.next_plan(ended, start, 1)
    held = np.tile(task.controls.resting(start), (planner.steps, 1))
    still = Trajectory(task.dynamics.replay(start, held[None])[0], held)
    context = task.signals.constant_context(task.signals.rest, planner.steps)
    assert (
        plan.cost <= task.in_context(context).cost.starting_at(1, planner.steps).values(still).sum()
    )


def test_the_policys_weight_draws_a_plan_to_its_controls(swimmer, first):
    shape = Architecture(swimmer.observation.names, (1,), 2)
    parameters = np.zeros(shape.num_parameters)
    parameters[-2:] = [3.0, -2.0]  # the last bias: the policy's constant torques
    policy = GaussianPolicy(shape, parameters, np.ones(2))
    controls = {}
    for weight in (0.0, 1e6):
        settings = MpcSettings(horizon=0.4, ddp=swimmer.optimizer.ddp, policy_weight=weight)
        planner, plan = Planner(swimmer, settings), first
        for _ in range(10):
            plan = planner.next_plan(plan, swimmer.initial_state, 0, policy)
        controls[weight] = plan.trajectory.controls
    np.testing.assert_allclose(controls[1e6], np.tile([3.0, -2.0], (20, 1)), atol=1e-2)
    assert np.abs(controls[0.0] - [3.0, -2.0]).max() > 1.0


def test_the_swimmer_swims_by_plans_alone_and_a_run_repeats_bit_for_bit(swimmer):
    settings = MpcSettings(horizon=1.0, ddp=swimmer.optimizer.ddp)
    runs = []
    for _ in range(2):
        horizon = PlanFollower(Planner(swimmer, settings), every=2)
        runs.append(drive(swimmer, horizon, 100))
        horizon.stop()
    (states, controls), again = runs
    np.testing.assert_array_equal(states, again[0])
    assert swimmer.cost(states[:-1], controls)[50:].mean() < 0.5  # resting costs 1 a step


def test_a_horizon_that_the_task_has_not_is_refused(swimmer):
    for horizon in (0.001, 100.0):
        with pytest.raises(InvalidInputError, match=r"must have 0\.02 to 10 s"):
            Planner(swimmer, MpcSettings(horizon=horizon))


def test_a_cost_that_changes_with_time_is_planned_for_its_own_steps(swimmer):
    """The cost of later steps, told as that of steps from 0 on, is the cost of those steps."""
    rng = np.random.default_rng(0)
    timed = replace(swimmer.cost, targets=rng.standard_normal((30, 1)))
    motion = swimmer.dynamics.rollout(swimmer.initial_state, lambda *_: np.ones(2), 40)
    x, u = motion.states[:-1], motion.controls
    expected = timed(x[12:], u[12:], 12)
    np.testing.assert_array_equal(timed.starting_at(12, 28)(x[12:], u[12:]), expected)


class Slow:
    """A planner whose plans wait until the test lets them come, or fail."""

    def __init__(self, planner, first):
        self.age_limit, self.control = planner.age_limit, planner.control
        self.first_plan = lambda _: first
        self.may_end, self.failure, self.asked, self.warm = Event(), None, [], []

    def next_plan(self, plan, state, step, policy, is_cancelled, context=None):
        self.asked.append(step)
        self.warm.append(plan.start)
        assert self.may_end.wait(60.0)
        if self.failure:
            raise self.failure
        return replace(plan, start=step)


@pytest.fixture
def slow(planner, first):
    return Slow(planner, first)


def test_a_late_plan_leaves_the_old_one_in_use_until_that_is_too_old(slow, swimmer):
    horizon, state = PlanFollower(slow, every=0), swimmer.initial_state
    ages = [horizon.control(state, step)[1] for step in range(6)]
    assert ages == [0, 1, 2, 3, 4, 5]
    with pytest.raises(InvalidInputError, match="6 steps old, but a plan may drive for 5 steps"):
        horizon.control(state, 6)
    slow.may_end.set()
    while slow.asked in ([], [0]):
        horizon.control(state, 5)
    assert horizon.control(state, 5)[1] <= 5
    horizon.stop()


def test_a_plan_begins_from_the_newest_state_as_soon_as_another_ends(slow, swimmer):
    horizon, state = PlanFollower(slow, every=0), swimmer.initial_state

    def wait_for(asked):
        end = time.monotonic() + 60.0
        while slow.asked != asked and time.monotonic() < end:
            time.sleep(0.01)
        assert slow.asked == asked

    horizon.control(state, 0)
    wait_for([0])
    for step in (1, 2):
        horizon.control(state, step)
    slow.may_end.set()
    wait_for([0, 2])
    assert slow.warm == [0, 0]
    horizon.stop()
    assert slow.asked == [0, 2]  # none is made twice from one state


def test_where_no_plan_is_found_the_reason_is_told_and_a_new_time_starts_anew(slow, swimmer):
    horizon, state = PlanFollower(slow, every=1), swimmer.initial_state
    slow.may_end.set()
    slow.failure = DivergenceError("it diverges.")
    ages = [horizon.control(state, step)[1] for step in range(3, 9)]
    assert ages == [0, 1, 2, 3, 4, 5]
    with pytest.raises(InvalidInputError, match="no plan was found: it diverges"):
        horizon.control(state, 9)
    assert horizon.control(state, 0)[1] == 0
    slow.failure = None
    assert horizon.control(state, 1)[1] == 0
    assert horizon.control(state, 100)[1] == 0
    assert slow.warm[-1] == 100  # an old plan is no warm start, but the first one, begun anew
    assert horizon.trouble is None
    horizon.stop()


def test_a_plan_of_the_time_before_a_reset_is_not_taken(slow, swimmer):
    """Even where the new time begins at the step at which the newest plan does."""
    horizon, state = PlanFollower(slow, every=0), swimmer.initial_state
    for step in (0, 1, 2):
        horizon.control(state, step)
    slow.may_end.set()
    while slow.asked in ([], [0]):
        horizon.control(state, 3)
    for _ in range(100):
        assert horizon.control(state, 0)[1] == 0
    horizon.stop()


def test_a_state_from_before_the_plan_is_refused(planner, first, swimmer):
    with pytest.raises(InvalidInputError, match="which begins at step 3"):
        planner.next_plan(replace(first, start=3), swimmer.initial_state, 2)


def test_plans_follow_commands_and_the_policy_that_continues_them_is_told(told):  # noqa: F811
    task = make_task(told)
    planner = Planner(task, MpcSettings(horizon=2.5, ddp=task.optimizer.ddp))
    plan, ends = planner.first_plan(), {}
    shape = Architecture(task.observation.names, (1,), 1)
    policy = GaussianPolicy(shape, np.zeros(shape.num_parameters), np.ones(1))
    for angle in (-0.5, 0.0, 0.5):
        context = task.signals.constant_context(np.array([angle, 0.0]), planner.steps)
        found = plan
        for _ in range(3):
            found = planner.next_plan(found, np.zeros(2), 0, policy, context=context)
        ends[angle] = found.trajectory.states[-1, 0]
    assert ends[-0.5] < ends[0.0] - 0.1 < ends[0.5] - 0.2
    assert adjustable(task.cost).names == ()  # each target follows a command or the clock
