# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Computes the torques that replace the policy's when the policy must not drive."""

from collections.abc import Iterable

import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.training_marginals import TrainingMarginals, nearest_of


def safe_torques(
    settings: SafetySettings,
    state: Array | None,
    velocities: list[int],
    marginals: Iterable[TrainingMarginals],
) -> Array:
    """Returns the torques of the safe action, shape (n_u,) [N·m], before limits apply.

    They are zero if the action needs something that is missing, or if it would overflow.

    Args:
        settings: name of the action, and the damping.
        state: the newest usable state, shape (n_x,), or None.
        velocities: index in the state of the velocity that each control drives; -1 for none.
        marginals: training marginals of the DDP solutions whose feedback law may be used.
    """
    zero = np.zeros(len(velocities))
    if state is None or settings.safe_action == "zero":
        return zero
    with np.errstate(over="ignore", invalid="ignore"):
        if settings.safe_action == "damping":
            torques = np.where(np.array(velocities) < 0, 0.0, -settings.damping * state[velocities])
        else:
            nearest = nearest_of(marginals, state)
            if nearest is None:
                return zero
            torques = nearest.marginals.feedback(state, nearest.step)
    return torques if np.isfinite(torques).all() else zero
