# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The standardised units in which the policy's fit is well conditioned, and L-BFGS.

States and controls are standardised while weights are optimised; the weights handed in and out are
those of the raw units.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
        marginals = [observed_marginals(q, observation) for q in distributions]
        inputs = np.concatenate([means for means, _ in marginals])
        spread = np.concatenate([np.diagonal(c, axis1=1, axis2=2) for _, c in marginals])
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
