# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives of the dynamics, averaged over q(x_t, u_t).

Where contacts open and close, a derivative at a point says little of the states around it, and
gains that are right at the point fail there. Their mean over the states and controls that q spreads
is what a linear fit to samples of f tends to (Stein's identity),

    E[∂f/∂z] = E[(f(z) ⊖ f(z̄)) δᵀ] Σ⁻¹,    z = z̄ ⊕ δ,  δ ~ N(0, Σ),

so this is the linearisation by samples that section 8 proposes. Means of derivatives are taken,
since they cost less for the same error: a fit needs a whole set of simulator steps for each of its
samples, and its error grows along directions in which q is narrow (docs/evidence/policies.md).
Samples come in pairs ±δ, by which the mean is exact where f is linear or quadratic.
"""

import numpy as np

from vgps_ros.core.dynamics import DynamicsModel, StateSpace
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.marginals import sample_joint_deviations
from vgps_ros.core.records import Array, LinearDynamics, Trajectory, TrajectoryDistribution


def mean_derivatives(
    dynamics: DynamicsModel,
    q: TrajectoryDistribution,
    count: int,
    width: float,
    rng: np.random.Generator,
) -> tuple[LinearDynamics, int]:
    """Returns the mean of f_x, f_u over samples of q, and the simulator steps that it took.

    Each step has so many samples; the width is a factor on the standard deviations of q.

    Raises:
        DivergenceError: a derivative at a sample is not finite.
    """
    x, u, space = q.mean.states, q.mean.controls, dynamics.space
    f_x, f_u = np.zeros_like(q.linear_dynamics.f_x), np.zeros_like(q.linear_dynamics.f_u)
    drawn, taken = (width * d for d in sample_joint_deviations(q, count, rng)), 0
    for delta_x, delta_u in zip(*drawn, strict=True):
        moved = np.concatenate([space.add(x[:-1], delta_x), x[-1:]])
        controls = np.clip(u + delta_u, *dynamics.control_limits)
        linear, steps = dynamics.linearize(Trajectory(moved, controls))
        found = _by_deviations(space, q.linear_dynamics, linear, delta_x, delta_u)
        f_x += found.f_x / count
        f_u += found.f_u / count
        taken += steps
    bad = np.flatnonzero(~(np.isfinite(f_x).all((1, 2)) & np.isfinite(f_u).all((1, 2))))
    if bad.size:
        raise DivergenceError(
            f"A derivative of the dynamics is not finite around step {bad[0]}, where samples of q "
            f"{width:g} times as wide as q were drawn: leave out dynamics_samples."
        )
    return LinearDynamics(f_x, f_u), taken


def _by_deviations(
    space: StateSpace, here: LinearDynamics, there: LinearDynamics, delta_x: Array, delta_u: Array
) -> LinearDynamics:
    """Returns derivatives at x̄ ⊕ δ as those of f(x̄ ⊕ δ, ū + δu) ⊖ f(x̄, ū) by δ and δu.

    How far f moves between the two is known to second order, from the derivatives at both.
    """
    if not space.quaternions:
        return there
    f_x, f_u = 0.5 * (here.f_x + there.f_x), 0.5 * (here.f_u + there.f_u)
    after = np.einsum("txy,ty->tx", f_x, delta_x) + np.einsum("txu,tu->tx", f_u, delta_u)
    f_x = space.carried_back(there.f_x, delta_x, by_deviation=True)
    solved = (np.linalg.solve(space.turns(after), f) for f in (f_x, there.f_u))
    return LinearDynamics(*(np.asarray(f, dtype=float) for f in solved))
