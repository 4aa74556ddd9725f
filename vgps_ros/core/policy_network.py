# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The policy's network as fits see it: standardised units, passes with torch, and L-BFGS.

States and controls are standardised while weights are optimised; the weights handed in and out are
those of the raw units. A pass has one sample a column: with one sample a row, as in
`GaussianPolicy`, the M-step takes 1.2 to 1.4 times as long.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize

from vgps_ros.core.observation import Observation, observed_marginals
from vgps_ros.core.policy import Architecture
from vgps_ros.core.records import Array, TrajectoryDistribution

# A control that never changes, as one whose limits are equal, still has a scale and some noise.
LEAST_SCALE, LEAST_NOISE = 1e-3, 1e-4  # [N·m]
_MEMORY = 20  # steps from which LBFGS estimates the curvature; fits with ten are worse


@dataclass(frozen=True)
class Standardization:
    """Affine change of units in which inputs and outputs of the network have unit spread.

    Shifts are used only where the layer has biases to absorb them.

    Attributes:
        architecture: shape of the network.
        input_shift: shape (n_o,).
        input_scale: shape (n_o,).
        output_shift: shape (n_u,), [N·m].
        output_scale: shape (n_u,), [N·m].
    """

    architecture: Architecture
    input_shift: Array
    input_scale: Array
    output_shift: Array
    output_scale: Array

    @classmethod
    def of(
        cls,
        architecture: Architecture,
        observation: Observation,
        distributions: Sequence[TrajectoryDistribution],
    ) -> "Standardization":
        """Returns the units that suit the observations and controls of distributions."""
        marginals = [_input_marginals(q, observation) for q in distributions]
        inputs, spread = (np.concatenate(parts) for parts in zip(*marginals, strict=True))
        controls = np.concatenate([q.mean.controls for q in distributions])
        first_bias = architecture.hidden_bias if architecture.hidden_units else False
        shift_in, shift_out = float(first_bias), float(architecture.output_bias)
        return cls(
            architecture,
            shift_in * inputs.mean(axis=0),
            np.maximum(np.sqrt(inputs.var(axis=0) + spread.mean(axis=0)), 1e-3),
            shift_out * controls.mean(axis=0),
            np.maximum(controls.std(axis=0), LEAST_SCALE),
        )

    def to_raw(self, parameters: Array) -> Array:
        """Returns θ in raw units, shape (num_parameters,)."""
        raw = np.array(parameters)
        layers = self.architecture.unpack(raw)
        last_weight, last_bias = layers[-1]
        last_weight *= self.output_scale[:, None]
        last_bias *= self.output_scale
        last_bias += self.output_shift
        first_weight, first_bias = layers[0]
        first_weight /= self.input_scale
        first_bias -= first_weight @ self.input_shift
        return raw

    def to_standard(self, parameters: Array) -> Array:
        """Returns θ in standardised units, shape (num_parameters,)."""
        standard = np.array(parameters)
        layers = self.architecture.unpack(standard)
        first_weight, first_bias = layers[0]
        first_bias += first_weight @ self.input_shift
        first_weight *= self.input_scale
        last_weight, last_bias = layers[-1]
        last_bias -= self.output_shift
        last_bias /= self.output_scale
        last_weight /= self.output_scale[:, None]
        return standard

    def inputs(self, inputs: Array) -> torch.Tensor:
        """Returns N inputs (..., n_o), standardised, shape (n_o, N)."""
        return _columns((inputs - self.input_shift) / self.input_scale)

    def controls(self, controls: Array) -> torch.Tensor:
        """Returns N controls (..., n_u), standardised, shape (n_u, N)."""
        return _columns((controls - self.output_shift) / self.output_scale)


def _input_marginals(q: TrajectoryDistribution, observation: Observation) -> tuple[Array, Array]:
    """Returns the means and the variances of the inputs at t = 1 … T, shape (T, n_o) each."""
    means, covariances = observed_marginals(q, observation)
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    if not (past := observation.past):
        return means, variances
    here = observation.within(q.context)
    means = here.along(q.mean.states[:-1], q.mean.controls)
    controls = q.gains @ q.state_covariances[:-1] @ np.swapaxes(q.gains, 1, 2)
    controls = np.diagonal(controls + q.control_covariances, axis1=1, axis2=2)
    r = len(observation.readings.names)
    acted = controls[:, : len(past.actions)]
    parts = [*[variances[:, :r]] * (1 + past.history), acted, variances[:, r:]]
    return means, np.concatenate(parts, axis=1)


