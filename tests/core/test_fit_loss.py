# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The loss of the M-step and its derivatives, against the network that robots execute."""

import dataclasses
import subprocess
import sys
from itertools import repeat

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from vgps_ros.core.fit_loss import FitLoss, minimize_gauss_newton
from vgps_ros.core.policy import ACTIVATIONS, Architecture, GaussianPolicy
from vgps_ros.core.policy_network import minimize_lbfgs

SHAPES = [(), (4,), (4, 3)]


@pytest.fixture
def drawn(rng):
    """A function that draws a network, N samples for it, and their loss."""

    def draw(hidden_units, *, activation="softplus", bias=True, count=40, inputs=3, outputs=2):
        names = tuple(f"x{i}" for i in range(inputs))
        architecture = Architecture(names, hidden_units, outputs, activation, bias, bias)
        parameters = 0.5 * rng.standard_normal(architecture.num_parameters)
        policy = GaussianPolicy(architecture, parameters, np.ones(outputs))
        columns = (rng.standard_normal((n, count)) for n in (inputs, outputs))
        constants = np.full(outputs, 0.3), np.full(outputs, 1e-6)
        return policy, FitLoss(architecture, *map(torch.from_numpy, (*columns, *constants)))

    return draw


def outputs(policy, parameters, loss):
    """The policy's own forward pass, shape (n_u, N)."""
    return dataclasses.replace(policy, parameters=parameters).mean(loss.inputs.numpy().T).T


def jacobian(policy, loss):
    """∂μ/∂θ by centred differences, shape (n_u, N, num_parameters)."""
    steps = 1e-6 * np.eye(len(policy.parameters))
    ahead, behind = (
        np.stack([outputs(policy, policy.parameters + sign * s, loss) for s in steps], axis=-1)
        for sign in (1, -1)
    )
    return (ahead - behind) / 2e-6


