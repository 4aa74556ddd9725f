# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Blurs the M-step's samples as sensors misread, and mirrors half of them.

A policy that has only seen exact readings trusts them too much, so the samples may be blurred as
the robot's sensors are. Where a robot's left and right are alike, a sample teaches the mirrored
motion as well: each draw mirrors every sample or not, at random.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.records import Array

Samples = tuple[Array, Array, Array]
"""What the policy reads (N, n_o), the wanted controls' means (N, n_u) and variances (N, n_u)."""


@dataclass(frozen=True)
class Mirror:
    """The exchange of left and right.

    Attributes:
        inputs: for each number that the policy reads, the place of the one that mirrors it, (n_o,).
        input_signs: 1, or -1 where the mirrored number has the other sign, shape (n_o,).
        controls: the same of the controls, shape (n_u,).
        control_signs: shape (n_u,).
    """

    inputs: NDArray[np.intp]
    input_signs: Array
    controls: NDArray[np.intp]
    control_signs: Array

    def __call__(self, samples: Samples) -> Samples:
        """Returns the mirrored samples."""
        inputs, means, variances = samples
        return (
            inputs[:, self.inputs] * self.input_signs,
            means[:, self.controls] * self.control_signs,
            variances[:, self.controls],
        )


@dataclass(frozen=True)
class Augmentation:
    """Changes samples before they are fitted.

    Attributes:
        noise: standard deviation of what is added to each number that is read, shape (n_o,).
        mirror: mirrors each sample with probability ½; None for no mirror.
    """

    noise: Array
    mirror: Mirror | None = None

    def __call__(self, samples: Samples, rng: np.random.Generator) -> Samples:
        """Returns the samples to fit."""
        if self.noise.any():
            inputs, means, variances = samples
            samples = inputs + self.noise * rng.standard_normal(inputs.shape), means, variances
        if self.mirror is None:
            return samples
        mirrored = rng.uniform(size=(len(samples[0]), 1)) < 0.5
        both = zip(self.mirror(samples), samples, strict=True)
        return tuple(np.where(mirrored, *pair) for pair in both)  # type: ignore[return-value]
