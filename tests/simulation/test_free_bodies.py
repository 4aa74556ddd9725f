# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives, marginals and policies of a robot with a free base, a ball and activations."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from scipy.special import erf

from tests.simulation.robots import everything, random_states
from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.ddp.mean_derivatives import mean_derivatives
from vgps_ros.core.marginals import Spread, state_covariances
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.records import Trajectory, TrajectoryDistribution
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.readings import Readings

MODEL = everything()
# A body in space with thrusters: its orientation is a quaternion, and nothing else is nonlinear.
SATELLITE = """
<mujoco>
  <option timestep="0.01" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="body">
      <freejoint name="body"/>
      <geom type="box" size=".3 .2 .1" mass="2"/>
      <site name="thrusters"/>
    </body>
  </worldbody>
  <actuator>
    <motor site="thrusters" gear="1 0 0 0 0 0"/>
    <motor site="thrusters" gear="0 1 0 .2 0 0"/>
    <motor site="thrusters" gear="0 0 1 0 .2 .1"/>
  </actuator>
</mujoco>
"""


@pytest.fixture
def points(rng):
    """Unrelated states and controls, as a trajectory."""
    return Trajectory(random_states(MODEL, rng, 13), rng.uniform(-1, 1, (12, MODEL.nu)))


def test_a_rollout_stays_short_of_the_dynamics_by_its_gaps(points, rng):
    dynamics = Dynamics(MODEL)
    gaps = 0.1 * rng.standard_normal((12, dynamics.space.tangent_dim))
    gains = np.zeros((12, MODEL.nu, dynamics.space.tangent_dim))
    nominals, start = [points, points], points.states[0]
    short, closed = dynamics.follow_each(start, nominals, gains, [gaps, None])
    assert_allclose(dynamics.gaps(short), gaps, atol=1e-9)
    assert_allclose(dynamics.gaps(closed), 0.0, atol=1e-9)


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler", "RK4"])
def test_a_step_is_the_simulators(points, integrator):
    model = everything()
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    data = mujoco.MjData(model)
    dynamics = Dynamics(model, substeps=3)
    for x, u in zip(points.states, points.controls, strict=False):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel, data.act = np.split(x, [model.nq, model.nq + model.nv])
        data.ctrl = u
        mujoco.mj_step(model, data, 3)
        assert_array_equal(dynamics.step(x, u), np.r_[data.qpos, data.qvel, data.act])


@pytest.mark.parametrize("substeps", [1, 3])
def test_derivatives_are_the_simulators_centred_differences(points, substeps):
    dynamics, data = Dynamics(MODEL, substeps=substeps), mujoco.MjData(MODEL)
    linear, _ = dynamics.linearize(points)
    n_dx, errors = dynamics.space.tangent_dim, []
    for t, (x, u) in enumerate(zip(points.states, points.controls, strict=False)):
        data.qpos, data.qvel, data.act = np.split(x, [MODEL.nq, MODEL.nq + MODEL.nv])
        data.ctrl, data.qacc_warmstart = u, 0.0
        f_x, f_u = np.eye(n_dx), np.zeros((n_dx, MODEL.nu))
        a, b = np.zeros((n_dx, n_dx)), np.zeros((n_dx, MODEL.nu))
        for substep in range(substeps):
            if substep:
                mujoco.mj_step(MODEL, data)
            mujoco.mjd_transitionFD(MODEL, data, 1e-6, True, a, b, None, None)
            f_x, f_u = a @ f_x, a @ f_u + b
        expected = np.hstack([f_x, f_u])
        found = np.hstack([linear.f_x[t], linear.f_u[t]])
        errors.append(np.abs(found - expected).max() / np.abs(expected).max())
    assert np.quantile(errors, 0.9) < 1e-4


def test_with_the_runge_kutta_method_no_stage_is_taken_over(points):
    """Differences of steps; MuJoCo's own derivatives do not know this method."""
    model = everything()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    dynamics = Dynamics(model)
    linear, _ = dynamics.linearize(points)
    x, u, space = points.states[0], points.controls[0], dynamics.space
    f_x = np.empty_like(linear.f_x[0])
    for i, direction in enumerate(1e-6 * np.eye(space.tangent_dim)):
        plus, minus = (dynamics.step(space.add(x, s * direction), u) for s in (1, -1))
        f_x[:, i] = space.subtract(plus, minus) / 2e-6
    assert_allclose(linear.f_x[0], f_x, rtol=0, atol=1e-5 * np.abs(f_x).max())


