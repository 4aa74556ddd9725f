# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The loss of the M-step over N samples, in closed form, and its damped Gauss-Newton minimiser.

With r = μ_θ − μ_q, J = ∂μ_θ/∂θ, and the best noise profiled out (see `policy_fit`),

    F(θ) = ½ Σ_j log v_j,    v_j = E[r_j²] + E[(Σ_q)_jj],
    ∇F   = E[Jᵀ W r],        W = diag(1 / v_j),
    G    = E[Jᵀ W J]                                (Gauss-Newton, never indefinite).

G is never formed. A product G s takes a pass forwards, J s, and one backwards, so that its time
grows as samples times parameters, as that of the gradient does. In front of conjugate gradients
stands the inverse of a product of two small matrices for each layer, of its inputs a and of the
derivatives δ of the outputs by its sums (Martens and Grosse, ICML 2015): G ≈ E[δᵀ W δ] ⊗ E[a aᵀ].

All is in standardised units, with one sample a column. The minimiser takes the steps

    s = −(G + λ d I)⁻¹ ∇F,    d the mean of G's diagonal     (Levenberg and Marquardt).

A step takes one pass over all samples for the gradient, and some conjugate gradients over a part of
them, since the curvature need not be exact. λ falls where the quadratic model was right, and grows
where it was not. Each step has new samples, so that the fit cannot lean on those it has seen: from
one draw it comes closer to that draw's optimum, but q, which adapts to the network, then ends at a
poorer one (docs/evidence/benchmarks.md). They also tell when to end: once the last step has gained
less on new samples than a tolerance. Where samples are few for the size of the network, a step may
suit its own samples alone; a shorter one, with a larger λ, may still gain on all.

The samples are passed in blocks, on all cores. Where the blocks end depends on the size of the
network alone, and their sums are added in order, so that no bit depends on the number of cores.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, cached_property
from inspect import signature
from typing import Any

import numpy as np
import torch
from scipy.sparse.linalg import LinearOperator, cg

from vgps_ros.core.cores import count_cores
from vgps_ros.core.policy import Architecture
from vgps_ros.core.policy_network import Passes
from vgps_ros.core.records import Array

# The curvature comes from a share of the samples, but not from too few of them. Seven divides few
# horizons, so that all steps have their share.
_PARTS, _LEAST_PART = 7, 1000

# SciPy 1.11, as Ubuntu 24.04 has it, calls the relative tolerance tol.
_RELATIVE = "rtol" if "rtol" in signature(cg).parameters else "tol"

# Samples times parameters of a block: some milliseconds of one core.
_BLOCK = 2**23


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count_cores(), "m_step")


def _total(parts: Sequence[Any]) -> Any:
    """Returns the sum, added in order."""
    first, *others = parts
    return sum(others, first)


def _for_each(function: Callable[..., Any], *blocks: Sequence[Any]) -> list[Any]:
    """Returns the function of each block, in order."""
    return list((map if len(blocks[0]) == 1 else _pool().map)(function, *blocks))


@dataclass(frozen=True)
class Point:
    """The loss at one θ.

    Attributes:
        value: F(θ) [nat], but for a constant.
        gradient: ∇F, shape (num_parameters,).
        weights: the diagonal of W, shape (n_u,); 0 for a control whose noise is at its least.
    """

    value: float
    gradient: Array
    weights: torch.Tensor


