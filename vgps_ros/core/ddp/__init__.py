"""Differential dynamic programming in the iterative LQR form of section 4."""

from vgps_ros.core.ddp.backward_pass import LocalPolicy, backward_pass
from vgps_ros.core.ddp.settings import DdpSettings
from vgps_ros.core.ddp.solve import Iteration, Solution, Status, solve

__all__ = [
    "DdpSettings",
    "Iteration",
    "LocalPolicy",
    "Solution",
    "Status",
    "backward_pass",
    "solve",
]
