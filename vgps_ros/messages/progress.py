# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Progress of a training run to messages and back."""

import math
from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time
from std_msgs.msg import Header
from vgps_msgs.msg import LearningProgress

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.messages.conversions import plain, to_message
from vgps_ros.search.metrics import METRICS, IterationMetrics, result_content


def progress_to_msg(metrics: IterationMetrics, *, stamp: Time, **run: Any) -> LearningProgress:
    """Returns one iteration's metrics as a message.

    Args:
        metrics: the iteration.
        stamp: when it ended.
        run: task, method, seed, iterations and remaining_seconds of the run.
    """
    header = Header(stamp=stamp)
    return to_message(LearningProgress, metrics, header=header, iteration=metrics.k, **run)


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
