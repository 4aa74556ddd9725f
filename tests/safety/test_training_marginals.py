# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Distance from the training, and the feedback law at the nearest step."""

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.motors import motors
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import Observation
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import safe_control
from vgps_ros.safety.training_marginals import TrainingMarginals, nearest_of
from vgps_ros.simulation.readings import Readings

MOTORS, ZERO = motors(1e9, 1e9), np.zeros(2)
OBSERVED = (1, 2, 3)  # of four: root x does not count


@pytest.fixture
def distribution(random_distribution):
    return random_distribution(horizon=6, n_x=4, n_u=2)


@pytest.fixture
def observation(coordinates):
    return coordinates(*OBSERVED)


@pytest.fixture
def marginals(distribution, observation):
    return TrainingMarginals(distribution, observation, 2)


def plain_distances(q, state):
    """√(δᵀ Σ⁻¹ δ) for each step, by solving with each matrix."""
    distances = []
    for mean, covariance in zip(q.mean.states[:-1], q.state_covariances[:-1], strict=True):
        deviation = (state - mean)[list(OBSERVED)]
        wide = covariance[np.ix_(OBSERVED, OBSERVED)] + 1e-4 * np.eye(3)
        distances.append(np.sqrt(deviation @ np.linalg.solve(wide, deviation)))
    return distances


def test_the_distance_is_mahalanobis_from_the_nearest_step(marginals, distribution, rng):
    for state in 3.0 * rng.standard_normal((20, 4)):
        expected = plain_distances(distribution, state)
        found = marginals.nearest(state)
        assert found.step == np.argmin(expected)
        assert found.distance == pytest.approx(min(expected), rel=1e-9)


def test_on_the_trajectory_it_is_zero_wherever_the_root_is(marginals, distribution):
    for step, state in enumerate(distribution.mean.states[:-1]):
        moved = state + np.array([1e3, 0.0, 0.0, 0.0])
        assert marginals.nearest(moved).distance == pytest.approx(0.0, abs=1e-9)
        assert marginals.nearest(moved).step == step


def test_the_nearest_of_several_distributions_counts(marginals, distribution, observation):
    mean = dataclasses.replace(distribution.mean, states=distribution.mean.states + 50.0)
    far = TrainingMarginals(dataclasses.replace(distribution, mean=mean), observation, 2)
    found = nearest_of([marginals, far], mean.states[3])
    assert found.marginals is far
    assert found.step == 3
    assert nearest_of([], mean.states[3]) is None


def test_feedback_is_the_ddp_law_and_the_roots_place_makes_no_torque(marginals, distribution, rng):
    q, step = distribution, 4
    state = q.mean.states[step] + 0.01 * rng.standard_normal(4)
    deviation = state - q.mean.states[step]
    deviation[0] = 0.0
    expected = q.mean.controls[step] + q.gains[step] @ deviation
    safety = SafetySettings(safe_action="feedback")
    for root in (0.0, 1e3):
        moved = state + np.array([root, 0.0, 0.0, 0.0])
        found = safe_control(safety, moved, MOTORS, ZERO, [marginals])
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_sensors_count_as_they_change_with_the_state(random_distribution, swimmer, rng):
    """A velocity's differences along root x are zero but for rounding."""
    q = random_distribution(horizon=5, n_x=10, n_u=2)
    observation = Readings(swimmer.dynamics.simulations, ["velocity/x", "front_joint/position"])
    marginals = TrainingMarginals(q, Observation(observation), 2)
    state = q.mean.states[3] + 0.1 * rng.standard_normal(10)
    distances = []
    for mean, covariance in zip(q.mean.states[:-1], q.state_covariances[:-1], strict=True):
        deviation = observation(state) - observation(mean)
        h_x = observation.linearize(mean)[1]
        wide = h_x @ covariance @ h_x.T + 1e-4 * np.eye(2)
        distances.append(np.sqrt(deviation @ np.linalg.solve(wide, deviation)))
    found = marginals.nearest(state)
    assert found.distance == pytest.approx(min(distances), rel=1e-9)
    assert found.step == np.argmin(distances)
    deviation = state - q.mean.states[found.step]
    deviation[[0, 1, 6]] = 0.0  # root x, root y and its rate do not change what is read
    expected = q.mean.controls[found.step] + q.gains[found.step] @ deviation
    for root in (0.0, 1e3):
        moved = state + root * np.eye(10)[0]
        np.testing.assert_allclose(marginals.feedback(moved, found.step), expected, rtol=1e-9)


def test_damping_brakes_the_joints_that_the_controls_drive():
    safety = SafetySettings(safe_action="damping", damping=3.0)
    state = np.array([9.0, 9.0, -2.0, 4.0])
    np.testing.assert_array_equal(safe_control(safety, state, MOTORS, ZERO, []), [6.0, -12.0])


@pytest.mark.parametrize("action", ["zero", "damping", "feedback"])
def test_without_what_it_needs_the_safe_action_is_zero(action):
    safety = SafetySettings(safe_action=action)
    for state in (None, np.zeros(4)):
        np.testing.assert_array_equal(safe_control(safety, state, MOTORS, ZERO, []), ZERO)


FINITE = arrays(float, 4, elements=st.floats(allow_nan=False, allow_infinity=False))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(state=FINITE, action=st.sampled_from(["zero", "damping", "feedback"]))
def test_no_finite_state_makes_a_torque_that_is_not_finite(marginals, state, action):
    safety = SafetySettings(safe_action=action, damping=1e6)
    found = safe_control(safety, state, MOTORS, ZERO, [marginals])
    assert np.isfinite(found).all()


def test_what_is_no_distribution_of_the_robot_is_refused(distribution, observation, coordinates):
    with pytest.raises(InvalidInputError, match="states has shape"):
        TrainingMarginals(distribution, coordinates(*OBSERVED, n_x=5), 2)
    with pytest.raises(InvalidInputError, match="controls has shape"):
        TrainingMarginals(distribution, observation, 3)
    with pytest.raises(InvalidInputError, match="has no steps"):
        TrainingMarginals(distribution.first(0), observation, 2)
    negative = dataclasses.replace(distribution, state_covariances=-distribution.state_covariances)
    with pytest.raises(InvalidInputError, match="not positive semidefinite"):
        TrainingMarginals(negative, observation, 2)
