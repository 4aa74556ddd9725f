"""Errors that a caller can act on: each message names the value and what would be right."""


class VgpsError(Exception):
    """Base class of all errors that vgps_ros raises on purpose."""


class InvalidInputError(VgpsError, ValueError):
    """A value from outside has the wrong name, shape or range."""


class DivergenceError(VgpsError, ArithmeticError):
    """A rollout or a solve left the region in which numbers mean something."""
