# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Errors that a caller can act on: each message names the value and what would be right."""


class VgpsError(Exception):
    """Base class of all errors that vgps_ros raises on purpose."""


class InvalidInputError(VgpsError, ValueError):
    """A value from outside has a wrong name, shape or range."""


class DivergenceError(VgpsError, ArithmeticError):
    """A rollout or a solve left the range in which its numbers have a meaning.

    Args:
        sentence: what happened, and what to change.
        status: a name for the cause, one of STATUSES.
    """

    STATUSES = (
        "diverged",
        "infinite_cost",
        "indefinite_quu",
        "exploding_marginals",
        "open_gaps",
    )

    def __init__(self, sentence: str, status: str = "diverged"):
        super().__init__(sentence)
        self.status = status
