# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import dataclasses
import itertools

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.policy_network import Passes, Standardization
from vgps_ros.robot.executed_control import ExactMean
from vgps_ros.simulation.compiled_loops import compiled_network, network_output

MODULES = {
    # Beyond the threshold torch returns z; its default of 20 costs 2e-9.
    "softplus": lambda: torch.nn.Softplus(threshold=40),
    "tanh": torch.nn.Tanh,
    "relu": torch.nn.ReLU,
}
every_shape = pytest.mark.parametrize(
    ("hidden_units", "hidden_bias", "output_bias"),
    [
        ((), True, True),
        ((), True, False),
        ((5,), True, True),
        ((5,), False, True),
        ((6, 4), True, False),
        ((6, 4), False, False),
    ],
)


def torch_network(policy):
    """The same network, built of torch's modules, with its parameters filled in order."""
    a = policy.architecture
    sizes, layers = [len(a.observed), *a.hidden_units], []
    for n_in, n_out in itertools.pairwise(sizes):
        layers += [torch.nn.Linear(n_in, n_out, bias=a.hidden_bias), MODULES[a.activation]()]
    layers.append(torch.nn.Linear(sizes[-1], a.control_dim, bias=a.output_bias))
    network = torch.nn.Sequential(*layers).double()
    torch.nn.utils.vector_to_parameters(torch.from_numpy(policy.parameters), network.parameters())
    return network


@every_shape
@pytest.mark.parametrize("activation", sorted(MODULES))
def test_the_network_is_that_of_torch_s_modules_wherever_it_is_written(
    random_policy, rng, hidden_units, hidden_bias, output_bias, activation
):
    """The readable one, the compiled one, and the one that the M-step differentiates."""
    policy = random_policy(
        hidden_units=hidden_units,
        activation=activation,
        hidden_bias=hidden_bias,
        output_bias=output_bias,
    )
    inputs = rng.standard_normal((21, 3))  # beyond 20 torch takes log(1 + exp(z)) to be z
    with torch.no_grad():
        expected = torch_network(policy)(torch.from_numpy(inputs)).numpy()
    compiled, network, (a, z) = [], compiled_network(policy), np.empty((2, 6))
    for each in inputs:
        a[:3] = each
        network_output(network, a, z)
        compiled.append(a[:2].copy())
    exact = ExactMean(policy)
    assert_array_equal([exact(each) for each in inputs], compiled)  # bit for bit
    raw = Standardization(policy.architecture, np.zeros(3), np.ones(3), np.zeros(2), np.ones(2))
    fitted = Passes(policy.architecture, policy.parameters, raw.inputs(inputs)).outputs.numpy().T
    for name, found in (
        ("readable", policy.mean(inputs.reshape(7, 3, 3)).reshape(21, 2)),
        ("compiled", np.array(compiled)),
        ("fitted", fitted),
    ):
        assert_allclose(found, expected, rtol=1e-12, atol=1e-13, err_msg=name)


@every_shape
@pytest.mark.parametrize("activation", sorted(MODULES))
def test_jacobian_agrees_with_finite_differences(
    random_policy, rng, finite_differences, hidden_units, hidden_bias, output_bias, activation
):
    policy = random_policy(
        hidden_units=hidden_units,
        activation=activation,
        hidden_bias=hidden_bias,
        output_bias=output_bias,
    )
    inputs = rng.standard_normal((4, 3))
    mean, jacobian = policy.linearize(inputs)
    assert_array_equal(mean, policy.mean(inputs))
    assert jacobian.shape == (4, 2, 3)
    for each, found in zip(inputs, jacobian, strict=True):
        assert_allclose(found, finite_differences(policy.mean, each), atol=1e-8)


@pytest.mark.parametrize("value", [1e3, -1e3])
def test_activations_keep_their_limits(random_policy, value):
    """log(1 + exp(z)) must neither overflow nor lose its slope."""
    policy = random_policy(observed=("x0",), hidden_units=(1,), control_dim=1)
    policy = dataclasses.replace(policy, parameters=np.array([1.0, 0.0, 1.0, 0.0]))
    mean, jacobian = policy.linearize(np.array([value]))
    assert_allclose(mean, max(value, 0.0), atol=1e-300)
    assert_allclose(jacobian, float(value > 0), atol=1e-300)


