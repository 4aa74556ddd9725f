# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The controls of a policy that drives a robot: the same bits on every machine."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from vgps_ros.core.compiled_network import compiled_network, network_output
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator


class Policy(Protocol):
    """A policy N(μ(o), diag(σ)²) of any kind; see `GaussianPolicy` for ours.

    Attributes:
        observed: names of what it reads.
        noise_std: σ, shape (n_u,), [N·m].
    """

    @property
    def observed(self) -> tuple[str, ...]: ...  # noqa: D102

    @property
    def noise_std(self) -> Array: ...  # noqa: D102

    def mean(self, inputs: Array) -> Array:
        """Returns μ(o), shape (..., n_u), [N·m], for inputs o of shape (..., n_o)."""


class _CompiledMean:
    """μ_θ of a policy of ours, which has the same bits on every machine."""

    def __init__(self, policy: GaussianPolicy):
        self._network = compiled_network(policy)
        widest = max(policy.architecture.layer_sizes)
        self._a, self._z = np.empty(widest), np.empty(widest)
        self._control_dim = policy.architecture.control_dim
        self(np.zeros(len(policy.observed)))  # loads the compiled code

    def __call__(self, inputs: Array) -> Array:
        self._a[: len(inputs)] = inputs
        network_output(self._network, self._a, self._z)
        return self._a[: self._control_dim].copy()


class ExecutedPolicy:
    """A policy that is ready to drive.

    Args:
        policy: the policy.

    Attributes:
        policy: the policy.
        mean: returns μ(o), shape (n_u,) [N·m], for inputs o of shape (n_o,).
    """

    def __init__(self, policy: Policy):
        self.policy = policy
        self.mean: Callable[[Array], Array] = (
            _CompiledMean(policy) if isinstance(policy, GaussianPolicy) else policy.mean
        )

    def control(self, inputs: Array, stamp: int, seed: int | None = None) -> Array:
        """Returns the control u, shape (n_u,) [N·m], for inputs o of shape (n_o,).

        It is μ(o), plus noise if a seed is given. The noise depends only on that seed and on the
        time of the state, `stamp` [ns], so that recorded torques can be checked.
        """
        mean = self.mean(inputs)
        if seed is None:
            return mean
        rng = generator(seed, Stream.EXECUTION, stamp % 2**64)  # a stranger's bag has times below 0
        return mean + self.policy.noise_std * rng.standard_normal(len(mean))
