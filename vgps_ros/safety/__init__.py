"""Protects a robot from its learned policy, without any middleware.

For each state, `Supervisor` decides whether the robot gets the policy's torques, within limits, or
the torques of the safe action.
"""

from vgps_ros.safety.safe_action import safe_torques
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import Command, Supervisor
from vgps_ros.safety.torque_limits import TorqueLimiter
from vgps_ros.safety.training_marginals import TrainingMarginals

__all__ = [
    "Command",
    "SafetySettings",
    "Supervisor",
    "TorqueLimiter",
    "TrainingMarginals",
    "safe_torques",
]
