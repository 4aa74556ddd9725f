"""Progress of a training run to messages and on to result.json."""

import math
from typing import Any

from builtin_interfaces.msg import Time
from vgps_msgs.msg import LearningProgress

from vgps_ros.search.metrics import IterationMetrics


def progress_to_msg(
    iteration: IterationMetrics,
    *,
    task: str,
    method: str,
    seed: int,
    iterations: int,
    remaining_seconds: float,
    stamp: Time,
) -> LearningProgress:
    """Returns one iteration's outcome as a message."""
    message = LearningProgress(
        task=task,
        method=method,
        seed=seed,
        iteration=iteration.k,
        iterations=iterations,
        alpha=iteration.alpha,
        initial_ddp_cost=iteration.initial_ddp_cost,
        ddp_cost=iteration.ddp_cost,
        deterministic_cost=iteration.deterministic_cost,
        deterministic_survival=iteration.deterministic_survival,
        stochastic_cost_mean=iteration.stochastic_cost_mean,
        stochastic_cost_median=iteration.stochastic_cost_median,
        stochastic_survival=iteration.stochastic_survival,
        noise_std=iteration.noise_std,
        policy_kl=iteration.policy_kl,
        policy_entropy=iteration.policy_entropy,
        q_step_seconds=iteration.q_step_seconds,
        m_step_seconds=iteration.m_step_seconds,
        remaining_seconds=remaining_seconds,
        simulator_steps=iteration.simulator_steps,
    )
    message.header.stamp = stamp
    return message


def entry_from_msg(message: LearningProgress) -> dict[str, Any]:
    """Returns the message as an entry of result.json's `iterations`."""
    entry: dict[str, Any] = {"k": message.iteration}
    for name in (
        "alpha",
        "ddp_cost",
        "deterministic_cost",
        "deterministic_survival",
        "stochastic_cost_mean",
        "stochastic_cost_median",
        "stochastic_survival",
        "q_step_seconds",
        "m_step_seconds",
        "simulator_steps",
    ):
        value = getattr(message, name, math.nan)  # bags of earlier versions lack some
        entry[name] = value if math.isfinite(value) else None
    return entry
