"""Differential dynamic programming in the iterative LQR form of section 4."""

from vgps_ros.core.ddp.backward_pass import LocalPolicy, backward_pass
from vgps_ros.core.ddp.solve import Iteration, Solution, Status, solve
from vgps_ros.core.optimizer_settings import DdpSettings

__all__ = [
    "DdpSettings",
    "Iteration",
    "LocalPolicy",
    "Solution",
    "Status",
    "backward_pass",
    "solve",
]
