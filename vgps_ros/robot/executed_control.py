# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The controls of a policy that drives a robot: the same bits on every machine.

Up to rounding the network computes the same as `GaussianPolicy.mean`. Each sum has one order, no
multiplication is fused with an addition, and the activations use nothing but additions,
multiplications and divisions, which IEEE 754 defines to the last bit. BLAS and libm would choose
their code by the processor. Rollouts compute the same bits in a compiled loop
(`simulation.compiled_loops`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import factorial
from typing import Any, Protocol

import numpy as np

from vgps_ros.core.memory import Memory, PastInputs
from vgps_ros.core.observation import Observation
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
        """Returns μ(o), shape (..., n_u), [N·m], for inputs o of shape (..., n_o).

        Of a policy that remembers former steps, these are first ones.
        """


class ExactMean:
    """μ_θ of a policy of ours, which has the same bits on every machine."""

    def __init__(self, policy: GaussianPolicy):
        shape, parameters, start = policy.architecture, np.array(policy.parameters), 0
        self._activation = shape.activation
        self._layers = list[tuple[Array, Array]]()  # Wᵀ and b
        sizes = zip(shape.layer_sizes, shape.layer_sizes[1:], shape.biased, strict=False)
        for n_in, n_out, has_bias in sizes:
            end = start + n_out * n_in
            weights = parameters[start:end].reshape(n_out, n_in).T.copy()
            start = end + n_out * has_bias
            bias = parameters[end:start] if has_bias else np.zeros(n_out)
            self._layers.append((weights[:, None], bias))

    def __call__(self, inputs: Array) -> Array:
        """Returns μ(o), shape (..., n_u), for o of shape (..., n_o)."""
        a, last = inputs.reshape(-1, inputs.shape[-1]), len(self._layers) - 1
        for i, (weights, bias) in enumerate(self._layers):
            terms = np.empty((1 + len(weights), len(a), len(bias)))
            terms[0] = bias
            np.multiply(a.T[..., None], weights, out=terms[1:])
            z = np.add.accumulate(terms, axis=0)[-1]  # one after another
            a = _activate(self._activation, z) if i < last else z
        return a.reshape(*inputs.shape[:-1], -1)


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
        self._mean = ExactMean(policy)

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
        controls = self._mean(rows) + noise
        return controls, self.past.acted(memory, controls)

    def actions_of(self, controls: Array, inputs: Array) -> Array:
        """Returns the actions (N, n_u) of controls, which are what is remembered of them."""
        return controls


@dataclass(frozen=True)
class Driver:
    """A policy and what it reads of a state.

    Attributes:
        policy: the policy.
        observation: what it reads; of a network of others it may be more than the task's policies
            read.
    """

    policy: Policy
    observation: Observation

    @classmethod
    def of(cls, observation: Observation, policy: GaussianPolicy) -> "Driver":
        """Returns a policy that was learned to read an observation."""
        if past := observation.past:
            return cls(RememberingPolicy(policy, past), observation.now)
        return cls(policy, observation)

    def new_law(self) -> Callable[..., Array]:
        """Returns the law of a run of N robots, which remembers what its policy does.

        It is called step after step with o (N, n_o), and perhaps with noise (N, n_u).
        """
        policy, memory = self.policy, None
        answer = getattr(policy, "answer", None)  # of one that may remember

        def law(inputs: Array, noise: Array | float = 0.0) -> Array:
            nonlocal memory
            if answer is None:
                return policy.mean(inputs) + noise
            controls, memory = answer(inputs, memory, noise)
            return np.asarray(controls)

        return law


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
            ExactMean(policy) if isinstance(policy, GaussianPolicy) else policy.mean
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
        action = np.append(action, memory.action[:, action.shape[1] :], axis=1)  # its own state
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
        time of the state, `stamp` [ns], so that recorded controls can be checked. A policy that
        remembers begins anew where time goes back.
        """
        noise: Array | float = 0.0
        if seed is not None:
            # A bag that is not trusted may have times below 0.
            rng = generator(seed, Stream.EXECUTION, stamp % 2**64)
            std = self.policy.noise_std
            noise = std * rng.standard_normal(len(std))
        if self._remembering:
            return self._answered(inputs, stamp, noise)
        return self.mean(inputs) if seed is None else self.mean(inputs) + noise


SMALLEST_EXPONENT = -700.0  # exp of less is no longer a normal number; exp of this is taken
INVERSE_LOG_2 = 1.4426950408889634
# The two parts of log 2; the first has so few bits that a product with n is exact.
LOG_2_HIGH, LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
# Power series without their first term: exp(r) = 1 + Σ c_k r^k and artanh(s) / s = 1 + Σ c_k s^2k.
EXP = tuple(1.0 / factorial(k) for k in range(1, 15))
ARTANH = tuple(1.0 / k for k in range(3, 35, 2))
_EXP, _ARTANH = np.array(EXP), np.array(ARTANH)


def _activate(activation: str, z: Array) -> Array:
    """Returns the activation of each z, shape (N, n)."""
    if activation == "softplus":
        return np.asarray(np.maximum(z, 0.0) + _log1p(_exp(-np.abs(z))))
    if activation == "tanh":
        e = _exp(-2.0 * np.abs(z))
        return np.copysign((1.0 - e) / (1.0 + e), z)
    return np.maximum(z, 0.0)


def _exp(z: Array) -> Array:
    """Returns exp(z) for z ≤ 0: 2^n times the series at r = z − n log 2, |r| ≤ 0.35."""
    n = np.floor(np.fmax(z, SMALLEST_EXPONENT) * INVERSE_LOG_2 + 0.5)
    r = (np.maximum(z, SMALLEST_EXPONENT) - n * LOG_2_HIGH) - n * LOG_2_LOW
    return np.asarray(np.ldexp(_series(_EXP, r), n.astype(np.int32)))


def _log1p(y: Array) -> Array:
    """Returns log(1 + y) for y in [0, 1]: 2 artanh(s) with s = y / (2 + y), |s| ≤ 1/3."""
    s = y / (2.0 + y)
    return np.asarray(2.0 * s * _series(_ARTANH, s * s))


def _series(coefficients: Array, x: Array) -> Array:
    """Returns 1 + Σ c_k x^k; the first two terms, which are large, are added last."""
    terms = coefficients * np.multiply.accumulate(x[..., None].repeat(coefficients.size, -1), -1)
    return np.asarray(1.0 + (terms[..., 0] + np.add.accumulate(terms[..., 1:], axis=-1)[..., -1]))
