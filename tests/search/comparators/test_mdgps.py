# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Mirror descent guided policy search, beside closed forms of the rotor and a Riccati recursion."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.settings import with_values
from vgps_ros.search.comparators import mdgps
from vgps_ros.search.comparators.bounded_step import LinearPolicy, divergence
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.search.workspace import Workspace
from vgps_ros.tasks import make_task

# Its dynamics are linear and its cost is quadratic, so that the optimum is that of a regulator.
ROTOR = dataclasses.replace(make_task("rotor"), std_limit=np.full(2, np.inf))
PLAIN = {"iterations": 12, "hidden_units": (3,), "evaluation_rollouts": 4, "policy_rollouts": 8}


def run(seed=5, task=ROTOR, wrap=lambda solve: solve, **settings):
    values = {name.replace("__", "."): value for name, value in settings.items()}
    chosen = with_values(search_settings(task), {**PLAIN, **values})
    return list(search("mdgps", task, chosen, seed, wrap(partial(optimize_all, task))))


def regulator():
    """Returns the gains of the rotor's optimal law u = K x, and its cost from the start."""
    motion = ROTOR.dynamics.rollout(ROTOR.initial_state, lambda *_: np.zeros(1), ROTOR.horizon)
    linear, _ = ROTOR.dynamics.linearize(motion)
    e = ROTOR.cost.expand(motion)
    v, gains = np.zeros((2, 2)), []
    for t in reversed(range(ROTOR.horizon)):
        a, b = linear.f_x[t], linear.f_u[t]
        k = -np.linalg.solve(e.c_uu[t] + b.T @ v @ b, e.c_ux[t] + b.T @ v @ a)
        v = e.c_xx[t] + a.T @ v @ a + (e.c_ux[t] + b.T @ v @ a).T @ k
        gains.insert(0, k)
    return np.array(gains), 0.5 * ROTOR.initial_state @ v @ ROTOR.initial_state


