# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plans by sampling, against functions whose least value is known."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.records import Trajectory
from vgps_ros.tasks.sampled_motion import Sampler, interpolation, receding_motion

BOUND = np.full(2, 3.0)


def sampler(**changes):
    """A sampler of two controls over nine steps."""
    plain = Sampler(9, 3, 32, 1, np.ones(2), -BOUND, BOUND)
    return dataclasses.replace(plain, **changes)


def test_splines_are_linear_between_knots_and_meet_them():
    values = interpolation(9, 3) @ np.array([1.0, 3.0, -1.0])
    assert_allclose(values, [1.0, 1.5, 2.0, 2.5, 3.0, 2.0, 1.0, 0.0, -1.0])
    assert_allclose(interpolation(10, 4).sum(axis=1), 1.0)
    assert_allclose(interpolation(7, 4) @ np.linspace(2, 5, 4), np.linspace(2, 5, 7))


def test_samples_find_the_least_value_of_a_quadratic_among_splines(rng):
    target = interpolation(9, 3) @ rng.uniform(-2, 2, (3, 2))
    planner = sampler(iterations=60, samples=64)
    plan, least = planner.improved(
        np.zeros((9, 2)), lambda plans: ((plans - target) ** 2).sum(axis=(1, 2)), rng
    )
    assert least == pytest.approx(((plan - target) ** 2).sum())
    assert least < 0.01 * (target**2).sum()


def test_a_plan_is_never_worse_than_the_one_given_and_stays_in_its_limits(rng):
    plan, seen = np.clip(rng.standard_normal((9, 2)), -BOUND, BOUND), []

    def cost(plans):
        seen.append(plans)
        return -plans.sum(axis=(1, 2))  # the more the better

    found, least = sampler(iterations=20).improved(plan, cost, rng)
    assert_array_equal(seen[0][0], plan)
    assert least <= -plan.sum()
    assert np.abs(seen).max() <= 3.0
    assert found.mean() > plan.mean() + 1.0


def test_the_second_set_is_drawn_around_the_best():
    seen, plan = [], np.linspace(-1.0, 1.0, 18).reshape(9, 2)
    planner = sampler(iterations=2, std=np.array([0.5, 0.01]))

    def cost(plans):
        seen.append(plans)
        return (plans**2).sum(axis=(1, 2))

    planner.improved(plan, cost, np.random.default_rng(3))
    rng, spline = np.random.default_rng(3), interpolation(9, 3)
    std = planner.std * np.geomspace(1.0, 0.1, 32)[:, None, None]
    noises = [rng.standard_normal((32, 3, 2)) for _ in range(2)]
    for noise in noises:
        noise[0] = 0.0
    first = plan + spline @ (noises[0] * std)
    assert_allclose(seen[0], first)
    centre = first[np.argmin((first**2).sum(axis=(1, 2)))]
    assert_allclose(seen[1], centre + spline @ (noises[1] * std))


def test_plans_that_diverge_are_not_taken(rng):
    def cost(plans):
        return np.where(plans[:, 0, 0] > 0.0, np.inf, plans[:, 0, 0] ** 2)

    plan, least = sampler().improved(np.full((9, 2), -1.0), cost, rng)
    assert plan[0, 0] <= 0.0
    assert np.isfinite(least)


class Integrator:
    """Two coordinates, x' = x + 0.5 u, with the cost Σ ‖x'‖² + 0.1 ‖u‖²; its plans end at rest."""

    def simulate(self, start, plans):
        moved = start + 0.5 * np.cumsum(plans, axis=1)
        starts = np.broadcast_to(start, (len(plans), 1, 2))
        return np.concatenate([starts, moved], axis=1)

    def score(self, states, plans, first):
        del first
        return (states[:, 1:] ** 2).sum(axis=(1, 2)) + 0.1 * (plans**2).sum(axis=(1, 2))

    def refine(self, motion, first):
        del first
        return motion.controls


class Refined(Integrator):
    """The same, whose plans are refined to the exact ones."""

    def refine(self, motion, first):
        del first
        return exact(motion.states[0], len(motion.controls))


def exact(start, steps):
    """The best controls, by least squares over all steps at once."""
    sums = 0.5 * np.tril(np.ones((steps, steps)))
    stacked = np.concatenate([sums, np.sqrt(0.1) * np.eye(steps)])
    right = np.concatenate([np.tile(-start, (steps, 1)), np.zeros((steps, 2))])
    return np.linalg.lstsq(stacked, right, rcond=None)[0]


def total(motion):
    return Integrator().score(motion.states[None], motion.controls[None], 0)[0]


@pytest.mark.parametrize(("problem", "above"), [(Integrator(), 0.2), (Refined(), 0.002)])
def test_a_receding_horizon_solves_a_linear_quadratic_problem(problem, above, rng):
    start = np.array([2.0, -1.0])
    planner = sampler(knots=9, samples=64, iterations=40)
    motion = receding_motion(problem, planner, start, 20, 2, rng)
    best = exact(start, 20)
    least = total(Trajectory(problem.simulate(start, best[None])[0], best))
    assert motion.states.shape == (21, 2)
    assert_allclose(motion.states, problem.simulate(start, motion.controls[None])[0], atol=1e-12)
    assert (1 - 1e-12) * least <= total(motion) < (1 + above) * least


class Worsened(Integrator):
    """The same, whose refined plans cost more, and which notes the places of its plans."""

    def __init__(self):
        self.places = []

    def score(self, states, plans, first):
        self.places.append(first)
        return super().score(states, plans, first)

    def refine(self, motion, first):
        self.places.append(first)
        return motion.controls + 1.0


def test_a_refined_plan_that_costs_more_is_left_and_each_plan_knows_its_place():
    problem, start = Worsened(), np.array([2.0, -1.0])
    motions = [
        receding_motion(p, sampler(), start, 7, 3, np.random.default_rng(1))
        for p in (problem, Integrator())
    ]
    assert_array_equal(motions[0].controls, motions[1].controls)
    assert problem.places == [0, 0, 0, 3, 3, 3, 6, 6, 6]


def test_a_motion_begins_with_the_least_torques_that_its_limits_allow(rng):
    planner = sampler(low=np.array([0.5, -3.0]), high=np.array([3.0, -1.0]))
    motion = receding_motion(
        *(Integrator(), planner, np.ones(2), 7, 3, rng), is_cancelled=lambda: True
    )
    assert_array_equal(motion.controls, np.tile([0.5, -1.0], (7, 1)))


def test_the_same_seed_gives_the_same_motion_and_progress_ends_at_one():
    shares = []
    motions = [
        receding_motion(
            *(Integrator(), sampler(), np.ones(2), 7, 3, np.random.default_rng(seed)),
            on_progress=shares.append,
        )
        for seed in (1, 1, 2)
    ]
    assert_array_equal(motions[0].controls, motions[1].controls)
    assert (motions[0].controls != motions[2].controls).any()
    assert shares[:3] == [3 / 7, 6 / 7, 1.0]


def test_a_cancelled_motion_is_whole_without_more_samples(rng):
    motion = receding_motion(
        *(Integrator(), sampler(), np.ones(2), 7, 3, rng), is_cancelled=lambda: True
    )
    assert_array_equal(motion.controls, np.zeros((7, 2)))
