"""A control problem as reinforcement learning sees it."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from vgps_ros.core.checks import positive
from vgps_ros.core.dynamics import DIVERGENCE_BOUND
from vgps_ros.core.records import Array
from vgps_ros.tasks import make_task

# What an action of 1 means: about the largest torque of the DDP solution [N·m].
TORQUE_SCALE = {"swimmer": 100.0, "walker": 200.0}


class TaskEnvironment(gymnasium.Env[Array, Array]):
    """One task: the reward is the negative cost, an episode the horizon that is scored.

    The observation is what a policy of the task reads, the action the torques in units of
    `torque_scale`. A robot that falls ends the episode; what lying still costs until the horizon's
    end is charged at once, so that falling early never pays.

    Args:
        task: its name.
        torque_scale: torque of an action of 1 [N·m]; if None the task's own, or 1.
        reward_scale: factor of the reward.
        render_mode: as Gymnasium hands it over; None is the only one.

    Attributes:
        state: x of the simulator, shape (n_x,).

    Raises:
        InvalidInputError: the task is unknown, or a scale is not positive.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        task: str,
        torque_scale: float | None = None,
        reward_scale: float = 1.0,
        render_mode: str | None = None,
    ):
        self._task = make_task(task)
        own = TORQUE_SCALE.get(task, 1.0)
        self._torque_scale = positive("torque_scale", own if torque_scale is None else torque_scale)
        self._reward_scale = positive("reward_scale", reward_scale)
        self.render_mode = render_mode
        self._observed = list(self._task.observed)
        n_u = self._task.dynamics.control_dim
        self.observation_space = Box(
            -DIVERGENCE_BOUND, DIVERGENCE_BOUND, (len(self._observed),), np.float64
        )
        self.action_space = Box(-1.0, 1.0, (n_u,), np.float64)
        self.state = self._task.initial_state.copy()
        self._t = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode around x_1, or at x_1 where options has `exact`."""
        super().reset(seed=seed)
        self.state = self._task.initial_state.copy()
        if not (options or {}).get("exact", False):
            noise = self.np_random.standard_normal(self.state.shape)
            self.state += self._task.initial_std * noise
        self._t = 0
        return self.state[self._observed], {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Holds torques for one step of the task."""
        task = self._task
        torques = self._torque_scale * np.asarray(action, dtype=float)
        cost = float(task.cost(self.state, torques))
        following = task.dynamics.step(self.state, torques)
        self._t += 1
        diverged = not np.all(np.abs(following) < DIVERGENCE_BOUND)
        if not diverged:
            self.state = following
        terminated = diverged or bool(task.fallen(self.state))
        truncated = not terminated and self._t >= task.horizon
        charged = cost + (task.horizon - self._t) * task.cost.rest * terminated
        reward = -self._reward_scale * charged
        return self.state[self._observed], reward, terminated, truncated, {"cost": cost}