@pytest.mark.parametrize("objective", ["average", "likelihood"])
@pytest.mark.parametrize("dynamics", ["model", "fitted"])
def test_local_and_global_policies_end_at_the_regulator_of_the_rotor(dynamics, objective):
    gains, optimum = regulator()
    last = run(mirror__dynamics=dynamics, mirror__objective=objective)[-1]
    q = last.solutions[0].distribution
    assert_allclose(ROTOR.trajectory_cost(q.mean), optimum, rtol=0.01)
    assert_allclose(last.deterministic_cost, optimum, rtol=0.01)
    # While the rotor is still moving, both do in each state what the regulator does.
    early = slice(0, ROTOR.horizon // 2)
    states = q.mean.states[:-1][early]
    wanted = np.einsum("tux,tx->tu", gains[early], states)
    scale = np.abs(wanted).max()
    assert_allclose(q.mean.controls[early], wanted, atol=0.05 * scale)
    assert_allclose(last.policy.mean(ROTOR.observation(states)), wanted, atol=0.1 * scale)


def test_without_a_model_only_rollouts_touch_the_simulator_and_all_are_counted():
    def refuse(requests):
        raise AssertionError("a solve uses the model's derivatives")

    iterations = run(
        mirror__dynamics="fitted", mirror__first_steps=4, wrap=lambda _: refuse, iterations=3
    )
    one = ROTOR.horizon * ROTOR.dynamics.substeps
    # The first motion, its rollouts, four steps, and each iteration after the first fit.
    assert [i.simulator_steps for i in iterations] == [one * (1 + 8 * n) for n in (5, 6, 7)]


@pytest.mark.parametrize("objective", ["average", "likelihood"])
def test_each_step_keeps_its_bound(monkeypatch, objective):
    """The divergence is that of q and of what it must stay near, by the marginals of q."""
    found = []

    def kept(linear, cost, near, start, spread, bound, entropy=0.0):
        step = original(linear, cost, near, start, spread, bound, entropy)
        kl = divergence(step.policy, near, step.means, step.state_covariances)
        found.append((kl, bound, entropy))
        return step

    original = mdgps.bounded_step
    monkeypatch.setattr(mdgps, "bounded_step", kept)
    run(mirror__dynamics="fitted", mirror__objective=objective, iterations=5)
    assert len(found) >= 4
    assert all(kl <= bound + 1e-6 for kl, bound, _ in found)
    # Line 1 has no entropy in either case.
    assert {entropy for *_, entropy in found} == {0.0, float(objective == "likelihood")}


def test_a_linear_network_is_its_own_linearisation(rng):
    shape = Architecture(ROTOR.observation.names, (), 1)
    policy = GaussianPolicy(shape, rng.standard_normal(shape.num_parameters), np.array([0.7]))
    weights, bias = policy.layers[0]
    motion = ROTOR.dynamics.rollout(ROTOR.initial_state, lambda *_: np.ones(1), ROTOR.horizon)
    deviations = rng.standard_normal((5, ROTOR.horizon, 2))
    deviations -= deviations.mean(axis=0)
    scaled, gains = ScaledCost(ROTOR.cost, 0.0), rng.standard_normal((ROTOR.horizon, 1, 2))
    cost = PolicyCost(scaled, policy, ROTOR.observation, deviations, gains)
    near = LinearPolicy.of(cost.expand(motion))
    # The rotor's readings are its state.
    assert_allclose(near.gains, np.tile(weights, (ROTOR.horizon, 1, 1)), rtol=1e-9)
    assert_allclose(near.covariances[:, 0, 0], policy.noise_std[0] ** 2)
    ahead = motion.states[:-1] @ weights.T + bias - motion.controls
    assert_allclose(near.feedforward, ahead, rtol=1e-9, atol=1e-12)


def test_a_situation_whose_rollouts_diverge_keeps_its_q_and_says_so():
    settings = with_values(search_settings(ROTOR), {**PLAIN, "mirror.dynamics": "fitted"})
    work = Workspace(ROTOR, settings, 5, partial(optimize_all, ROTOR), (), mdgps.begin)
    first = mdgps.mdgps(work, None, 1)
    # Controls beyond all measure drive the rotor past what counts as a state.
    wild = dataclasses.replace(first.policy, noise_std=np.array([1e7]))
    work.take_warnings()  # of the first steps
    found = mdgps.mdgps(work, dataclasses.replace(first, policy=wild), 2)
    assert found.solutions == first.solutions
    (warning,) = work.take_warnings()
    assert "Solution 0 of iteration 2 stays as it was: Too few rollouts" in warning
    assert found.policy.noise_std < 10.0  # it learns from q all the same


def test_first_rollouts_that_diverge_end_the_run():
    with pytest.raises(DivergenceError, match=r"lower mirror\.exploration"):
        run(mirror__dynamics="fitted", mirror__exploration=(1e6,))


# A body in space with a motor about each axis, which turns while it comes to rest.
SATELLITE = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.05" gravity="0 0 0"/>
  <worldbody>
    <body name="body" pos="0 0 1">
      <freejoint/>
      <geom type="box" size=".3 .2 .1" mass="1"/>
      <site name="middle"/>
    </body>
  </worldbody>
  <actuator>
    <motor site="middle" gear="0 0 0 1 0 0" ctrlrange="-5 5" ctrllimited="true"/>
    <motor site="middle" gear="0 0 0 0 1 0" ctrlrange="-5 5" ctrllimited="true"/>
    <motor site="middle" gear="0 0 0 0 0 1" ctrlrange="-5 5" ctrllimited="true"/>
  </actuator>
  <keyframe><key name="turned" qpos="0 0 1 .6 .5 -.4 .48" qvel="0 0 0 2 -3 4"/></keyframe>
</mujoco>
"""
TURN = """
model: satellite.xml
control_period: 0.05
horizon: 1.0
start: {keyframe: turned, std: {position: 0.02, velocity: 0.05}}
sensors:
  ahead: {type: framexaxis, xbody: body}
  up: {type: framezaxis, xbody: body}
  spin: {type: gyro, site: middle}
cost:
  - {sensor: ahead, target: [1.0, 0.0, 0.0]}
  - {sensor: up, target: [0.0, 0.0, 1.0]}
  - {sensor: spin, weight: 0.1}
  - {control: all, weight: 0.1}
observe: [ahead, up, spin]
"""


def test_gains_of_a_free_body_are_carried_to_the_frames_of_each_motion(tmp_path, monkeypatch, rng):
    """Near a motion a law is the same one, whichever motion its gains count from."""
    (tmp_path / "satellite.xml").write_text(SATELLITE)
    (tmp_path / "task.yaml").write_text(TURN)
    task = make_task(str(tmp_path / "task.yaml"))
    space, means, steps = task.dynamics.space, [], []

    def kept(found, original):
        def wrapped(*arguments):
            found.append((original(*arguments), arguments))
            return found[-1][0]

        return wrapped

    monkeypatch.setattr(mdgps, "mean_trajectory", kept(means, mdgps.mean_trajectory))
    monkeypatch.setattr(mdgps, "bounded_step", kept(steps, mdgps.bounded_step))
    chosen = {**PLAIN, "mirror.objective": "likelihood", "mirror.kl_bound": 5.0}
    chosen |= {"mirror.dynamics": "fitted", "mirror.exploration": (0.5,), "mirror.first_steps": 1}
    settings = with_values(search_settings(task), chosen)
    work = Workspace(task, settings, 5, partial(optimize_all, task), (), mdgps.begin)
    before = mdgps.mdgps(work, None, 1)
    after = mdgps.mdgps(work, before, 2)
    (around, _), (step, (_, _, near, *_)) = means[-1], steps[-1]

    def changes(law, centre, gains_at, states):
        """Returns the change of a law's controls from one state to a close one, in each step."""
        away = (space.subtract(x, gains_at) for x in (space.add(centre, states), centre))
        near, here = (np.einsum("tux,tx->tu", law, each) for each in away)
        return near - here

    old, new = (each.solutions[0].distribution for each in (before, after))
    for motion, own, origin, first in (
        (new.mean, new.gains, around, step.policy.gains),
        (around, near.gains, old.mean, old.gains),
    ):
        length = len(around.states) - 1
        centres, origins = motion.states[:length], origin.states[:length]
        turned = np.linalg.norm(space.subtract(centres, origins)[:, 3:6], axis=1)
        assert turned.max() > 0.03
        close = 1e-5 * rng.standard_normal((length, space.tangent_dim))
        found = changes(own[:length], centres, centres, close)
        expected = changes(first[:length], centres, origins, close)
        assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
