# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Every method of the comparison: one shape, and a problem whose optimum is known."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.optimizer_settings import FitSettings
from vgps_ros.search.comparators.gps import combine_rollouts
from vgps_ros.search.methods import METHODS, search
from vgps_ros.search.settings import METHOD, GpsSettings, search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.search.workspace import Workspace
from vgps_ros.tasks import make_task

ROTOR = make_task("rotor")
# Only the first of two controls has an effect that costs: it is one decision.
ONE_DECISION = dataclasses.replace(
    ROTOR,
    horizon=2,
    cost=dataclasses.replace(ROTOR.cost, control_weights=np.array([0.01])),
    initial_state=np.array([0.0, 5.0]),
)
SAMPLES = ("gps", "adaptive_gps")  # to which only samples show the way
RESOLVES = {"vgps", "adaptive_gps", "adapted_weighted_dagger", "mdgps"}


def solver(task):
    return partial(optimize_all, task)


def run(method, task, seed=3, wrap=lambda solve: solve, **settings):
    values = {
        "iterations": 3, "hidden_units": (3,), "evaluation_rollouts": 2,
        "supervised_iterations": 50, **settings,
    }  # fmt: skip
    chosen = dataclasses.replace(search_settings(task), **values)
    return list(search(method, task, chosen, seed, wrap(solver(task))))


def test_the_names_that_flags_and_parameters_take_are_those_of_the_methods():
    assert METHOD.schema["enum"] == list(METHODS)


@pytest.mark.parametrize("method", METHODS)
def test_a_method_does_as_many_updates_as_asked_and_repeats_itself(method):
    iterations, again = (run(method, ROTOR) for _ in range(2))
    assert [i.k for i in iterations] == [1, 2, 3]
    steps = [i.simulator_steps for i in iterations]
    assert steps == sorted(steps)
    assert iterations[-1].policy.parameters.tobytes() == again[-1].policy.parameters.tobytes()
    assert iterations[-1].policy.noise_std.tobytes() == again[-1].policy.noise_std.tobytes()
    costs, same = (each[-1].evaluation.stochastic_costs for each in (iterations, again))
    assert costs.tobytes() == same.tobytes()
    other = run(method, ROTOR, seed=4)
    assert other[-1].policy.parameters.tobytes() != iterations[-1].policy.parameters.tobytes()


@pytest.mark.parametrize("method", METHODS)
def test_a_method_keeps_the_initial_solution_or_adapts_it(method):
    first, *_, last = run(method, ROTOR)
    initial = run("gps", ROTOR, iterations=1)[0].solutions[0].distribution.mean.states
    found = last.solutions[0].distribution.mean.states
    assert (found.tobytes() != initial.tobytes()) == (method in RESOLVES)
    assert first.initial_ddp_cost == last.initial_ddp_cost


@pytest.mark.parametrize("method", METHODS)
def test_several_initial_states_train_one_policy(method):
    last = run(method, ROTOR, situations=2, iterations=2, policy_rollouts=4)[-1]
    assert len(last.solutions) == 2
    assert last.evaluation.deterministic_costs.shape == (2,)


def displaced(solve):
    """Solves likewise, but the initial solution's first control is off by 6 N·m."""

    def solve_and_displace(requests):
        results = solve(requests)
        if requests[0].iteration > 0:
            return results
        moved = []
        for result in results:
            mean = result.distribution.mean
            controls = mean.controls + np.array([[6.0], [0.0]])
            law = lambda t, x, u=controls: u[t]  # noqa: E731
            rollout = ONE_DECISION.dynamics.rollout(mean.states[0], law, 2)
            distribution = dataclasses.replace(result.distribution, mean=rollout)
            moved.append(dataclasses.replace(result, distribution=distribution))
        return moved

    return solve_and_displace


