# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reinforcement learning by Stable-Baselines3, as far as a goal.

Its settings are those that its own zoo has for the MuJoCo environment of the same name (Swimmer-v4
and Walker2d-v4 for PPO, v3 for SAC): tuned for other costs, but for robots of the same kind.
"""

from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import vgps_ros.tasks.environment  # noqa: F401  registers them
from benchmarks.problems import SEED
from benchmarks.reinforcement import Goal, Outcome, Stopwatch
from vgps_ros.core.records import Array
from vgps_ros.simulation.dynamics import ControlLaw
from vgps_ros.tasks import Task

# By algorithm and task; what is not here is Stable-Baselines3's default, as in the zoo.
ZOO: dict[type[BaseAlgorithm], dict[str, dict[str, Any]]] = {
    PPO: {
        "swimmer": {
            "n_steps": 1024,
            "batch_size": 256,
            "learning_rate": 6e-4,
            "gamma": 0.9999,
            "gae_lambda": 0.98,
        },
        "walker": {
            "n_steps": 512,
            "batch_size": 32,
            "learning_rate": 5.05041e-05,
            "ent_coef": 0.000585045,
            "clip_range": 0.1,
            "n_epochs": 20,
            "max_grad_norm": 1.0,
            "vf_coef": 0.871923,
        },
    },
    SAC: {
        "swimmer": {"gamma": 0.9999, "learning_starts": 10_000},
        "walker": {"learning_starts": 10_000},
    },
}
# Torque of an action of 1, about the largest of the DDP solution [N·m].
TORQUE_SCALE = {"swimmer": 100.0, "walker": 200.0}
ENVIRONMENTS = {PPO: {"swimmer": 4, "walker": 1}, SAC: {"swimmer": 1, "walker": 1}}
_CRITICS: dict[type[BaseAlgorithm], dict[str, list[int]]] = {
    PPO: {"vf": [64, 64]},
    SAC: {"qf": [256, 256]},
}
_LOOK_PERIOD = 2048  # steps between two looks at a peer's policy


def learn(
    algorithm: type[BaseAlgorithm],
    task: Task,
    goal: Goal,
    hidden_units: int | None,
    limit: float,
    seed: int = SEED,
    steps: int = 10**9,
) -> Outcome:
    """Trains a peer until its policy reaches the goal, for some time at most.

    Args:
        algorithm: of Stable-Baselines3.
        task: what it learns.
        goal: where it ends.
        hidden_units: width of the one hidden layer of soft rectifiers; None: its own network.
        limit: wall time [s].
        seed: of its draws.
        steps: control steps after which it ends in any case.
    """
    torch.set_num_threads(1)  # the fastest for networks of this size
    settings = dict(ZOO[algorithm][task.name])
    if hidden_units:
        settings["policy_kwargs"] = {
            "net_arch": {"pi": [hidden_units], **_CRITICS[algorithm]},
            "activation_fn": torch.nn.Softplus,
        }
    environment, look = environments(algorithm, task, seed), Look(task, goal, limit)
    model = algorithm("MlpPolicy", environment, seed=seed, device="cpu", **settings)
    model.set_logger(Logger(folder=None, output_formats=[]))  # its own makes a folder in /tmp
    model.learn(total_timesteps=steps, callback=look)
    environment.close()
    reached = look.best <= goal.bound
    done = model.num_timesteps * task.dynamics.substeps
    return Outcome(reached, look.seconds, done, done, look.best, tuple(look.curve))


def environments(algorithm: type[BaseAlgorithm], task: Task, seed: int = SEED) -> VecEnv:
    """Returns what the algorithm learns in, as many side by side and normalised as in the zoo."""
    gamma = ZOO[algorithm][task.name].get("gamma", 0.99)
    number = ENVIRONMENTS[algorithm][task.name]
    name = task.name.title().replace("_", "")
    own = {"render_mode": None, "torque_scale": TORQUE_SCALE[name]}
    found = make_vec_env(f"vgps_ros/{name}-v0", number, seed=seed, env_kwargs=own)
    return VecNormalize(found, gamma=gamma) if algorithm is PPO else found


class Look(BaseCallback):
    """Looks at a peer's policy now and then, and ends its training at the goal or the limit."""

    def __init__(self, task: Task, goal: Goal, limit: float):
        super().__init__()
        self._task, self._goal, self._limit = task, goal, limit
        self._watch, self._next = Stopwatch(), _LOOK_PERIOD
        self.best = float("inf")
        self.curve: list[tuple[int, float]] = []
        self.seconds = 0.0

    def _on_step(self) -> bool:
        self.seconds = self._watch.seconds
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + _LOOK_PERIOD
            with self._watch.stopped():
                figure = self._goal.measure(self._task, control_law(self.model, self._task))
            self.best = min(self.best, figure)
            self.curve.append((self.num_timesteps * self._task.dynamics.substeps, figure))
        return self.best > self._goal.bound and self.seconds < self._limit


def control_law(model: BaseAlgorithm, task: Task) -> ControlLaw:
    """Returns a peer's policy without its noise, in torques."""
    normalizer = model.get_vec_normalize_env()
    scale = TORQUE_SCALE[task.name]

    def law(_: int, states: Array) -> Array:
        observed = task.observation(states)
        seen = normalizer.normalize_obs(observed) if normalizer else observed
        return scale * np.asarray(model.predict(seen, deterministic=True)[0], dtype=float)

    return law
