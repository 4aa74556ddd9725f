# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The Gaussian network policy π_θ(u|x) = N(μ_θ(o), diag(σ)²), o = h(x) (section 6).

μ_θ is a multilayer perceptron of what it reads of the state (see `observation`). By default it has
one hidden layer of soft rectifiers, a = log(1 + exp(z)), with biases in both layers. The number of
parameters counts weights and biases, 246 for the 10-unit walker as in the paper; the same rule
gives 62 for the 5-unit swimmer, where the paper says 63. The noise σ is learned too, uncounted.

The trajectory optimiser and fits evaluate the network by this module. Robots and evaluations do so
with bits that are the same on every machine (`executed_control`), and the M-step differentiates it
in torch (`policy_network`); a test holds that all three agree up to rounding.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from vgps_ros.core.checks import Array, Shape, array_shapes, finite_array, one_of, positive, quote
from vgps_ros.core.errors import InvalidInputError

# A message or goal that asks for more is a mistake, whose fit would take gigabytes.
MAX_LAYERS = 100
MAX_PARAMETERS = 1_000_000

# The activation and its derivative, by name.
ACTIVATIONS: dict[str, tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "softplus": (lambda z: np.logaddexp(0.0, z), lambda z: 0.5 * (1.0 + np.tanh(0.5 * z))),
    "tanh": (np.tanh, lambda z: 1.0 - np.tanh(z) ** 2),
    "relu": (lambda z: np.maximum(z, 0.0), lambda z: (z > 0.0).astype(float)),
}


@dataclass(frozen=True)
class Architecture:
    """Shape of the network.

    Attributes:
        observed: names of what the network reads, its inputs.
        hidden_units: width of each hidden layer.
        control_dim: n_u.
        activation: softplus, tanh or relu.
        hidden_bias: true if hidden layers have bias terms.
        output_bias: true if the output layer has bias terms.

    Raises:
        InvalidInputError: a layer has no units, the activation is unknown, an input is named
            twice, or the network is larger than MAX_LAYERS and MAX_PARAMETERS allow.
    """

    observed: tuple[str, ...]
    hidden_units: tuple[int, ...]
    control_dim: int
    activation: str = "softplus"
    hidden_bias: bool = True
    output_bias: bool = True

    def __post_init__(self) -> None:
        """Checks the values."""
        one_of("activation", self.activation, ACTIVATIONS)
        layers = len(self.layer_sizes) - 1
        if layers > MAX_LAYERS:
            raise InvalidInputError(
                f"The policy has {layers} layers, but it must have at most {MAX_LAYERS}."
            )
        for units in self.layer_sizes:
            positive("the number of units of a layer", units)
        if self.num_parameters > MAX_PARAMETERS:
            raise InvalidInputError(
                f"The policy has {self.num_parameters} parameters, but it must have at most "
                f"{MAX_PARAMETERS}: use fewer or narrower hidden layers."
            )
        if len(set(self.observed)) != len(self.observed):
            raise InvalidInputError(
                f"The policy reads {quote(list(self.observed))}, but it may read each only once."
            )

    @property
    def layer_sizes(self) -> tuple[int, ...]:
        """The number of inputs, the width of each hidden layer, and the number of outputs."""
        return (len(self.observed), *self.hidden_units, self.control_dim)

    @property
    def biased(self) -> tuple[bool, ...]:
        """True for each layer that has bias terms."""
        return (*[self.hidden_bias] * len(self.hidden_units), self.output_bias)

    @property
    def num_parameters(self) -> int:
        """Number of weights and biases."""
        return sum(outputs * inputs + bias for outputs, inputs, bias in self._layers())

    def unpack(self, parameters: Any) -> list[tuple[Any, Any]]:
        """Splits θ, an array or a tensor, into (weight (n_out, n_in), bias (n_out,) or 0.0)."""
        layers, start = [], 0
        for outputs, inputs, bias in self._layers():
            end = start + outputs * inputs
            weight = parameters[start:end].reshape(outputs, inputs)
            layers.append((weight, parameters[end : end + bias] if bias else 0.0))
            start = end + bias
        return layers

    def _layers(self) -> list[tuple[int, int, int]]:
        """Outputs, inputs and number of biases of each layer."""
        sizes = self.layer_sizes
        return [
            (n_out, n_in, n_out * has_bias)
            for n_in, n_out, has_bias in zip(sizes, sizes[1:], self.biased, strict=False)
        ]