def test_marginals_are_those_of_closed_loop_samples_of_a_free_body(rng):
    dynamics = Dynamics(mujoco.MjModel.from_xml_string(SATELLITE))
    space, horizon, count = dynamics.space, 6, 80_000
    start = np.r_[0.1, 0.2, 0.3, 0.5, -0.5, 0.5, 0.5, rng.uniform(-1, 1, 6)]
    gains = rng.uniform(-0.5, 0.5, (horizon, 3, 12))
    controls = rng.uniform(-2, 2, (horizon, 3))
    mean = dynamics.rollout(start, lambda t, _: controls[t], horizon)
    noise = np.full((horizon, 3), 0.3)
    spread = Spread(np.repeat([0.02, 0.02], 6), np.zeros(12), np.full(12, np.inf))
    expected = state_covariances(
        dynamics.linearize(mean)[0], gains, noise[..., None] ** 2 * np.eye(3), spread
    )

    def law(t, x):
        deviations = space.subtract(x, mean.states[t])
        draws = noise[t] * rng.standard_normal((count, 3))
        return mean.controls[t] + deviations @ gains[t].T + draws

    starts = space.add(start, spread.initial_std * rng.standard_normal((count, 12)))
    states, _, _ = dynamics.rollouts(starts, law, horizon)
    for t in range(horizon + 1):
        deviations = space.subtract(states[:, t], mean.states[t])
        sampled = deviations.T @ deviations / count
        std = np.sqrt(np.diagonal(expected[t]))
        assert_allclose(sampled / np.outer(std, std), expected[t] / np.outer(std, std), atol=0.02)


def test_mean_derivatives_over_rotations_are_those_of_the_mean_thrust():
    """Rolled by φ of N(0, s²), a thrust along z changes by E[cos φ] as it rolls on.

    As it pitches, it changes by E[sin φ / φ], since exp(d + δ) = exp(d) exp(J δ) with SO(3)'s right
    Jacobian J at d. These are e^(−s²/2) and ∫ e^(−t²s²/2) dt over t from 0 to 1, in every frame.
    """
    dynamics, s, thrust = Dynamics(mujoco.MjModel.from_xml_string(SATELLITE)), 0.8, 3.0
    start = np.r_[0.1, 0.2, 0.3, 0.5, -0.5, 0.5, 0.5, np.zeros(6)]
    mean = dynamics.rollout(start, lambda *_: np.array([0.0, 0.0, thrust]), 1)
    spread = np.zeros((2, 12, 12))
    spread[:, 3, 3] = s**2
    gains, noise = np.zeros((1, 3, 12)), np.zeros((1, 3, 3))
    q = TrajectoryDistribution(
        mean, gains, noise, dynamics.linearize(mean)[0], spread, np.empty((1, 0))
    )
    found, _ = mean_derivatives(dynamics, q, 2000, 1.0, np.random.default_rng(0))
    change = thrust / 2 * dynamics.time_step  # of velocity, in its own frame
    rolled, pitched = np.exp(-(s**2) / 2), np.sqrt(np.pi / 2) / s * erf(s / np.sqrt(2))
    across = change * np.array([[0, pitched, 0], [-rolled, 0, 0], [0, 0, 0]])
    turned = Rotation.from_quat(start[3:7], scalar_first=True).as_matrix()
    assert_allclose(found.f_x[0, 6:9, 3:6], turned @ across, atol=0.015 * change)


def test_policy_derivatives_go_through_sensors(points, rng):
    """Against centred differences of the cost on the tangent space."""
    dynamics = Dynamics(MODEL)
    names = ["hip/position", "knee/sin", "tail/wx", "up/x", "up/y", "gyro/z", "speed/x"]
    space, n_u = dynamics.space, MODEL.nu
    architecture = Architecture(tuple(names), (4,), n_u)
    policy = GaussianPolicy(
        architecture, rng.standard_normal(architecture.num_parameters), rng.uniform(0.5, 2, n_u)
    )
    observation = Observation(Readings(dynamics.simulations, names))
    state_cost = FeatureCost(
        Readings(dynamics.simulations, ["velocity/x", "centre/z", "hip/position"]),
        targets=rng.standard_normal((12, 3)),
        weights=rng.uniform(0, 1, (12, 3)),
        smooth=np.array([0.0, 0.3, 0.0]),
        control_weights=rng.uniform(0, 1, n_u),
    )
    deviations = 0.3 * rng.standard_normal((3, 12, space.tangent_dim))
    gains = rng.standard_normal((12, n_u, space.tangent_dim))
    cost = PolicyCost(ScaledCost(state_cost, 0.7), policy, observation, deviations, gains)
    expansion = cost.expand(points)
    assert_allclose(expansion.c, cost.values(points), rtol=1e-12)
    differences = np.empty_like(expansion.c_x)
    for i, direction in enumerate(1e-6 * np.eye(space.tangent_dim)):
        plus, minus = (
            cost.values(Trajectory(_moved(space, points.states, s * direction), points.controls))
            for s in (1, -1)
        )
        differences[:, i] = (plus - minus) / 2e-6
    scale = np.abs(differences).max()
    assert_allclose(expansion.c_x, differences, rtol=0, atol=1e-5 * scale)


def _moved(space, states, direction):
    return space.add(states, np.broadcast_to(direction, (len(states), space.tangent_dim)))
