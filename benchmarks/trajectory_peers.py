# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmark of whole solves against crocoddyl's, on the same problems."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.crocoddyl_problems import Shared, arm, cart_pole
from benchmarks.timing import Comparison, compare, seconds
from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import Array

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

            row = compare(
                f"{name}: solve to equal cost, one thread / crocoddyl's {peer}", mine, its, 0.8
            )
            a, b = (1e3 * n * each for each in _derivatives(shared))
            yield replace(
                row,
                remark=f"{n} iterations against {m}; ends {ours[-1]:.4g} and {theirs[-1]:.4g}; "
                f"f_x and f_u take {a:.3g} ms of ours, and would take {b:.3g} ms by pinocchio: "
                f"then {(row.ours - a + b) / row.peer:.2f}",
            )


def _derivatives(shared: Shared) -> tuple[float, float]:
    """Returns how long derivatives along a motion take us, and crocoddyl with the cost's [s]."""
    motion, problem = shared.start, shared.peer
    states, controls = list(motion.states), list(_all_controls(shared))
    problem.calc(states, controls)
    own, other = (
        min(seconds(work) for _ in range(31))
        for work in (
            partial(shared.dynamics.linearize, motion),
            partial(problem.calcDiff, states, controls),
        )
    )
    return own, other


def _all_controls(shared: Shared) -> Array:
    """Returns the start's controls with those of the joints that have no motor."""
    controls = np.zeros((shared.start.horizon, shared.peer.runningModels[0].nu))
    controls[:, : shared.dynamics.control_dim] = shared.start.controls
    return controls


def _our_costs(shared: Shared, iterations: int) -> list[float]:
    """Returns the cost after each iteration."""
    solution = solve(shared.dynamics, shared.cost, shared.start, DdpSettings(), iterations)
    return [iteration.cost for iteration in solution.iterations]


def _their_costs(shared: Shared, solver: str, iterations: int) -> list[float]:
    """Returns the cost after each iteration of one of crocoddyl's solvers."""
    import crocoddyl

    found: Any = getattr(crocoddyl, f"Solver{solver}")(shared.peer)
    logger = crocoddyl.CallbackLogger()
    found.setCallbacks([logger])
    found.solve(list(shared.start.states), list(_all_controls(shared)), iterations, True)
    return [float(cost) for cost in logger.costs]
