"""Repeats what a recorded policy_executor did, as its recorded parameters describe it."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import yaml

from vgps_ros.bags import BagReader
from vgps_ros.core.dynamics import CONTROL_BOUND
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.safety.safe_action import safe_torques
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.torque_limits import TorqueLimiter
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.tasks import make_task


class RecordedExecutor:
    """Applies the limits and the safe action of a recorded executor.

    Bags of old versions, in which the executor had neither, are read as such.

    Args:
        bag: bag with the parameters of all nodes.
        joints: names of all joints, in the order of the state.
        actuated: names of the joints that the torques drive.

    Attributes:
        seed: seed of the policy's noise.
        settings: safety settings of the executor.
        limiter: limits of the torques, which depend on the torques that were noted before.

    Raises:
        InvalidInputError: a recorded parameter has a value that no executor accepts.
    """

    def __init__(self, bag: BagReader, joints: list[str], actuated: list[str]):
        nodes = yaml.safe_load(bag.attachments().get("parameters.yaml", "")) or {}
        of_nodes: list[dict[str, Any]] = [node["ros__parameters"] for node in nodes.values()]
        parameters = next((p for p in of_nodes if {"seed", "stochastic"} <= set(p)), {})
        self.seed = int(parameters.get("seed", 0))
        self._actuated = [joints.index(name) for name in actuated]
        self._task = make_task(parameters["task"]) if "safe_action" in parameters else None
        defaults = SafetySettings(torque_limits=(CONTROL_BOUND,) * len(actuated))
        known = {s.name for s in settings_of(defaults)} & set(parameters)
        values = {name: parameters[name] for name in known}
        if "torque_limits" in values:
            values["torque_limits"] = tuple(values["torque_limits"])
        self.settings = with_values(defaults, values)
        self.limiter = TorqueLimiter(
            np.array(self.settings.torque_limits),
            self.settings.torque_rate_limit,
            self._task.dynamics.time_step if self._task else 0.0,
        )

    def marginals(self, distribution: TrajectoryDistribution) -> TrainingMarginals:
        """Returns the training marginals that the executor computed from a distribution."""
        assert self._task is not None
        dims = (self._task.dynamics.state_dim, self._task.dynamics.control_dim)
        return TrainingMarginals(distribution.first(self._task.horizon), self._task.observed, dims)

    def is_safe(
        self, torques: Array, state: Array, marginals: Iterable[Iterable[TrainingMarginals]]
    ) -> bool:
        """Returns True if torques are zero, or those of the safe action in a state.

        Args:
            torques: recorded torques, shape (n_u,) [N·m].
            state: recorded state, shape (n_x,).
            marginals: the sets of training marginals that the executor may have had at the time.
        """
        if self._task is None:
            return False
        if not torques.any():
            return True
        safe = (safe_torques(self.settings, state, self._actuated, had) for had in marginals)
        return any(np.array_equal(torques, self.limiter.clipped(each)) for each in safe)