def minimize_lbfgs(
    start: Array, value_and_gradient: Callable[[Array], tuple[float, Array]], iterations: int
) -> Array:
    """Returns the point that LBFGS reaches from `start`, by Wolfe line searches, shape (n,)."""
    options = {"maxiter": iterations, "maxcor": _MEMORY, "maxfun": np.inf, "ftol": 0.0, "gtol": 0.0}
    found = minimize(value_and_gradient, start, jac=True, method="L-BFGS-B", options=options)
    return np.asarray(found.x)


def _columns(samples: Array) -> torch.Tensor:
    """Returns samples (..., n) as a tensor (n, N)."""
    return torch.from_numpy(np.ascontiguousarray(samples.reshape(-1, samples.shape[-1]).T))


# The activation and its derivative, by name, of sums z.
ACTIVATIONS: dict[str, tuple[Callable[..., torch.Tensor], Callable[..., torch.Tensor]]] = {
    "softplus": (torch.nn.functional.softplus, torch.sigmoid),
    "tanh": (torch.tanh, lambda z: 1.0 - torch.tanh(z) ** 2),
    "relu": (torch.relu, lambda z: (z > 0.0).to(z.dtype)),
}


class Passes:
    """The passes through the network at one θ, for inputs of shape (n_o, N).

    Attributes:
        outputs: μ_θ, shape (n_u, N).
    """

    def __init__(self, architecture: Architecture, theta: Array, inputs: torch.Tensor):
        self._architecture = architecture
        activation = ACTIVATIONS[architecture.activation][0]
        self._layers = architecture.unpack(torch.from_numpy(theta).to(inputs.dtype))
        self._inputs, self._sums = [inputs], []  # of each layer; of each hidden one
        for weight, bias in self._layers[:-1]:
            z = affine(weight, self._inputs[-1], bias)
            self._sums.append(z)
            self._inputs.append(activation(z))
        weight, bias = self._layers[-1]
        self.outputs = affine(weight, self._inputs[-1], bias)

    @cached_property
    def _slopes(self) -> list[torch.Tensor]:
        """The derivative of each hidden layer's activation, shape (n_out, N)."""
        derivative = ACTIVATIONS[self._architecture.activation][1]
        return [derivative(z) for z in self._sums]

    def forwards(self, step: Array) -> torch.Tensor:
        """Returns J s, shape (n_u, N), for a step s of the parameters."""
        changes = self._architecture.unpack(torch.from_numpy(step).to(self.outputs.dtype))
        moved: Any = None
        for layer, (by_weight, by_bias) in enumerate(changes):
            z = affine(by_weight, self._inputs[layer], by_bias)
            if layer:
                z = torch.addmm(z, self._layers[layer][0], moved)
            moved = z * self._slopes[layer] if layer < len(self._sums) else z
        return torch.as_tensor(moved)

    def backwards(self, by_outputs: torch.Tensor) -> Array:
        """Returns Σ Jᵀ d over the samples, shape (num_parameters,), for d of shape (n_u, N)."""
        result = by_outputs.new_empty(self._architecture.num_parameters)
        parts = self._architecture.unpack(result)
        for layer in reversed(range(len(parts))):
            weight, bias = parts[layer]
            torch.mm(by_outputs, self._inputs[layer].T, out=weight)
            if isinstance(bias, torch.Tensor):
                torch.sum(by_outputs, dim=1, out=bias)
            if layer:
                by_outputs = (self._layers[layer][0].T @ by_outputs).mul_(self._slopes[layer - 1])
        return result.double().numpy()

    def factors(self, weights: torch.Tensor) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Returns E[δᵀ W δ], shape (n_out, n_out), and E[a aᵀ] of each layer.

        Where a layer has biases, its inputs a end with 1.
        """
        count = self.outputs.shape[1]
        found = []
        by_sums = torch.diag(weights.sqrt())[:, :, None].expand(-1, -1, count)  # (n_u, n_out, N)
        for layer in reversed(range(len(self._layers))):
            weight, bias = self._layers[layer]
            a = self._inputs[layer]
            if isinstance(bias, torch.Tensor):
                a = torch.cat([a, a.new_ones(1, count)])
            rows = by_sums.transpose(0, 1).reshape(by_sums.shape[1], -1)
            found.append((rows @ rows.T / count, a @ a.T / count))
            if layer:
                by_sums = torch.matmul(weight.T, by_sums) * self._slopes[layer - 1]
        return found[::-1]


def affine(weight: torch.Tensor, a: torch.Tensor, bias: torch.Tensor | float) -> torch.Tensor:
    """Returns W a + b, shape (n_out, N), for inputs (n_in, N)."""
    if isinstance(bias, torch.Tensor):
        return torch.addmm(bias[:, None], weight, a)
    return weight @ a
