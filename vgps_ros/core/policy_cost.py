# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The modified cost c̄ = α c − log π_θ of section 4, averaged over samples of the marginals.

log π_θ can be jagged, so its values and derivatives are averaged over samples drawn from q. State
and action are drawn jointly, (x̄ ⊕ δ, ū + K δ), and the deviations δ stay fixed within one solve:
the line search judges the same averaged cost whose derivatives were used.

q(u|x) knows the state alone. A policy that remembers former steps is for it the mean of that policy
over what q did before: the memory is drawn from q jointly with δ, along the trajectory that is
judged, and moves with the state by the regression E[δx_{t−l} | δx_t] = G δx_t.
"""

from dataclasses import dataclass

import numpy as np

from vgps_ros.core.cost import TrajectoryCost
from vgps_ros.core.marginals import Histories, recollections, sample_deviations, sample_histories
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, CostExpansion, Trajectory, TrajectoryDistribution


@dataclass(frozen=True)
class ScaledCost:
    """α c(x, u)."""

    cost: TrajectoryCost
    alpha: float

    def values(self, trajectory: Trajectory) -> Array:
        """Returns α c of each step, shape (T,)."""
        return self.alpha * self.cost.values(trajectory)

    def expand(self, trajectory: Trajectory) -> CostExpansion:
        """Returns α times the expansion of c."""
        e = self.cost.expand(trajectory)
        a = self.alpha
        return CostExpansion(a * e.c, a * e.c_x, a * e.c_u, a * e.c_xx, a * e.c_uu, a * e.c_ux)


@dataclass(frozen=True)
class PolicyCost:
    """c̄(x, u) = α c(x, u) − mean over s of log π_θ(u + K δ_s | h(x ⊕ δ_s)).

    Attributes:
        scaled: α c.
        policy: π_θ.
        observation: h, what the policy reads of a state.
        deviations: δ, shape (S, T, n_dx); a single zero sample gives the point cost.
        gains: K, shape (T, n_u, n_dx).
        drawn: δ with what was before, for a policy that remembers.
        recollections: G, and the same of δu_{t−1}; see `core.marginals.recollections`.
    """

    scaled: ScaledCost
    policy: GaussianPolicy
    observation: Observation
    deviations: Array
    gains: Array
    drawn: Histories | None = None
    recollections: tuple[Array, Array] | None = None

    @classmethod
    def of(
        cls,
        scaled: ScaledCost,
        policy: GaussianPolicy,
        observation: Observation,
        q: TrajectoryDistribution,
        count: int,
        rng: np.random.Generator,
    ) -> "PolicyCost":
        """Returns the cost with so many samples of q."""
        if not observation.past:
            return cls(scaled, policy, observation, sample_deviations(q, count, rng), q.gains)
        length = observation.past.length
        drawn, told = sample_histories(q, count, length, rng), recollections(q, length)
        return cls(scaled, policy, observation, drawn.states[0], q.gains, drawn, told)

    def values(self, trajectory: Trajectory) -> Array:
        """Returns c̄ of each step, shape (T,)."""
        states, controls = self._samples(trajectory)
        log_density = self.policy.log_density(self._inputs(trajectory, states), controls)
        return self.scaled.values(trajectory) - log_density.mean(axis=0)

    def expand(self, trajectory: Trajectory) -> CostExpansion:
        """Returns c̄ and its Gauss-Newton derivatives, which are never indefinite."""
        states, controls = self._samples(trajectory)
        mean, by_inputs = self.policy.linearize(self._inputs(trajectory, states))
        jacobian = self._by_states(by_inputs, states)  # J
        precision = 1.0 / self.policy.noise_std**2  # P = Σ⁻¹, diagonal
        p_r = precision * (controls - mean)  # P r
        p_j = precision[:, None] * jacobian  # P J
        count = len(states)
        e = self.scaled.expand(trajectory)
        return CostExpansion(
            c=e.c - self.policy.log_density_around(mean, controls).mean(axis=0),
            c_x=e.c_x - np.einsum("stux,stu->tx", jacobian, p_r) / count,  # −Jᵀ P r
            c_u=e.c_u + p_r.mean(axis=0),  # P r
            c_xx=e.c_xx + _products(jacobian, p_j) / count,  # Jᵀ P J
            c_uu=e.c_uu + np.diag(precision),  # P
            c_ux=e.c_ux - p_j.mean(axis=0),  # −P J
        )

    def _inputs(self, trajectory: Trajectory, states: Array) -> Array:
        """Returns o in the samples, shape (S, T, n_o)."""
        memory = self.observation.remembered(trajectory, self.drawn) if self.drawn else None
        return self.observation(states, memory)

    def _by_states(self, by_inputs: Array, states: Array) -> Array:
        """Returns ∂μ/∂δ at x, shape (S, T, n_u, n_dx), for ∂μ/∂o at x ⊕ δ_s."""
        space, past = self.observation.space, self.observation.past
        if not past or not self.recollections:
            pulled = self.observation.pull_back(by_inputs, states)
            return space.carried_back(pulled, self.deviations)
        r, steps = len(self.observation.readings.names), np.arange(states.shape[1])
        each = np.broadcast_to(np.eye(r), (*states.shape[:2], r, r))
        h_x = space.carried_back(self.observation.pull_back(each, states), self.deviations)
        by_states, by_controls = self.recollections
        jacobian = by_inputs[..., :r] @ h_x
        for lag in range(1, past.history + 1):
            before = h_x[:, np.maximum(steps - lag, 0)] @ by_states[lag - 1]
            jacobian += by_inputs[..., lag * r : (lag + 1) * r] @ before
        first = (1 + past.history) * r
        acted = slice(first, first + len(past.actions))
        return np.asarray(jacobian + by_inputs[..., acted] @ by_controls[:, : len(past.actions)])

    def _samples(self, trajectory: Trajectory) -> tuple[Array, Array]:
        """Returns x ⊕ δ_s and u + K δ_s, shapes (S, T, n_x) and (S, T, n_u)."""
        shift = np.einsum("tux,stx->stu", self.gains, self.deviations)
        states = self.observation.space.add(trajectory.states[:-1], self.deviations)
        return states, trajectory.controls + shift


def _products(left: Array, right: Array) -> Array:
    """Returns Σ_s leftᵀ right, shape (T, n, n), of matrices of shape (S, T, m, n).

    One matrix product for each step sums over samples and rows.
    """
    tall = [np.concatenate(list(matrices), axis=1) for matrices in (left, right)]
    return np.swapaxes(tall[0], 1, 2) @ tall[1]
