# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The controls of a policy that drives a robot: the same bits on every machine.

The network is compiled; up to rounding it computes the same as `GaussianPolicy.mean`. Each sum has
one order, no multiplication is fused with an addition (the compiler does so only where it is
allowed to), and the activations use nothing but additions, multiplications and divisions, which
IEEE 754 defines to the last bit. BLAS and libm would choose their code by the processor.
"""

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compiled
from vgps_ros.core.memory import Memory, PastInputs
from vgps_ros.core.policy import ACTIVATIONS, GaussianPolicy
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
        """Returns μ(o), shape (..., n_u), [N·m], for inputs o of shape (..., n_o).

        Of a policy that remembers former steps, these are first ones.
        """


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


class RememberingPolicy:
    """A policy of ours that reads something of former steps; of each step it is given the rest.

    Args:
        policy: the policy.
        past: what it remembers.

    Attributes:
        policy: the policy.
        past: what it remembers.
        observed: names of what it reads of a step, readings and then what it is told.
        noise_std: σ, shape (n_u,), [N·m].
        steps: how many steps, with the newest, it reads.
    """

    def __init__(self, policy: GaussianPolicy, past: PastInputs):
        self.policy, self.past = policy, past
        read = len(past.readings)
        self.observed = (*past.readings, *policy.observed[read + len(past.names) :])
        self.noise_std, self.steps = policy.noise_std, 1 + past.history
        self._mean = _CompiledMean(policy)

    def mean(self, inputs: Array) -> Array:
        """Returns μ(o) of first steps, shape (..., n_u), for inputs of shape (..., n)."""
        controls, _ = self.answer(inputs.reshape(-1, inputs.shape[-1]), None)
        return controls.reshape(*inputs.shape[:-1], -1)

    def answer(
        self, inputs: Array, memory: Memory | None, noise: Array | float = 0.0
    ) -> tuple[Array, Memory]:
        """Returns controls μ(o) + noise (N, n_u), and what N robots remember of the step.

        Args:
            inputs: what is read of the step, shape (N, n).
            memory: what they remember of the step before; None: this is the first.
            noise: of the controls, shape (N, n_u).
        """
        read, told = np.split(inputs, [len(self.past.readings)], axis=1)
        memory = self.past.following(memory, read)
        rows = np.concatenate([self.past.numbers(memory), told], axis=1)
        controls = np.array([self._mean(row) for row in rows]).reshape(len(rows), -1) + noise
        return controls, self.past.acted(memory, controls)

    def actions_of(self, controls: Array, inputs: Array) -> Array:
        """Returns the actions (N, n_u) of controls, which are what is remembered of them."""
        return controls


# The stamp of the newest state, what is remembered of it, and what was before it.
Remembered = tuple[int, Any, Any]
FORGOTTEN: Remembered = (-1, None, None)


class ExecutedPolicy:
    """A policy that is ready to drive.

    Args:
        policy: the policy.

    Attributes:
        policy: the policy.
        mean: returns μ(o), shape (n_u,) [N·m], for inputs o of shape (n_o,); of a policy that
            remembers former steps, in a first one.
        steps: how many steps, with the newest, it reads; 0: it remembers nothing.
        remembered: what it remembers.
    """

    def __init__(self, policy: Policy):
        self.policy = policy
        self.mean: Callable[[Array], Array] = (
            _CompiledMean(policy) if isinstance(policy, GaussianPolicy) else policy.mean
        )
        # Of one that may remember: RememberingPolicy, or a network of others.
        self._remembering: Any = policy if hasattr(policy, "answer") else None
        self.steps: int = getattr(policy, "steps", 0)
        self.remembered: Remembered = FORGOTTEN

    def forget(self) -> None:
        """Begins anew: the next state is a first one."""
        self.remembered = FORGOTTEN

    def recall(self, control: Array, inputs: Array) -> None:
        """Takes a control (n_u,) for the answer to the newest state, as one that was recorded."""
        stamp, memory, before = self.remembered
        action = self._remembering.actions_of(control[None], inputs[None])
        self.remembered = (stamp, memory._replace(action=action), before)

    def _answered(self, inputs: Array, stamp: int, noise: Array | float) -> Array:
        newest, memory, before = self.remembered
        if stamp != newest:  # a state that comes twice gets the same answer twice
            before = memory if stamp > newest else None
        controls, memory = self._remembering.answer(inputs[None], before, noise)
        self.remembered = (stamp, memory, before)
        return np.asarray(controls[0])

    def control(self, inputs: Array, stamp: int, seed: int | None = None) -> Array:
        """Returns the control u, shape (n_u,) [N·m], for inputs o of shape (n_o,).

        It is μ(o), plus noise if a seed is given. The noise depends only on that seed and on the
        time of the state, `stamp` [ns], so that recorded torques can be checked. A policy that
        remembers begins anew where time goes back.
        """
        noise: Array | float = 0.0
        if seed is not None:
            rng = generator(
                seed, Stream.EXECUTION, stamp % 2**64
            )  # an untrusted bag may have times below 0
            std = self.policy.noise_std
            noise = std * rng.standard_normal(len(std))
        if self._remembering:
            return self._answered(inputs, stamp, noise)
        return self.mean(inputs) if seed is None else self.mean(inputs) + noise


CompiledNetwork = tuple[Array, NDArray[np.int64], NDArray[np.bool_], int]

_ACTIVATIONS = tuple(ACTIVATIONS)
_SOFTPLUS, _TANH = _ACTIVATIONS.index("softplus"), _ACTIVATIONS.index("tanh")
_SMALLEST_EXPONENT = 700.0  # exp of less is no longer a normal number, and is taken as zero
_INVERSE_LOG_2 = 1.4426950408889634
# The two parts of log 2; the first has so few bits that a product with n is exact.
_LOG_2_HIGH, _LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10


def compiled_network(policy: GaussianPolicy) -> CompiledNetwork:
    """Returns θ, the layers' sizes, which of them have biases, and the activation."""
    shape = policy.architecture
    return (
        np.array(policy.parameters),
        np.array(shape.layer_sizes),
        np.array(shape.biased),
        _ACTIVATIONS.index(shape.activation),
    )


