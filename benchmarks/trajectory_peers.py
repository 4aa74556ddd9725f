# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmark of whole solves against crocoddyl's, on the same problems."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.crocoddyl_problems import Shared, arm, cart_pole
from benchmarks.timing import Comparison, compare
from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.optimizer_settings import DdpSettings

_MOST = 300  # iterations
_CLOSE = 1.001  # a solve is done when its cost is within .1 % of the higher one of both ends
_LIMITS = {"cart_pole": 6.0, "arm": 45.0}  # [N], [N·m]: they hold in part of each motion


def trajectory_peers() -> Iterator[Comparison]:
    """Time to equal cost, on one thread, with and without limits of the controls."""
    for name, problem in (("cart_pole", cart_pole), ("arm", arm)):
        for limit, peer in ((None, "FDDP"), (_LIMITS[name], "BoxFDDP")):
            shared = problem(limit=limit)
            ours, theirs = _our_costs(shared, _MOST), _their_costs(shared, peer, _MOST)
            goal = _CLOSE * max(ours[-1], theirs[-1])
            n, m = (int(np.argmax(np.array(costs) <= goal)) + 1 for costs in (ours, theirs))

            def mine(shared: Shared = shared, n: int = n) -> None:
                _our_costs(shared, n)

            def its(shared: Shared = shared, peer: str = peer, m: int = m) -> None:
                _their_costs(shared, peer, m)

            yield compare(
                f"{name}: solve to equal cost, one thread / crocoddyl's {peer}",
                mine,
                its,
                0.8,
                remark=f"{n} iterations against {m}; ends {ours[-1]:.4g} and {theirs[-1]:.4g}",
            )


def _our_costs(shared: Shared, iterations: int) -> list[float]:
    """Returns the cost after each iteration."""
    solution = solve(shared.dynamics, shared.cost, shared.start, DdpSettings(), iterations)
    return [iteration.cost for iteration in solution.iterations]


def _their_costs(shared: Shared, solver: str, iterations: int) -> list[float]:
    """Returns the cost after each iteration of one of crocoddyl's solvers."""
    import crocoddyl

    problem = shared.peer
    controls = np.zeros((shared.start.horizon, problem.runningModels[0].nu))
    controls[:, : shared.dynamics.control_dim] = shared.start.controls
    found: Any = getattr(crocoddyl, f"Solver{solver}")(problem)
    logger = crocoddyl.CallbackLogger()
    found.setCallbacks([logger])
    found.solve(list(shared.start.states), list(controls), iterations, True)
    return [float(cost) for cost in logger.costs]
