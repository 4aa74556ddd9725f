# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 in process."""

from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.evaluation import evaluate
from vgps_ros.search.methods import check_search, search
from vgps_ros.search.metrics import evaluation_metrics
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.rollouts import Executions
from vgps_ros.search.settings import SearchSettings, architecture, search_settings, with_preset
from vgps_ros.search.situations import initial_states
from vgps_ros.search.trajectory_optimization import optimize, optimize_all
from vgps_ros.tasks import make_task

CONVERGED_SWIMMER = 157.1  # cost of 300 iterations of DDP from the task's start
QUICK = SearchSettings(
    iterations=2, hidden_units=(3,), initial_ddp_iterations=3, evaluation_rollouts=3
)


def run(task, settings, seed=0):
    requests = []

    def solve(batch):
        requests.append(list(batch))
        return optimize_all(task, batch)

    return list(search("vgps", task, settings, seed, solve)), requests


def test_alpha_rises_exponentially_over_the_run_and_then_stays():
    settings = SearchSettings(iterations=40)
    assert_allclose([settings.alpha(k) for k in range(41)], np.geomspace(0.3, 20.0, 41))
    assert {settings.alpha(k) for k in (40, 41, 200)} == {settings.alpha(40)}


@pytest.mark.parametrize("iterations", [20, 50, 300])
def test_alpha_of_the_papers_schedule_is_a_tenth_by_the_fiftieth_iteration(iterations):
    settings = SearchSettings(preset="paper", iterations=iterations)
    settings = with_preset(settings, make_task("swimmer"))
    assert settings.alpha(0) == 1.0
    assert_allclose(settings.alpha(25), np.sqrt(0.1))
    assert_allclose([settings.alpha(k) for k in (50, 51, 200)], 0.1)
    ratios = [settings.alpha(k + 1) / settings.alpha(k) for k in range(50)]
    assert_allclose(ratios, 0.1 ** (1 / 50))


def test_alpha_reaches_its_last_value_at_the_end_of_a_run_of_any_length():
    explicit = SearchSettings(alpha_iterations=(0, 50))
    assert [SearchSettings().alpha(k) for k in range(60)] == [explicit.alpha(k) for k in range(60)]
    short = SearchSettings(iterations=20, alphas=(4.0, 1.0, 9.0))
    assert_allclose([short.alpha(k) for k in (0, 5, 10, 15, 20, 21)], [4, 2, 1, 3, 9, 9])


def test_alpha_passes_through_the_points_of_its_schedule():
    settings = SearchSettings(alphas=(4.0, 1.0, 9.0), alpha_iterations=(0, 20, 60))
    assert_allclose(
        [settings.alpha(k) for k in (0, 10, 20, 40, 60, 61, 500)], [4, 2, 1, 3, 9, 9, 9]
    )
    constant = SearchSettings(alphas=(3.0,))
    assert {constant.alpha(k) for k in (0, 1, 100)} == {3.0}


