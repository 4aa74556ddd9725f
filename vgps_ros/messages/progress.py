"""Progress of a training run to messages and back."""

import math
from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header
from vgps_msgs.msg import LearningProgress

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.messages.conversions import plain
from vgps_ros.search.metrics import METRICS, IterationMetrics, result_content


def progress_to_msg(
    metrics: IterationMetrics,
    *,
    task: str,
    method: str,
    seed: int,
    iterations: int,
    remaining_seconds: float,
    stamp: Time,
) -> LearningProgress:
    """Returns one iteration's metrics as a message."""
    return LearningProgress(
        header=Header(stamp=stamp),
        task=task,
        method=method,
        seed=seed,
        iteration=metrics.k,
        iterations=iterations,
        remaining_seconds=remaining_seconds,
        **{name: getattr(metrics, name) for name in METRICS},
    )


def progress_from_msg(message: LearningProgress) -> IterationMetrics:
    """Returns the message's metrics; NaN stands for one that an older bag's messages lack."""
    found = {name: plain(getattr(message, name, math.nan)) for name in METRICS}
    return IterationMetrics(k=message.iteration, **found)


def result_from_msgs(
    history: Sequence[LearningProgress], policy: GaussianPolicy | None
) -> dict[str, Any]:
    """Returns the content of result.json of a training that messages tell of, at least one."""
    last, metrics = history[-1], [progress_from_msg(message) for message in history]
    return result_content(last.task, last.method, int(last.seed), policy, metrics)