@dataclass(frozen=True, eq=False)  # two policies are the same only if they are one
class GaussianPolicy:
    """π_θ(u|x) = N(μ_θ(o), diag(σ)²).

    The arrays may be given as any sequences of numbers.

    Attributes:
        architecture: shape of the network.
        parameters: θ, layer by layer, weights row-major, then biases.
        noise_std: σ, one standard deviation for each control, [N·m].

    Raises:
        InvalidInputError: an array has the wrong size, is not finite, or σ is not positive.
    """

    architecture: Architecture
    parameters: Annotated[Array, Shape("num_parameters")]
    noise_std: Annotated[Array, Shape("n_u")]

    def __post_init__(self) -> None:
        """Checks the arrays, and keeps copies that nobody else can change."""
        num_parameters, n_u = self.architecture.num_parameters, self.architecture.control_dim
        shapes = array_shapes(GaussianPolicy, num_parameters=num_parameters, n_u=n_u)
        for name, shape in shapes.items():
            object.__setattr__(
                self, name, finite_array(f"policy.{name}", getattr(self, name), shape)
            )
        for std in self.noise_std:
            positive("policy.noise_std", std)

    def check_fits(self, observed: tuple[str, ...], control_dim: int) -> None:
        """Checks that the policy reads what its task observes, and has n_u controls.

        Raises:
            InvalidInputError: it reads something else, or has other controls.
        """
        if self.architecture.control_dim != control_dim:
            raise InvalidInputError(
                f"The policy has {self.architecture.control_dim} controls, but the task has "
                f"{control_dim}; use a policy that was learned for this task."
            )
        if self.architecture.observed != observed:
            raise InvalidInputError(
                f"The policy reads {quote(list(self.architecture.observed))}, but the task's "
                f"policies read {', '.join(observed)}; use a policy that was learned for this task."
            )

    @property
    def observed(self) -> tuple[str, ...]:
        """Names of what the network reads, its inputs."""
        return self.architecture.observed

    @cached_property
    def layers(self) -> list[tuple[Any, Any]]:
        """Weight, shape (n_out, n_in), and bias, shape (n_out,) or 0.0, of each layer."""
        return self.architecture.unpack(self.parameters)

    def mean(self, inputs: Array) -> Array:
        """Returns μ_θ(o), shape (..., n_u), [N·m], for inputs o of shape (..., n_o)."""
        return self._forward(inputs)[0]

    def linearize(self, inputs: Array) -> tuple[Array, Array]:
        """Returns μ_θ(o), shape (..., n_u), and ∂μ/∂o, shape (..., n_u, n_o)."""
        derivative = ACTIVATIONS[self.architecture.activation][1]
        mean, sums = self._forward(inputs)
        *hidden, (jacobian, _) = self.layers
        for (w, _), z in zip(reversed(hidden), reversed(sums), strict=True):
            jacobian = (jacobian * derivative(z)[..., None, :]) @ w
        return mean, np.broadcast_to(jacobian, (*inputs.shape[:-1], *jacobian.shape[-2:]))

    def _forward(self, inputs: Array) -> tuple[Array, list[Array]]:
        """Returns μ_θ(o) and the input of each hidden layer's activation, shape (..., n_out)."""
        activation = ACTIVATIONS[self.architecture.activation][0]
        a, sums = inputs, []
        *hidden, (weight, bias) = self.layers
        for w, b in hidden:
            z = a @ w.T + b
            sums.append(z)
            a = activation(z)
        return a @ weight.T + bias, sums

    def log_density(self, inputs: Array, controls: Array) -> Array:
        """Returns log π_θ(u|o) [nat], shape (...,), of controls (..., n_u) for o (..., n_o)."""
        return self.log_density_around(self.mean(inputs), controls)

    def log_density_around(self, mean: Array, controls: Array) -> Array:
        """Returns log π_θ(u|o) [nat], shape (...,), where μ_θ(o), shape (..., n_u), is known."""
        z = (controls - mean) / self.noise_std
        normaliser = np.sum(np.log(self.noise_std)) + 0.5 * len(self.noise_std) * np.log(2 * np.pi)
        return -0.5 * np.sum(z**2, -1) - normaliser
