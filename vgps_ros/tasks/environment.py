# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Offers the tasks as Gymnasium environments for reinforcement learning.

They are registered when this module is imported:

    import gymnasium, vgps_ros.tasks.environment
    environment = gymnasium.make("vgps_ros/Swimmer-v0")
    environment = gymnasium.make("vgps_ros/Task-v0", task="hopper/task.yaml")
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import register
from gymnasium.spaces import Box

from vgps_ros.core.checks import positive
from vgps_ros.core.dynamics import DIVERGENCE_BOUND
from vgps_ros.core.memory import Memory
from vgps_ros.core.records import Array
from vgps_ros.tasks import BUILT_IN, make_task

_UNLIMITED = 1e6  # a control's range beyond it is none


class TaskEnvironment(gymnasium.Env[Array, Array]):
    """An environment whose reward is the negative cost of a task.

    The observation is what a policy of the task reads. The action is the torques, divided by
    `torque_scale`. An episode lasts for the task's horizon, or until the robot falls. The cost of
    lying still for the rest of the horizon is then charged at once, so that falling early never
    pays.

    Args:
        task: a name, a task file or its folder, or FILE.py:FUNCTION.
        torque_scale: control for an action of 1 [N·m for motors]; None for the largest one that the
            model allows, or 1 where it has no limit, as those of the swimmer and the walker have.
        reward_scale: factor of the reward.
        render_mode: must be None, since the environment draws nothing.

    Attributes:
        state: the simulator's state x, shape (n_x,).

    Raises:
        InvalidInputError: the task is unknown, or a scale is not positive.
    """

    def __init__(
        self,
        task: str,
        torque_scale: float | None = None,
        reward_scale: float = 1.0,
        render_mode: str | None = None,
    ):
        self._task = make_task(task)
        largest = self._task.dynamics.control_limits[1]
        own = np.where(largest < _UNLIMITED, largest, 1.0)
        self._torque_scale = own if torque_scale is None else positive("torque_scale", torque_scale)
        self._reward_scale = positive("reward_scale", reward_scale)
        self.render_mode = render_mode
        n_u = self._task.dynamics.control_dim
        self.observation_space = Box(
            -DIVERGENCE_BOUND, DIVERGENCE_BOUND, (len(self._task.observation.names),), np.float64
        )
        self.action_space = Box(-1.0, 1.0, (n_u,), np.float64)
        self.state = self._task.initial_state.copy()
        self._t = 0
        self._memory: Memory | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode near x_1, or exactly at x_1 if the options have `exact`."""
        super().reset(seed=seed)
        self.state = self._task.initial_state.copy()
        if not (options or {}).get("exact", False):
            task = self._task
            noise = self.np_random.standard_normal(task.initial_std.shape)
            self.state = task.dynamics.space.add(self.state, task.initial_std * noise)
        self._t, self._memory = 0, None
        return self._observed(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Applies torques for one step of the task, within the robot's limits."""
        task = self._task
        torques = self._torque_scale * np.asarray(action, dtype=float)
        torques = np.clip(torques, *task.dynamics.control_limits)
        cost = float(task.cost(self.state[None], torques[None], self._t)[0])
        if self._memory is not None and task.observation.past:
            self._memory = task.observation.past.acted(self._memory, torques[None])
        following = task.dynamics.step(self.state, torques)
        self._t += 1
        diverged = not np.all(np.abs(following) < DIVERGENCE_BOUND)
        if not diverged:
            self.state = following
        terminated = diverged or bool(task.fallen(self.state))
        truncated = not terminated and self._t >= task.horizon
        charged = cost + task.cost.rest(task.horizon - self._t, self._t).sum() * terminated
        reward = -self._reward_scale * charged
        return self._observed(), reward, terminated, truncated, {"cost": cost}

    def _observed(self) -> Array:
        """Returns what a policy reads now, shape (n_o,)."""
        context = self._task.planned_context
        observation = self._task.observation.within(context[min(self._t, len(context) - 1)])
        if not (past := observation.past):
            return observation(self.state)
        read = observation.readings(self.state)
        self._memory = past.following(self._memory, read[None])
        return observation(self.state, past.numbers(self._memory)[0, len(read) :])


_ENTRY_POINT = "vgps_ros.tasks.environment:TaskEnvironment"

register(id="vgps_ros/Task-v0", entry_point=_ENTRY_POINT)
for _task in BUILT_IN:
    register(
        id=f"vgps_ros/{_task.title().replace('_', '')}-v0",
        entry_point=_ENTRY_POINT,
        kwargs={"task": _task},
    )
