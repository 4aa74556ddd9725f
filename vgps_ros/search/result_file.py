"""The content of result.json, which a training leaves behind.

JSON has no infinity: a cost that diverged is null.
"""

import math
from collections.abc import Sequence
from typing import Any

from vgps_ros.search.metrics import IterationMetrics


def iteration_entry(iteration: IterationMetrics) -> dict[str, Any]:
    """Returns one entry of result.json's `iterations`."""
    return {
        "k": iteration.k,
        "alpha": iteration.alpha,
        "ddp_cost": _finite(iteration.ddp_cost),
        "deterministic_cost": _finite(iteration.deterministic_cost),
        "deterministic_survival": iteration.deterministic_survival,
        "stochastic_cost_mean": _finite(iteration.stochastic_cost_mean),
        "stochastic_cost_median": _finite(iteration.stochastic_cost_median),
        "stochastic_survival": iteration.stochastic_survival,
        "q_step_seconds": iteration.q_step_seconds,
        "m_step_seconds": iteration.m_step_seconds,
        "simulator_steps": iteration.simulator_steps,
    }


def result_content(
    *,
    task: str,
    method: str,
    seed: int,
    hidden_units: Sequence[int],
    num_parameters: int,
    initial_ddp_cost: float,
    iterations: Sequence[dict[str, Any]],
) -> dict[str, Any]:
    """Returns the content of result.json."""
    return {
        "task": task,
        "method": method,
        "seed": seed,
        "hidden_units": list(hidden_units),
        "num_parameters": num_parameters,
        "initial_ddp_cost": initial_ddp_cost,
        "iterations": list(iterations),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