@pytest.mark.parametrize("hidden_units", SHAPES)
@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("bias", [True, False])
def test_loss_gradient_and_curvature_are_those_of_the_executed_network(
    drawn, rng, hidden_units, activation, bias
):
    policy, loss = drawn(hidden_units, activation=activation, bias=bias)
    residuals = outputs(policy, policy.parameters, loss) - loss.targets.numpy()
    v, j = (residuals**2).mean(axis=1) + 0.3, jacobian(policy, loss)
    point = loss.at(policy.parameters)
    assert_allclose(point.value, 0.5 * np.log(v).sum(), rtol=1e-12)
    count = residuals.shape[1]
    expected = np.einsum("jnp,jn->p", j, residuals / v[:, None]) / count
    assert_allclose(point.gradient, expected, rtol=1e-6, atol=1e-8)

    curvature = loss.curvature(policy.parameters, point.weights)
    dense = np.einsum("jnp,j,jnq->pq", j, 1 / v, j) / count
    step = rng.standard_normal(len(expected))
    assert_allclose(curvature.times(step), dense @ step, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("hidden_units", SHAPES)
@pytest.mark.parametrize("bias", [True, False])
def test_steps_solve_the_damped_equations(drawn, hidden_units, bias):
    policy, loss = drawn(hidden_units, bias=bias)
    point, damping = loss.at(policy.parameters), 0.1
    curvature = loss.curvature(policy.parameters, point.weights)
    step = curvature.solve(point.gradient, damping, 1000)
    # The damping is λ times a mean diagonal, which is found from the step itself.
    left = -point.gradient - curvature.times(step)
    scale = left @ step / (step @ step) / damping
    assert scale > 0
    error = np.linalg.norm(left - damping * scale * step)
    assert error < 0.02 * np.linalg.norm(point.gradient)


def test_a_linear_policy_takes_few_steps(drawn):
    """Its loss is quadratic but for the weights of the controls, and the factors are exact."""
    policy, loss = drawn((), count=5000, inputs=6)
    assert loss.value(policy.parameters) == loss.at(policy.parameters).value
    found = minimize_gauss_newton(policy.parameters, repeat(loss), 10, 0.0)
    columns = np.vstack([loss.inputs.numpy(), np.ones(5000)]).T
    best = np.linalg.lstsq(columns, loss.targets.numpy().T, rcond=None)[0]
    weight, bias = policy.architecture.unpack(found)[0]
    assert_allclose(np.column_stack([weight, bias]), best.T, atol=1e-5)


@pytest.fixture
def taught(drawn, rng):
    """A start near a teacher, and a function that draws losses of samples of that teacher."""
    teacher = drawn((8, 8), inputs=5)[0]

    def draw(count):
        loss = drawn((8, 8), count=count, inputs=5)[1]
        noise = 0.1 * torch.from_numpy(rng.standard_normal((2, count)))
        targets = torch.from_numpy(outputs(teacher, teacher.parameters, loss)) + noise
        return dataclasses.replace(loss, targets=targets)

    return teacher.parameters + 0.1 * rng.standard_normal(len(teacher.parameters)), draw


def test_steps_are_worth_many_of_lbfgs(taught):
    start, draw = taught
    loss = draw(2000)
    ours = minimize_gauss_newton(start, repeat(loss), 10, 0.0)
    theirs = minimize_lbfgs(start, loss.value_and_gradient, 50)
    assert loss.value(ours) < loss.value(theirs) < loss.value(start)


def test_a_fit_ends_once_new_samples_gain_nothing(taught):
    start, draw = taught
    losses = [draw(100) for _ in range(50)]
    drawn = iter(losses)
    found = minimize_gauss_newton(start, drawn, 50, 1e-3)
    left, unseen = len(list(drawn)), draw(20_000)
    assert 0 < left < 50
    longer = minimize_gauss_newton(start, repeat(losses[0]), 50, 0.0)
    assert losses[0].value(longer) < losses[0].value(found)
    assert unseen.value(found) < unseen.value(longer) < unseen.value(start)


def test_a_control_of_least_noise_bends_no_parameter(drawn):
    """Its residuals are below what the noise can tell, so only the other control counts."""
    policy, loss = drawn((4,))
    least = torch.tensor([1e9, 1e-6], dtype=torch.float64)
    point = dataclasses.replace(loss, least=least).at(policy.parameters)
    alone = policy.architecture.unpack(point.gradient)[-1][0]
    assert (alone[0] == 0).all()
    assert (alone[1] != 0).all()
    assert point.weights[0] == 0


def test_shorter_steps_gain_where_few_samples_mislead(taught):
    start, draw = taught
    losses, unseen = [draw(20) for _ in range(50)], draw(20_000)
    values = [
        unseen.value(minimize_gauss_newton(start, iter(losses), 50, 1e-5, retries))
        for retries in (0, 3)
    ]
    assert values[1] < values[0] - 0.05


@pytest.mark.parametrize("hidden_units", [(), (64, 64)])
def test_blocks_of_samples_change_no_sum(drawn, rng, hidden_units):
    """Of the wide network's 40,000 samples there are 23 blocks, and of its curvature's 4."""
    policy, loss = drawn(hidden_units, inputs=5, count=40_000)
    point = loss.at(policy.parameters)
    thousands = [
        dataclasses.replace(loss, inputs=inputs, targets=targets)
        for inputs, targets in zip(
            loss.inputs.split(1000, dim=1), loss.targets.split(1000, dim=1), strict=True
        )
    ]
    passes = [outputs(policy, policy.parameters, each) for each in thousands]
    errors = [p - each.targets.numpy() for p, each in zip(passes, thousands, strict=True)]
    v = np.mean([(e**2).mean(axis=1) for e in errors], axis=0) + 0.3
    assert_allclose(point.value, 0.5 * np.log(v).sum(), rtol=1e-12)
    # A mean with the whole's weights is a gradient of ½ Σ E[r²] / v, whose gradients add up.
    step = 1e-6 * rng.standard_normal(len(point.gradient))
    ahead, behind = (loss.value(policy.parameters + sign * step) for sign in (1, -1))
    assert_allclose(point.gradient @ step, (ahead - behind) / 2, rtol=1e-6)
    curvature = loss.curvature(policy.parameters, point.weights)
    part = dataclasses.replace(
        loss, inputs=loss.inputs[:, ::7].contiguous(), targets=loss.targets[:, ::7].contiguous()
    )
    changed = (
        outputs(policy, policy.parameters + step, part)
        - outputs(policy, policy.parameters - step, part)
    ) / 2
    expected = (changed**2 / v[:, None]).sum() / part.inputs.shape[1]
    assert_allclose(step @ curvature.times(step), expected, rtol=1e-6)


FIT = """
import os, sys
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: int(sys.argv[1])])
from itertools import repeat
import numpy as np, torch
from vgps_ros.core.fit_loss import FitLoss, minimize_gauss_newton
from vgps_ros.core.policy import Architecture
rng = np.random.default_rng(0)
shape = Architecture(("a", "b", "c"), (64, 64), 2)
columns = [torch.from_numpy(rng.standard_normal((n, 10_000))) for n in (3, 2)]
loss = FitLoss(shape, *columns, torch.full((2,), 0.3), torch.full((2,), 1e-6))
start = 0.1 * rng.standard_normal(shape.num_parameters)
print(minimize_gauss_newton(start, repeat(loss), 3, 0.0).tobytes().hex())
"""


def test_a_fit_has_the_same_bits_on_any_number_of_cores():
    found = [
        subprocess.run(
            [sys.executable, "-c", FIT, cores], capture_output=True, text=True, check=True
        ).stdout
        for cores in ("1", "2")
    ]
    assert found[0] == found[1] != ""
