# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The cost to go is what rollouts of a linear system with feedback cost."""

import numpy as np

from vgps_ros.core.ddp.cost_to_go import cost_to_go
from vgps_ros.core.records import CostExpansion, LinearDynamics


def test_the_cost_to_go_is_what_following_costs():
    rng = np.random.default_rng(4)
    horizon, n, m = 12, 4, 2
    f_x, f_u = rng.normal(0.0, 0.5, (horizon, n, n)), rng.normal(size=(horizon, n, m))
    gains = rng.normal(0.0, 0.3, (horizon, m, n))
    root = rng.normal(size=(horizon, n + m, n + m))
    hessian, slope = root @ np.swapaxes(root, 1, 2), rng.normal(size=(horizon, n + m))
    cost = CostExpansion(
        c=np.zeros(horizon),
        c_x=slope[:, :n],
        c_u=slope[:, n:],
        c_xx=hessian[:, :n, :n],
        c_uu=hessian[:, n:, n:],
        c_ux=hessian[:, n:, :n],
    )
    value = cost_to_go(LinearDynamics(f_x, f_u), cost, gains)
    for first in (0, 5, horizon - 1):
        start = rng.normal(size=n)
        x, paid = start, 0.0
        for t in range(first, horizon):
            both = np.concatenate([x, gains[t] @ x])
            paid += slope[t] @ both + 0.5 * both @ hessian[t] @ both
            x = f_x[t] @ x + f_u[t] @ gains[t] @ x
        np.testing.assert_allclose(value(first, start), paid, rtol=1e-10)
