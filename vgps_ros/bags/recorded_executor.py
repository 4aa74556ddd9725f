# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Repeats what a recorded policy_executor did, as its recorded parameters describe it."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from vgps_ros.bags import BagReader
from vgps_ros.bags.recorded_parameters import RecordedParameters
from vgps_ros.core.checks import finite_array
from vgps_ros.core.dynamics import CONTROL_BOUND
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.executed_control import Policy
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.safety.safe_action import safe_torques
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.torque_limits import TorqueLimiter
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.simulation.model import control_range, driven_velocities, state_names
from vgps_ros.simulation.readings import Readings
from vgps_ros.simulation.simulations import Simulations
from vgps_ros.tasks import recorded_task


class RecordedExecutor:
    """Applies the limits and the safe action of a recorded executor.

    Bags of old versions, in which the executor had neither, are read as such.

    Args:
        bag: bag with the parameters of all nodes.
        model: the robot.

    Attributes:
        parameters: those of all nodes.
        is_in_lock_step: whether a simulation waited for the answer to each state.
        settings: safety settings of the executor.
        limiter: limits of the torques, which depend on the torques that were noted before.

    Raises:
        InvalidInputError: a recorded parameter has a value that no executor accepts.
    """

    def __init__(self, bag: BagReader, model: mujoco.MjModel):
        self.parameters = RecordedParameters(bag)
        self._node, parameters = self.parameters.having("seed", "stochastic")
        _, simulated = self.parameters.having("mode", "real_time_factor")
        self.is_in_lock_step = simulated.get("mode") == "lock_step"
        self._velocities, self._state_names = driven_velocities(model), state_names(model)
        self._simulations = Simulations(model, threads=1)
        self._readings: dict[tuple[str, ...], Readings] = {}
        self._task = (
            recorded_task(str(parameters["task"]))
            if {"safe_action", "task"} <= set(parameters)
            else None
        )
        defaults = SafetySettings(torque_limits=(CONTROL_BOUND,) * model.nu)
        known = {s.name for s in settings_of(defaults)} & set(parameters)
        values = {name: parameters[name] for name in known}
        if "torque_limits" in values:
            limits = values["torque_limits"]
            values["torque_limits"] = tuple(limits if isinstance(limits, list) else [limits])
        self.settings = with_values(defaults, values)
        finite_array("torque_limits", self.settings.torque_limits, (model.nu,))
        self.limiter = TorqueLimiter(
            self.settings.torque_range(control_range(model)),
            self.settings.torque_rate_limit,
            self._task.dynamics.time_step if self._task else 0.0,
        )

    @property
    def control_period(self) -> int:
        """The robot's control period [ns]; 0 in a bag of an old version, which does not tell it."""
        return round(self._task.dynamics.time_step * 1e9) if self._task else 0

    def seeds(self, received: int) -> list[int | None]:
        """Returns the seeds of the noise that torques of a time [ns] may have; None is no noise."""
        if not self._node:
            return [None]
        noisy = self.parameters.around(self._node, "stochastic", received)
        seeds = self.parameters.around(self._node, "seed", received)
        for seed in seeds:
            SEED.check(seed)
        return [seed for is_noisy in noisy for seed in (seeds if is_noisy else [None])]

    def named(self, policy: GaussianPolicy) -> GaussianPolicy:
        """Returns the policy with the names of what it reads; old bags have a state's indices.

        Raises:
            InvalidInputError: an index is that of nothing.
        """
        given: tuple[Any, ...] = policy.architecture.observed
        names = self._state_names
        if missing := [n for n in given if isinstance(n, int) and n >= len(names)]:
            raise InvalidInputError(
                f"The policy reads index {missing[0]}, but a state has {len(names)} numbers."
            )
        observed = tuple(names[n] if isinstance(n, int) else n for n in given)
        return replace(policy, architecture=replace(policy.architecture, observed=observed))

    def inputs(self, policy: Policy, state: Array) -> Array:
        """Returns what the policy reads of a state, shape (n_o,)."""
        return self._readings_of(policy)(state)

    def check_fits(self, policy: Policy) -> None:
        """Refuses a policy that no executor of this robot could use.

        Raises:
            InvalidInputError: the robot lacks what it reads, or has another number of torques.
        """
        self._readings_of(policy)
        wanted = len(self._simulations.model.actuator_ctrlrange)
        if isinstance(policy, GaussianPolicy) and (given := len(policy.noise_std)) != wanted:
            raise InvalidInputError(f"The policy has {given} torques, but the robot has {wanted}.")

    def _readings_of(self, policy: Policy) -> Readings:
        names = policy.observed
        if names not in self._readings:
            self._readings[names] = Readings(self._simulations, names)
        return self._readings[names]

    def marginals(self, distribution: TrajectoryDistribution) -> TrainingMarginals:
        """Returns the training marginals that the executor computed from a distribution."""
        assert self._task is not None
        task, scored = self._task, distribution.first(self._task.horizon)
        return TrainingMarginals(scored, task.observation, task.dynamics.control_dim)

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
        safe = (safe_torques(self.settings, state, self._velocities, had) for had in marginals)
        return any(np.array_equal(torques, self.limiter.clipped(each)) for each in safe)
