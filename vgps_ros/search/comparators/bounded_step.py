# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A trajectory step of bounded divergence (Levine and Abbeel, NIPS 2014, section 3.2).

In deviations from a trajectory, with linear dynamics and a quadratic cost c̃, it solves

    minimise  E_q[c̃(ζ)] − w H(q)   subject to  KL(q ‖ p) ≤ ε

for the linear-Gaussian policy q(u|x) of least cost near a policy p(u|x) of that kind. The dynamics
are the same under both, and cancel in the divergence. With the multiplier η ≥ 0 the Lagrangian is

    (w + η) [ E_q[ (c̃ − η log p) ÷ (w + η) ] − H(q) ] − η ε,

whose minimum is what one backward pass of section 4 gives: its Quu⁻¹ is q's covariance. The
divergence falls as η grows, so the η of the constraint is found by bisection.

Without the entropy (w = 0), c̃ = c and p is the policy: the expected cost falls as far as the bound
allows, as in mirror descent guided policy search. With it (w = 1), c̃ = α c − log π_θ and p is the
q before: the step is that of Algorithm 1, line 6, held near the states that are known.
"""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.ddp.backward_pass import backward_pass
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.gaussians import kl_divergence
from vgps_ros.core.marginals import Spread, state_covariances
from vgps_ros.core.records import Array, CostExpansion, LinearDynamics

_CLOSE = 0.99  # share of ε from which on a step is long enough
_LARGEST = 1e16  # η, whose inverse is the smallest one
_MOST_HALVINGS = 40


@dataclass(frozen=True)
class LinearPolicy:
    """u = ū + k + K δx + N(0, C) along a trajectory.

    Attributes:
        feedforward: k, shape (T, n_u), [N·m].
        gains: K, shape (T, n_u, n_dx).
        covariances: C, positive definite, shape (T, n_u, n_u), [N²·m²].
    """

    feedforward: Array
    gains: Array
    covariances: Array

    @classmethod
    def of(cls, energy: CostExpansion) -> "LinearPolicy":
        """Returns the policy p(u|x) ∝ exp(−e), for an expansion such as that of −log π_θ."""
        c = _inverse(energy.c_uu)
        k = -np.einsum("tuv,tv->tu", c, energy.c_u)
        return cls(k, -c @ energy.c_ux, c)

    def energy(self) -> CostExpansion:
        """Returns −log p(u|x) without its constant, ½ (δu − k − K δx)ᵀ C⁻¹ (δu − k − K δx)."""
        p = _inverse(self.covariances)
        pk = np.einsum("tuv,tv->tu", p, self.feedforward)
        by_state = np.swapaxes(self.gains, 1, 2)
        return CostExpansion(
            c=0.5 * np.einsum("tu,tu->t", self.feedforward, pk),
            c_x=np.einsum("txu,tu->tx", by_state, pk),
            c_u=-pk,
            c_xx=by_state @ p @ self.gains,
            c_uu=p,
            c_ux=-p @ self.gains,
        )


@dataclass(frozen=True)
class BoundedStep:
    """The result of a step.

    Attributes:
        policy: q(u|x).
        means: E_q[δx], shape (T+1, n_dx).
        state_covariances: Σ of q's marginals, shape (T+1, n_dx, n_dx).
        multiplier: η.
        divergence: KL(q ‖ p) [nat], at most ε.
    """

    policy: LinearPolicy
    means: Array
    state_covariances: Array
    multiplier: float
    divergence: float


def bounded_step(
    dynamics: LinearDynamics,
    cost: CostExpansion,
    reference: LinearPolicy,
    start: Array,
    spread: Spread,
    bound: float,
    entropy: float = 0.0,
) -> BoundedStep:
    """Returns the step of least cost whose divergence from the reference is at most the bound.

    Args:
        dynamics: f_x, f_u.
        cost: c̃.
        reference: p.
        start: the mean of δx_1, shape (n_dx,).
        spread: of x_1 and of the dynamics' noise.
        bound: ε, above 0 [nat].
        entropy: w, 0 or 1.

    Raises:
        DivergenceError: the marginals explode even under the reference.
    """
    energy = reference.energy()

    def step(eta: float) -> BoundedStep | None:
        """Returns the step at η; None if its divergence is too large."""
        try:
            policy = _minimum(dynamics, cost, energy, eta, entropy)
            found = propagate_marginals(dynamics, policy, start, spread)
        except DivergenceError:
            return None
        kl = divergence(policy, reference, *found)
        return BoundedStep(policy, *found, eta, kl) if kl <= bound else None

    if entropy and (free := step(0.0)):
        return free
    # The multiplier `high` is within the bound, and `low` is not, or 0 while none is known.
    low, high, found = 0.0, 1.0, step(1.0)
    while not found and high < _LARGEST:
        low, high = high, 10.0 * high
        found = step(high)
    if not found:
        raise DivergenceError(
            f"No step has a divergence of at most {bound:g} nat: the marginals explode even under "
            "the policy that it starts from; give the task a std_limit, or shorten its horizon.",
            "exploding_marginals",
        )
    while not low and high > 1.0 / _LARGEST:
        if nearer := step(high / 10.0):
            high, found = high / 10.0, nearer
        else:
            low = high / 10.0
    for _ in range(_MOST_HALVINGS):
        if not low or found.divergence >= _CLOSE * bound:
            break
        if nearer := step(middle := np.sqrt(low * high)):
            high, found = middle, nearer
        else:
            low = middle
    return found


def propagate_marginals(
    dynamics: LinearDynamics, policy: LinearPolicy, start: Array, spread: Spread
) -> tuple[Array, Array]:
    """Returns the means of δx, shape (T+1, n_dx), and the covariances of q's marginals.

    Raises:
        DivergenceError: the marginals explode.
    """
    means = [start]
    for a, b, k, gains in zip(
        dynamics.f_x, dynamics.f_u, policy.feedforward, policy.gains, strict=True
    ):
        means.append(a @ means[-1] + b @ (k + gains @ means[-1]))
    return np.array(means), state_covariances(dynamics, policy.gains, policy.covariances, spread)


def divergence(new: LinearPolicy, old: LinearPolicy, means: Array, sigma: Array) -> float:
    """Returns KL(new ‖ old) of the trajectories [nat], over the new policy's marginals.

    It is the sum over t of E_q[KL(new(u_t|x_t) ‖ old(u_t|x_t))].
    """
    turned = new.gains - old.gains
    apart = new.feedforward - old.feedforward + np.einsum("tux,tx->tu", turned, means[:-1])
    each = kl_divergence(apart, new.covariances, np.zeros_like(apart), old.covariances)
    spread = turned @ sigma[:-1] @ np.swapaxes(turned, 1, 2)
    feedback = 0.5 * np.sum(_inverse(old.covariances) * spread)
    return float(each.sum() + feedback)


def _minimum(
    dynamics: LinearDynamics, cost: CostExpansion, energy: CostExpansion, eta: float, w: float
) -> LinearPolicy:
    """Returns the minimiser of the Lagrangian at η, by one backward pass."""
    combined = {
        name: (value + eta * getattr(energy, name)) / (w + eta)
        for name, value in vars(cost).items()
    }
    local = backward_pass(dynamics, CostExpansion(**combined))
    if not local.complete:
        raise DivergenceError("Quu is indefinite.", "indefinite_quu")
    return LinearPolicy(local.feedforward, local.gains, local.control_covariances())


def _inverse(covariances: Array) -> Array:
    return np.asarray(np.linalg.inv(covariances), dtype=float)