@compiled
def network_output(network, a, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes μ_θ(o) over o, the beginning of a; a and z must be as long as the widest layer."""
    parameters, sizes, biased, activation = network
    start = 0
    for layer in range(len(biased)):
        n_in, n_out = sizes[layer], sizes[layer + 1]
        end = start + n_out * n_in
        for o in range(n_out):
            z[o] = parameters[end + o] if biased[layer] else 0.0
            for i in range(n_in):
                z[o] += parameters[start + o * n_in + i] * a[i]
        last = layer == len(biased) - 1
        for o in range(n_out):
            a[o] = z[o] if last else _activate(activation, z[o])
        start = end + n_out if biased[layer] else end


@compiled
def _activate(activation, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    if activation == _SOFTPLUS:
        return max(z, 0.0) + _log1p(_exp(-abs(z)))
    if activation == _TANH:
        e = _exp(-2.0 * abs(z))
        return math.copysign((1.0 - e) / (1.0 + e), z)
    return max(z, 0.0)


@compiled
def _exp(z):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns exp(z) for z ≤ 0: 2^n times the Taylor series at r = z − n log 2, |r| ≤ 0.35."""
    if z < -_SMALLEST_EXPONENT:
        return 0.0
    n = np.floor(z * _INVERSE_LOG_2 + 0.5)
    if n != n:
        return z  # NaN
    r = (z - n * _LOG_2_HIGH) - n * _LOG_2_LOW
    series = 1.0
    for k in range(14, 0, -1):
        series = 1.0 + series * r / k
    return math.ldexp(series, int(n))


@compiled
def _log1p(y):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns log(1 + y) for y in [0, 1]: 2 artanh(s) with s = y / (2 + y), |s| ≤ 1/3."""
    s = y / (2.0 + y)
    series = 0.0
    for k in range(33, 0, -2):
        series = 1.0 / k + series * (s * s)
    return 2.0 * s * series