@dataclass(frozen=True)
class FitLoss:
    """F(θ).

    Attributes:
        architecture: shape of the network.
        inputs: what the policy reads, shape (n_o, N).
        targets: μ_q, shape (n_u, N).
        variances: E[(Σ_q)_jj], shape (n_u,).
        least: the least variance of the policy's noise, shape (n_u,).
    """

    architecture: Architecture
    inputs: torch.Tensor
    targets: torch.Tensor
    variances: torch.Tensor
    least: torch.Tensor

    def at(self, theta: Array) -> Point:
        """Returns the loss and its gradient at θ."""
        passes, residuals, v = self._misfit(theta)
        weights = torch.where(v > self.least, 1.0 / v, 0.0)
        scale = (weights / self.inputs.shape[1])[:, None]
        gradient = _total(_for_each(lambda p, r: p.backwards(r * scale), passes, residuals))
        return Point(self._value(v), gradient, weights)

    def value(self, theta: Array) -> float:
        """Returns F at θ."""
        return self._value(self._misfit(theta)[2])

    def value_and_gradient(self, theta: Array) -> tuple[float, Array]:
        """Returns F and ∇F at θ."""
        point = self.at(theta)
        return point.value, point.gradient

    def curvature(self, theta: Array, weights: torch.Tensor) -> "Curvature":
        """Returns G at θ, over a part of the samples, in single precision."""
        parts = max(1, min(_PARTS, self.inputs.shape[1] // _LEAST_PART))
        passes = self._passes(theta, self._blocks(self.inputs[:, ::parts].float()))
        return Curvature(self.architecture, passes, weights.float())

    def _misfit(self, theta: Array) -> tuple[list[Passes], list[torch.Tensor], torch.Tensor]:
        """Returns the passes and r (n_u, N_b) of each block, and v, shape (n_u,)."""
        inputs, targets = self._samples
        passes = self._passes(theta, inputs)
        residuals = [p.outputs - wanted for p, wanted in zip(passes, targets, strict=True)]
        squares = _total([(r**2).sum(dim=1) for r in residuals])
        return passes, residuals, squares / self.inputs.shape[1] + self.variances

    def _passes(self, theta: Array, blocks: list[torch.Tensor]) -> list[Passes]:
        return _for_each(lambda block: Passes(self.architecture, theta, block), blocks)

    @cached_property
    def _samples(self) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
        """The inputs and the targets, in blocks."""
        return self._blocks(self.inputs), self._blocks(self.targets)

    def _blocks(self, columns: torch.Tensor) -> list[torch.Tensor]:
        size = max(1, _BLOCK // self.architecture.num_parameters)
        return [block.contiguous() for block in columns.split(size, dim=1)]

    def _value(self, v: torch.Tensor) -> float:
        return 0.5 * torch.log(torch.maximum(v, self.least)).sum().item()


@dataclass(frozen=True)
class Curvature:
    """G = E[Jᵀ W J] at one θ, by its products."""

    architecture: Architecture
    passes: list[Passes]
    weights: torch.Tensor

    def times(self, step: Array) -> Array:
        """Returns G s, shape (num_parameters,)."""
        scale = (self.weights / self._count)[:, None]
        return _total(_for_each(lambda p: p.backwards(p.forwards(step) * scale), self.passes))

    @cached_property
    def _count(self) -> int:
        return sum(p.outputs.shape[1] for p in self.passes)

    def solve(self, gradient: Array, damping: float, iterations: int) -> Array:
        """Returns about −(G + λ d I)⁻¹ ∇F, by conjugate gradients, d being G's mean diagonal."""
        size, added = len(gradient), damping * self._mean_diagonal

        def inverse(residual: Array) -> Array:
            """Applies the inverse of the layers' Kronecker products, which G resembles."""
            result = np.empty(size)
            pairs = zip(self._unpack(result), self._unpack(residual), self._eigen, strict=True)
            for solved, given, (u_out, u_in, values) in pairs:
                whole = [part.reshape(len(u_out), -1) for part in given]
                inner = u_out.T @ torch.cat(whole, dim=1) @ u_in
                outer = u_out @ (inner / (values + added)) @ u_in.T
                columns = outer.split([part.shape[1] for part in whole], dim=1)
                for part, column in zip(solved, columns, strict=True):
                    part.copy_(column.reshape(part.shape))
            return result

        damped = LinearOperator((size, size), lambda s: self.times(s) + added * s, dtype=float)
        precondition = LinearOperator((size, size), inverse, dtype=float)
        tolerance: dict[str, Any] = {_RELATIVE: 1e-2, "atol": 0.0}
        step, _ = cg(damped, -gradient, maxiter=iterations, M=precondition, **tolerance)
        return np.asarray(step)

    def _unpack(self, parameters: Array) -> list[list[torch.Tensor]]:
        """Returns weight, and bias if there is one, of each layer."""
        layers = self.architecture.unpack(torch.from_numpy(parameters))
        return [[part for part in layer if isinstance(part, torch.Tensor)] for layer in layers]

    @cached_property
    def _factors(self) -> list[tuple[torch.Tensor, torch.Tensor]]:
        found = _for_each(lambda p: p.factors(self.weights), self.passes)
        shares = [p.outputs.shape[1] / self._count for p in self.passes]
        return [
            (
                _total([outer.double() * n for (outer, _), n in zip(layer, shares, strict=True)]),
                _total([inner.double() * n for (_, inner), n in zip(layer, shares, strict=True)]),
            )
            for layer in zip(*found, strict=True)
        ]

    @cached_property
    def _eigen(self) -> list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]:
        """Eigenvectors of both factors of each layer, and the products of their eigenvalues."""
        found = []
        for outer, inner in self._factors:
            (e_out, u_out), (e_in, u_in) = torch.linalg.eigh(outer), torch.linalg.eigh(inner)
            found.append((u_out, u_in, torch.outer(e_out.clamp(min=0.0), e_in.clamp(min=0.0))))
        return found

    @cached_property
    def _mean_diagonal(self) -> float:
        """The mean of the diagonal of the layers' products; 1 where all are 0."""
        total = sum(float(outer.trace() * inner.trace()) for outer, inner in self._factors)
        return total / self.architecture.num_parameters or 1.0


_FIRST_DAMPING, _LARGEST_DAMPING = 1e-3, 1e6
# Conjugate gradients in a step. More of them solve a model better that is only a model.
_INNER_ITERATIONS = 15
_SHORTER = 10.0  # factor on λ after a step that gained too little on new samples


def minimize_gauss_newton(
    start: Array, losses: Iterator[FitLoss], iterations: int, tolerance: float, retries: int = 0
) -> Array:
    """Returns the θ that the steps reach from `start`.

    Args:
        start: θ, shape (num_parameters,).
        losses: F(θ) over new samples, without end.
        iterations: the most steps.
        tolerance: the least gain of a step that is worth another one [nat].
        retries: how often a step that gained less is followed by a shorter one.
    """
    theta, damping = start, _FIRST_DAMPING
    before = None
    for _ in range(iterations):
        loss = next(losses)
        here = loss.at(theta)
        if before is not None:
            gain = loss.value(before) - here.value
            if not gain >= tolerance:
                theta = theta if gain > 0 else before
                if not retries:
                    return theta
                here, retries, damping = loss.at(theta), retries - 1, _SHORTER * damping
        before = theta
        theta, damping = _step(theta, loss, here, damping)
    return theta


def _step(theta: Array, loss: FitLoss, here: Point, damping: float) -> tuple[Array, float]:
    """Returns a θ of lower loss and the next λ; the same θ if there is none."""
    if not np.isfinite(here.value):
        return theta, damping
    curvature = loss.curvature(theta, here.weights)
    while damping <= _LARGEST_DAMPING:
        step = curvature.solve(here.gradient, damping, _INNER_ITERATIONS)
        gain = here.value - loss.value(theta + step)
        if gain > 0:
            expected = -float(step @ (here.gradient + 0.5 * curvature.times(step)))
            factor = 0.2 if gain > 0.75 * expected else 3.0 if gain < 0.25 * expected else 1.0
            return theta + step, factor * damping
        damping *= 8.0
    return theta, _FIRST_DAMPING
