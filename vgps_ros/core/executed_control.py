# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The controls of a policy that drives a robot: the same bits on every machine."""

import numpy as np

from vgps_ros.core.compiled_network import compiled_network, network_output
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator


class ExecutedPolicy:
    """A policy that is ready to drive.

    Args:
        policy: the policy π_θ.
    """

    def __init__(self, policy: GaussianPolicy):
        self.policy = policy
        self._network = compiled_network(policy)
        widest = max(policy.architecture.layer_sizes)
        self._a, self._z = np.empty(widest), np.empty(widest)
        self.mean(np.zeros(len(policy.architecture.observed)))  # loads the compiled code

    def mean(self, inputs: Array) -> Array:
        """Returns μ_θ(o), shape (n_u,) [N·m], for inputs o of shape (n_o,)."""
        self._a[: len(inputs)] = inputs
        network_output(self._network, self._a, self._z)
        return self._a[: self.policy.architecture.control_dim].copy()

    def control(self, inputs: Array, stamp: int, seed: int | None = None) -> Array:
        """Returns the control u, shape (n_u,) [N·m], for inputs o of shape (n_o,).

        It is μ_θ(o), plus noise if a seed is given. The noise depends only on that seed and on the
        time of the state, `stamp` [ns], at least 0, so that recorded torques can be checked.
        """
        mean = self.mean(inputs)
        if seed is None:
            return mean
        rng = generator(seed, Stream.EXECUTION, stamp)
        return mean + self.policy.noise_std * rng.standard_normal(len(mean))
