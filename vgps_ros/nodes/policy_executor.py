# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Lifecycle node `policy_executor`: controls from the latest policy, for each state that comes.

Where the policy must not drive, the safe action does; `safety.supervisor` decides.
"""

from vgps_ros.core.records import Array
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Setting
from vgps_ros.ros_runtime.controller import Controller
from vgps_ros.ros_runtime.parameters import declare, value
from vgps_ros.ros_runtime.runner import Runnable, streaming_executor
from vgps_ros.ros_runtime.training_results import TrainingResults

STOCHASTIC = Setting("stochastic", False, "whether to add the policy's noise to its mean")


class PolicyExecutor(Controller):
    """Answers each state with the policy's controls."""

    def __init__(self) -> None:
        super().__init__("policy_executor", needs_policy=True)

    def prepare_law(self) -> None:
        """Declares the parameters of the policy's noise."""
        for setting in (SEED, STOCHASTIC):
            declare(self, setting, may_change=True)

    def law(self, training: TrainingResults, state: Array, stamp: int) -> Array:
        """Returns the policy's controls, with its noise where asked."""
        policy = training.policy
        assert policy is not None  # no state comes here before
        seed = value(self, SEED) if value(self, STOCHASTIC) else None
        inputs = training.observation.within(self.instructions.context)(state)
        return policy.control(inputs, stamp, seed)


NODE = Runnable(PolicyExecutor, streaming_executor, close=lambda node: node.stop())
