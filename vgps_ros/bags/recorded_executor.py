"""The executor of a bag, as its recorded parameters describe it."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import yaml

from vgps_ros.bags import BagReader
from vgps_ros.core.dynamics import CONTROL_BOUND
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.safety import SafetySettings, TorqueLimiter, TrainingMarginals, safe_torques
from vgps_ros.tasks import make_task


class RecordedExecutor:
    """What the executor did beside asking its policy.

    A bag from before there were limits has none, and no safe action.

    Args:
        bag: with the parameters of all nodes.
        joints: all joints, in the order of the state.
        actuated: those that the torques drive.

    Attributes:
        seed: of its noise.
        limiter: its limits; it follows the torques that are noted.

    Raises:
        InvalidInputError: a recorded parameter has a value that the executor would have refused.
    """

    def __init__(self, bag: BagReader, joints: list[str], actuated: list[str]):
        parameters = _parameters(bag)
        self.seed = int(parameters.get("seed", 0))
        self._actuated = [joints.index(name) for name in actuated]
        self._task = make_task(parameters["task"]) if "safe_action" in parameters else None
        defaults = SafetySettings(torque_limits=(CONTROL_BOUND,) * len(actuated))
        known = {s.name for s in settings_of(defaults)} & set(parameters)
        values = {name: parameters[name] for name in known}
        if "torque_limits" in values:
            values["torque_limits"] = tuple(values["torque_limits"])
        self._settings = with_values(defaults, values)
        self.limiter = TorqueLimiter(
            np.array(self._settings.torque_limits),
            self._settings.torque_rate_limit,
            self._task.dynamics.time_step if self._task else 0.0,
        )

    @property
    def limits_rates(self) -> bool:
        """Whether torques depend on the ones before."""
        return bool(self._settings.torque_rate_limit)

    @property
    def follows_distribution(self) -> bool:
        """Whether the safe action is the feedback law of a trajectory distribution."""
        return self._settings.safe_action == "feedback"

    def marginals(self, distribution: TrajectoryDistribution) -> TrainingMarginals:
        """Returns what the executor made of a distribution."""
        assert self._task is not None
        dims = (self._task.dynamics.state_dim, self._task.dynamics.control_dim)
        return TrainingMarginals(distribution.first(self._task.horizon), self._task.observed, dims)

    def is_safe(
        self, torques: Array, state: Array, marginals: Iterable[Iterable[TrainingMarginals]]
    ) -> bool:
        """Whether torques are those of the safe action in a state.

        Args:
            torques: shape (n_u,).
            state: shape (n_x,).
            marginals: those that the executor may have had at the time.
        """
        if self._task is None:
            return False
        if not torques.any():
            return True
        return any(
            np.array_equal(torques, self.limiter.clipped(self._safe(state, had)))
            for had in marginals
        )

    def _safe(self, state: Array, marginals: Iterable[TrainingMarginals]) -> Array:
        return safe_torques(self._settings, state, self._actuated, marginals)


def _parameters(bag: BagReader) -> dict[str, Any]:
    """The executor's parameters, from those of all nodes that the bag holds."""
    nodes = yaml.safe_load(bag.attachments().get("parameters.yaml", "")) or {}
    for node in nodes.values():
        parameters: dict[str, Any] = node["ros__parameters"]
        if {"seed", "stochastic"} <= set(parameters):
            return parameters
    return {}