@pytest.mark.parametrize(
    "method", [pytest.param(m, marks=[pytest.mark.slow] if m in SAMPLES else []) for m in METHODS]
)
def test_a_problem_of_one_decision_is_solved_from_afar(method):
    """u_1* minimises w u² + ‖r(x_2)‖², a parabola, since the second control is best left zero.

    What imitates the initial solution alone begins as a bad copy of it, the rest with a bad one.
    """
    x, nothing = ONE_DECISION.initial_state, np.zeros(1)

    def total(u):
        control = np.array([u])
        following = ONE_DECISION.dynamics.step(x, control)
        return ONE_DECISION.cost(np.stack([x, following]), np.stack([control, nothing])).sum()

    low, standing, high = total(-1.0), total(0.0), total(1.0)
    optimum = total(0.5 * (low - high) / (high - 2 * standing + low))
    imitates = method in ("dagger", "weighted_dagger")
    settings = {"iterations": 40, "policy_rollouts": 100}
    if method.startswith("cost"):
        # Weights by cost need costs that differ as those of a robot's whole motion do.
        settings.update(alphas=(5.0,), alpha_iterations=(0,))
    if weighs := method in SAMPLES:
        # They need many samples, and may still miss it.
        settings = {"iterations": 20, "policy_rollouts": 1000}
    gaps = []
    # The adapted oracle may drift with its policy, as it did on two of ten seeds.
    drifts = method == "adapted_weighted_dagger"
    for seed in range(3, 9) if weighs or drifts else (3,):
        first, *_, last = run(
            method,
            ONE_DECISION,
            seed=seed,
            wrap=(lambda solve: solve) if imitates else displaced,
            hidden_units=(2,),
            supervised_iterations=1 if imitates else 500,
            gps=GpsSettings(guiding_noise=1.0),
            # One iteration of L-BFGS makes a bad copy, one of Gauss-Newton a good one.
            fit=FitSettings(optimizer="lbfgs" if imitates else "gauss_newton", samples_per_step=10),
            **settings,
        )
        gaps.append([i.deterministic_cost - optimum for i in (first, last)])
    before, after = np.median(gaps, axis=0)
    assert before > (0.05 if imitates else 0.5) * (standing - optimum)
    assert 0 <= after < (0.02 if imitates else 0.25) * (standing - optimum), gaps


def test_rollouts_of_a_policy_are_the_tasks_dynamics_under_its_noise():
    work = Workspace(ROTOR, search_settings(ROTOR), 5, solver(ROTOR))
    policy = work.first_policy()
    before = work.simulator_steps
    (rollouts,) = work.sample_policy(policy, 40, k=2)
    assert work.simulator_steps - before == 40 * ROTOR.horizon
    for n in range(3):
        for t in range(ROTOR.horizon - 1):
            # The network that drives compiled is not that of the drawn controls, to the last bit.
            following = ROTOR.dynamics.step(rollouts.states[n, t], rollouts.controls[n, t])
            np.testing.assert_allclose(rollouts.states[n, t + 1], following, rtol=1e-12)
    noise = rollouts.controls - policy.mean(ROTOR.observation(rollouts.states))
    expected = policy.noise_std / np.sqrt(2 * noise.size)
    assert abs(noise.std() - policy.noise_std[0]) < 5 * expected[0]
    np.testing.assert_allclose(rollouts.costs, ROTOR.cost(rollouts.states, rollouts.controls))


def test_a_fallen_robot_costs_what_lying_still_does():
    walker = dataclasses.replace(make_task("walker"), horizon=120, lookahead=0)
    settings = dataclasses.replace(search_settings(walker), initial_ddp_iterations=1)
    work = Workspace(walker, settings, 0, solver(walker))
    rng = np.random.default_rng(0)
    rollouts = work.roll_out(0, 3, rng, lambda t, x: np.zeros((3, 6)))
    fallen = walker.fallen(rollouts.states)
    assert fallen[:, -1].all()
    first = fallen.argmax(axis=1)
    for n in range(3):
        assert_array_equal(rollouts.costs[n, first[n] :], 1.0 + 0.93**2)
        upright = walker.cost(rollouts.states[n], rollouts.controls[n])[: first[n]]
        assert_array_equal(rollouts.costs[n, : first[n]], upright)


def test_an_unknown_method_names_the_valid_ones():
    with pytest.raises(InvalidInputError, match="method is 'ppo', but it must be one of adapt"):
        run("ppo", ROTOR)


def test_guided_search_says_when_there_is_nothing_to_learn_from():
    with pytest.raises(DivergenceError, match=r"lower gps\.guiding_noise"):
        combine_rollouts([], ROTOR.observation)