@pytest.mark.parametrize(
    ("inputs", "units", "controls", "options", "count"),
    [
        (9, (5,), 2, {}, 62),  # swimmer
        (17, (10,), 6, {}, 246),  # walker, as in the paper
        (9, (5,), 2, {"hidden_bias": False}, 57),
        (9, (5,), 2, {"output_bias": False}, 60),
        (9, (), 2, {}, 20),
        (9, (5, 3), 2, {}, 76),
    ],
)
def test_parameters_are_weights_and_biases(inputs, units, controls, options, count):
    names = tuple(f"x{i}" for i in range(inputs))
    assert Architecture(names, units, controls, **options).num_parameters == count


@pytest.mark.parametrize(
    ("layers", "width", "sentence"),
    [
        (100, 1, "The policy has 101 layers, but it must have at most 100."),
        (1, 333_334, "has 1000003 parameters, but it must have at most 1000000: use fewer"),
    ],
)
def test_a_network_that_is_too_large_is_refused(layers, width, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        Architecture(("x0",), (width,) * layers, 1)


def test_a_network_may_be_as_large_as_the_limits():
    assert Architecture(("x0",), (1,) * 99, 1).num_parameters == 200
    assert Architecture(("x0",), (333_333,), 1).num_parameters == 1_000_000


def test_log_density_is_scipys(random_policy, rng):
    policy = random_policy(control_dim=3)
    inputs, controls = rng.standard_normal((6, 3)), rng.standard_normal((6, 3))
    covariance = np.diag(policy.noise_std**2)
    expected = [
        multivariate_normal.logpdf(u, policy.mean(o), covariance)
        for o, u in zip(inputs, controls, strict=True)
    ]
    assert_allclose(policy.log_density(inputs, controls), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"parameters": np.zeros(31)}, r"parameters has 31 values, .* needs 32\."),
        ({"parameters": np.r_[np.zeros(31), np.nan]}, r"parameters is nan at index 31; .* finite"),
        ({"noise_std": np.ones(3)}, r"noise_std has 3 values, .* needs 2\."),
        ({"noise_std": np.array([1.0, 0.0])}, r"noise_std is 0\.0, but it must be .* above 0\."),
        ({"noise_std": np.array([1.0, -1.0])}, r"noise_std is -1\.0"),
        ({"noise_std": np.array([1.0, np.inf])}, r"noise_std is inf at index 1"),
    ],
)
def test_bad_array_is_refused_with_its_value(random_policy, changes, message):
    with pytest.raises(InvalidInputError, match=message):
        dataclasses.replace(random_policy(), **changes)


def test_bad_shape_is_refused_with_the_valid_choices():
    with pytest.raises(InvalidInputError, match=r"'sigmoid'.* one of relu, softplus, tanh\."):
        Architecture(("x0",), (5,), 2, activation="sigmoid")
    with pytest.raises(InvalidInputError, match=r"number of units of a layer is 0"):
        Architecture(("x0",), (5, 0), 2)
    with pytest.raises(InvalidInputError, match=r"reads \['x0', 'x1', 'x0'\], .* each only once\."):
        Architecture(("x0", "x1", "x0"), (5,), 2)


def test_policy_of_another_robot_is_refused(random_policy):
    names = ("hip/position", "hip/velocity")
    policy: GaussianPolicy = random_policy(observed=names)
    policy.check_fits(names, 2)
    with pytest.raises(InvalidInputError, match=r"has 2 controls, but the task has 6"):
        policy.check_fits(names, 6)
    for other in (("hip/position",), names[::-1], ("hip/position", "knee/velocity")):
        theirs = rf"policies read {', '.join(other)};"
        with pytest.raises(InvalidInputError, match=r"reads \['hip/pos.*', 'hip/vel.* " + theirs):
            policy.check_fits(other, 2)