@pytest.mark.parametrize(
    ("alphas", "iterations", "sentence"),
    [
        ((1.0, 0.1, 1.0), (0, 50), "alphas has 3 values, but alpha_iterations has 2"),
        ((1.0, 0.1), (1, 50), r"alpha_iterations is \[1, 50\]"),
        ((1.0, 0.1), (0, 0), r"alpha_iterations is \[0, 0\]"),
    ],
)
def test_a_schedule_that_is_none_is_refused(alphas, iterations, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        SearchSettings(alphas=alphas, alpha_iterations=iterations)


def test_each_line_of_the_algorithm_is_asked_for(short_swimmer):
    iterations, requests = run(short_swimmer, QUICK)
    first, *later = requests
    assert first[0].policy is None  # line 1
    assert first[0].cost_scale == QUICK.alpha(0)
    assert first[0].max_iterations == 3
    for k, batch in enumerate(later, start=1):  # line 6
        assert batch[0].iteration == k
        assert batch[0].cost_scale == QUICK.alpha(k)
        assert batch[0].policy is iterations[k - 1].policy
    assert later[1][0].previous is iterations[0].solutions[0].distribution


def test_several_initial_states_have_a_solution_each_and_train_one_policy(short_swimmer):
    iterations, requests = run(short_swimmer, replace(QUICK, situations=3))
    starts = [request.initial_state for request in requests[0]]
    assert len({start.tobytes() for start in starts}) == 3
    last = iterations[-1]
    for start, solution in zip(starts, last.solutions, strict=True):
        np.testing.assert_array_equal(solution.distribution.mean.states[0], start)
    assert last.evaluation.deterministic_costs.shape == (3,)
    assert last.evaluation.stochastic_costs.shape == (9,)


def test_the_first_initial_state_is_the_tasks_and_others_vary_where_it_says(swimmer):
    (only,) = initial_states(swimmer, QUICK, seed=0)
    np.testing.assert_array_equal(only, swimmer.initial_state)
    first, *others = initial_states(swimmer, replace(QUICK, situations=1000), seed=0)
    np.testing.assert_array_equal(first, only)
    states = np.array(others)
    std = swimmer.varied_state_std
    assert_allclose(states.std(axis=0), std, atol=5 * 0.3 / np.sqrt(2000))
    np.testing.assert_array_equal(states[:, std == 0], 0.0)


def test_order_in_which_optimizers_answer_does_not_matter(short_swimmer):
    """Solves of one iteration are independent: they may run anywhere, at any time."""
    settings = replace(QUICK, situations=2, iterations=1)

    def backwards(batch):
        return optimize_all(short_swimmer, batch[::-1])[::-1]

    (expected,), _ = run(short_swimmer, settings)
    (found,) = search("vgps", short_swimmer, settings, 0, backwards)
    np.testing.assert_array_equal(found.policy.parameters, expected.policy.parameters)
    assert found.ddp_cost == expected.ddp_cost


def test_policy_of_the_paper_s_size_has_the_parameters_it_should(swimmer):
    shape = architecture(swimmer, SearchSettings(hidden_units=(5,)))
    assert shape.num_parameters == 62
    assert shape.observed[0] == "root_y/position"  # swimming is the same at every root x


@pytest.mark.parametrize(
    ("settings", "seed", "sentence"),
    [
        (replace(QUICK, iterations=0), 0, "iterations is 0"),
        (replace(QUICK, alphas=(-1.0, 0.1)), 0, "alphas is -1"),
        (replace(QUICK, preset="papers"), 0, "preset .*papers.*ours, paper"),
        (QUICK, -1, "seed is -1, but it must be at least 0"),
    ],
)
def test_bad_settings_are_refused_before_anything_is_solved(
    short_swimmer, settings, seed, sentence
):
    with pytest.raises(InvalidInputError, match=sentence):
        next(search("vgps", short_swimmer, settings, seed, lambda _: pytest.fail("it was solved")))


def test_reported_costs_are_those_of_an_independent_rollout_loop(short_swimmer, rng):
    shape = Architecture(short_swimmer.observation.names, (4,), 2)
    policy = GaussianPolicy(
        shape, 2 * rng.standard_normal(shape.num_parameters), np.array([5.0, 8.0])
    )
    start = 0.2 * rng.standard_normal(10)
    here = replace(short_swimmer, initial_state=start)
    evaluation = evaluate([here], policy, 3, Executions(9), 4)

    def cost_of_rollout(x, noise):
        """Plain MuJoCo, and the paper's cost written out anew."""
        model = mujoco.MjModel.from_xml_string(short_swimmer.mjcf)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = x[:5], x[5:]
        w1, b1, w2, b2 = np.split(policy.parameters, [36, 40, 48])
        total = 0.0
        for t in range(short_swimmer.horizon):
            mujoco.mj_forward(model, data)
            mujoco.mj_subtreeVel(model, data)
            observed = np.concatenate([data.qpos, data.qvel])[1:]
            hidden = np.log1p(np.exp(w1.reshape(4, 9) @ observed + b1))
            u = w2.reshape(2, 4) @ hidden + b2 + noise[t]
            total += 1e-5 * u @ u + (data.subtree_linvel[1, 0] - 1.0) ** 2
            data.ctrl[:] = u
            mujoco.mj_step(model, data)
        return total

    silence = np.zeros((short_swimmer.horizon, 2))
    assert_allclose(evaluation.deterministic_costs, [cost_of_rollout(start, silence)], rtol=1e-9)
    draws = generator(9, Stream.POLICY_ROLLOUTS, 5, 0).standard_normal((3, 10 + 2 * 40))
    noise = draws[:, 10:].reshape(3, 40, 2) * policy.noise_std
    expected = [cost_of_rollout(start + 0.01 * draws[i, :10], noise[i]) for i in range(3)]
    assert_allclose(evaluation.stochastic_costs, expected, rtol=1e-9)
    found = evaluation_metrics(evaluation, 30.0)
    assert_allclose(found["stochastic_cost_mean"], np.mean(expected), rtol=1e-9)
    assert_allclose(found["stochastic_cost_median"], np.median(expected), rtol=1e-9)
    assert found["stochastic_survival"] == 1.0


def test_a_policy_that_diverges_is_reported_as_such(short_swimmer):
    shape = Architecture(short_swimmer.observation.names, (), 2)
    # Positive feedback of a velocity: it grows without bound.
    parameters = np.zeros(shape.num_parameters)
    parameters[shape.observed.index("front_joint/velocity")] = 1e5
    policy = GaussianPolicy(shape, parameters, np.array([1.0, 1.0]))
    here = replace(short_swimmer, initial_state=np.full(10, 0.1))
    evaluation = evaluate([here], policy, 4, Executions(0), 1)
    found = evaluation_metrics(evaluation, 30.0)
    assert found["deterministic_cost"] == np.inf
    assert found["stochastic_cost_mean"] == 300_000.0
    assert found["stochastic_cost_median"] == np.inf
    assert found["stochastic_survival"] == 0.0


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_papers_preset_learns_to_swim(seed):
    """Converged DDP costs 157 and standing still 500; the policy without noise comes near DDP."""
    task = make_task("swimmer")
    settings = replace(search_settings(task), preset="paper", iterations=10)
    *_, last = search("vgps", task, settings, seed, partial(optimize_all, task))
    assert last.alpha == pytest.approx(0.1 ** (10 / 50))
    assert last.deterministic_cost < 1.2 * CONVERGED_SWIMMER


@pytest.mark.slow
def test_converged_ddp_of_the_swimmer_has_the_cost_that_policies_are_judged_by():
    task = make_task("swimmer")
    assert optimize(task, first_request(task, 0, 300)).cost == pytest.approx(
        CONVERGED_SWIMMER, 0.02
    )


@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        ({"visited_limit": 1.0}, "visited_limit is 1.0, but the preset paper sets it to 0.0"),
        ({"alphas": (3.0,)}, "alphas is .*, but the preset paper sets it to"),
    ],
)
def test_what_contradicts_the_preset_is_refused(other, sentence):
    settings = SearchSettings(preset="paper", **other)
    with pytest.raises(InvalidInputError, match=sentence):
        check_search("vgps", make_task("swimmer"), settings, 0)
