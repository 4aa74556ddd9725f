# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Passes through the policy's network, forwards and backwards, with one sample a column.

The network is written a second time here: with one sample a row, as in `GaussianPolicy`, the M-step
takes 1.2 to 1.4 times as long.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import torch

from vgps_ros.core.policy import Architecture
from vgps_ros.core.records import Array

# The activation and its derivative, by name, of sums z.
ACTIVATIONS: dict[str, tuple[Callable[..., torch.Tensor], Callable[..., torch.Tensor]]] = {
    "softplus": (torch.nn.functional.softplus, torch.sigmoid),
    "tanh": (torch.tanh, lambda z: 1.0 - torch.tanh(z) ** 2),
    "relu": (torch.relu, lambda z: (z > 0.0).to(z.dtype)),
}


class Passes:
    """The passes through the network at one θ, for N inputs.

    Args:
        architecture: shape of the network.
        theta: θ, shape (num_parameters,).
        inputs: shape (n_o, N).

    Attributes:
        outputs: μ_θ, shape (n_u, N).
    """

    def __init__(self, architecture: Architecture, theta: Array, inputs: torch.Tensor):
        self._architecture = architecture
        activation = ACTIVATIONS[architecture.activation][0]
        self._layers = architecture.unpack(torch.from_numpy(theta))
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
        changes = self._architecture.unpack(torch.from_numpy(step))
        moved: Any = None
        for layer, (by_weight, by_bias) in enumerate(changes):
            z = affine(by_weight, self._inputs[layer], by_bias)
            if layer:
                z = torch.addmm(z, self._layers[layer][0], moved)
            moved = z * self._slopes[layer] if layer < len(self._sums) else z
        return torch.as_tensor(moved)

    def backwards(self, by_outputs: torch.Tensor) -> Array:
        """Returns Σ Jᵀ d over the samples, shape (num_parameters,), for d of shape (n_u, N)."""
        result = np.empty(self._architecture.num_parameters)
        parts = self._architecture.unpack(torch.from_numpy(result))
        for layer in reversed(range(len(parts))):
            weight, bias = parts[layer]
            torch.mm(by_outputs, self._inputs[layer].T, out=weight)
            if isinstance(bias, torch.Tensor):
                torch.sum(by_outputs, dim=1, out=bias)
            if layer:
                by_outputs = (self._layers[layer][0].T @ by_outputs).mul_(self._slopes[layer - 1])
        return result

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
