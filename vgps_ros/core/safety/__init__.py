"""What stands between a learned policy and motors, without middleware.

`Supervisor` decides for each state whether the policy's torques go out, within limits, or those of
the safe action.
"""

from vgps_ros.core.safety.safe_action import safe_torques
from vgps_ros.core.safety.settings import SafetySettings
from vgps_ros.core.safety.supervisor import Command, Supervisor
from vgps_ros.core.safety.torque_limits import TorqueLimiter, model_torque_limits
from vgps_ros.core.safety.training_marginals import TrainingMarginals

__all__ = [
    "Command",
    "SafetySettings",
    "Supervisor",
    "TorqueLimiter",
    "TrainingMarginals",
    "model_torque_limits",
    "safe_torques",
]
