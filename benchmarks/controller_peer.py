# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""PPO of Stable-Baselines3 on the quadruped's task, judged as `vgps evaluate` judges ours.

    python -m benchmarks.controller_peer --seed 0 --minutes 20 --output recordings/ppo

Many robots step side by side in one compiled loop. Their commands, clocks, falls, sensor noise and
late readings are the task's; their pushes are as strong, but jumps of velocity. The policy and the
critic read what the task's policy reads. The reward is that of legged_gym for the commands, less a
share of the task's own cost, which tells of feet, height and pose; as there it is never negative,
so that no fall pays. Time is that of processors, since other programs run beside. In the second
half the policy is tried in the rollouts by which a training of ours chooses its policy, as often as
that does, and the best one is kept.

Settings that `benchmarks.rivals` tunes can be given: `--settings '{"learning_rate": 0.0005}'`.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.search.judgement import CommandReadings
from vgps_ros.search.selection import Performance, finish, try_policy
from vgps_ros.search.settings import search_settings
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import Task, make_task

ROBOTS = 512
EPISODE = 20.0  # [s]
CHANGE = 3.0  # mean time between two changes of the commands [s]
PUSH = 4.0  # mean time between two pushes [s]
ACTION = 0.3  # change of a target for an action of 1 [rad]
HIDDEN = (128, 128)
TRIES = 11  # of policies, at times spread evenly over the second half
# Near those of legged_gym and rsl_rl for flat ground, which have 4,096 robots, a step size that
# follows the divergence, twice the entropy, a smaller network and more rewards.
FIXED: dict[str, Any] = {"n_epochs": 5, "gamma": 0.99, "gae_lambda": 0.95, "max_grad_norm": 1.0}
BATCHES = 4  # in each pass over what was collected
FIRST: dict[str, float] = {
    "learning_rate": 1e-3,
    "target_kl": 0.02,
    "ent_coef": 0.005,
    "n_steps": 24,
    "sigma": 0.25,  # of the rewards of commands, as legged_gym has it
    "cost": 0.05,  # factor of the task's cost in the reward
}


class Robots(VecEnv):
    """Quadrupeds side by side, which are told a speed ahead, one sideways and a turn.

    Args:
        task: what they learn.
        seed: of starts, commands and pushes.
        sigma: of the rewards of commands.
        cost: factor of the task's cost in the reward.

    Attributes:
        states: of the robots, shape (N, n_x).
        pushed: the states before the last step, after its pushes.
    """

    def __init__(self, task: Task, seed: int, sigma: float, cost: float):
        self._task, self._rng = task, np.random.default_rng(seed)
        self._sigma, self._cost = sigma, cost
        self._achieved = CommandReadings.of(task)
        self._settings = search_settings(task)
        self._largest_push = self._settings.renew.push / task.dynamics.model.body_mass.sum()
        n_o, n_u = len(task.observation.names), task.dynamics.control_dim
        read = Box(-np.inf, np.inf, (n_o,), np.float32)
        spaces = read, Box(-10.0, 10.0, (n_u,), np.float32)
        super().__init__(ROBOTS, *spaces)
        self.states = np.tile(task.initial_state, (ROBOTS, 1))
        self._read, augmentation = self.states.copy(), task.augmentation
        self._noise = augmentation.noise if augmentation else np.zeros(n_o)
        self._commands = np.zeros((ROBOTS, len(task.signals.commands)))
        self._awake = np.zeros(ROBOTS, dtype=np.int64)  # steps for which clocks still turn
        self._phases, self._ages = np.zeros(ROBOTS), np.zeros(ROBOTS)
        self.pushed, self._actions = self.states.copy(), np.zeros((ROBOTS, n_u))

    def _begin(self, rows: NDArray[np.int_]) -> None:
        task, count = self._task, len(rows)
        noise = task.initial_std * self._rng.standard_normal((count, len(task.initial_std)))
        starts = np.tile(task.initial_state, (count, 1))
        self.states[rows] = self._read[rows] = task.dynamics.space.add(starts, noise)
        self._awake[rows] = 0
        self._phases[rows] = self._rng.uniform(size=count)
        self._ages[rows] = 0.0
        self._tell(rows)

    def _tell(self, rows: NDArray[np.int_]) -> None:
        draw, settings = self._task.signals.draw, self._settings.commands
        for row in rows:
            self._commands[row] = draw(self._rng, settings)

    def context(self) -> Array:
        """Returns z of each robot, shape (N, n_z)."""
        signals, told = self._task.signals, (self._commands, self._phases)
        turning, calm = signals.turning.context(*told), signals.context(*told)
        return np.where((self._awake > 0)[:, None], turning, calm)

    def _observed(self) -> Array:
        observed = self._task.observation.within(self.context())(self._read)
        observed += self._noise * self._rng.standard_normal(observed.shape)
        return observed.astype(np.float32)

    def reset(self) -> Array:
        """Begins all episodes, at ages that differ, so that they do not end together."""
        self._begin(np.arange(ROBOTS))
        self._ages[:] = self._rng.uniform(0.0, EPISODE, ROBOTS)
        return self._observed()

    def step_async(self, actions: Array) -> None:
        """Takes the actions of all robots."""
        self._actions = np.asarray(actions, dtype=float)

    def step_wait(self) -> tuple[Array, Array, Any, list[dict[str, Any]]]:
        """Does a control step of all robots."""
        task, period = self._task, self._task.dynamics.time_step
        self._push()
        self.pushed = self.states.copy()
        controls = np.clip(targets(task, self._actions), *task.dynamics.control_limits)
        reward = self._reward(controls)
        states, _, _ = task.dynamics.rollouts(self.states, lambda *_: controls, 1)
        is_lost = np.logical_not(np.isfinite(states[:, 1]).all(axis=1))
        self._read = self.states  # which a share of the policies reads a step late
        self.states = np.where(is_lost[:, None], self.states, states[:, 1])
        is_late = self._rng.uniform(size=ROBOTS) < self._settings.fit.late
        self._read = np.where(is_late[:, None], self._read, self.states)
        if unrest := task.unrest:
            left = np.maximum(self._awake - 1, 0)
            self._awake = np.where(unrest.restless(self.states), unrest.steps, left)
        self._phases = (self._phases + task.signals.frequency * period) % 1.0
        self._ages += period
        fell = np.logical_or(is_lost, task.fallen(self.states))
        done = fell | (self._ages >= EPISODE)
        infos: list[dict[str, Any]] = [{} for _ in range(ROBOTS)]
        if (rows := np.flatnonzero(done)).size:
            last = self._observed()
            for row in rows:
                infos[row] = {
                    "terminal_observation": last[row],
                    "TimeLimit.truncated": not fell[row],
                }
            self._begin(rows)
        self._tell(np.flatnonzero(self._rng.uniform(size=ROBOTS) < period / CHANGE))
        return self._observed(), reward, done, infos

    def _push(self) -> None:
        """Gives some robots a push of sizes as in our training, as a jump of velocity."""
        rows = np.flatnonzero(self._rng.uniform(size=ROBOTS) < self._task.dynamics.time_step / PUSH)
        sizes = self._largest_push * np.sqrt(self._rng.uniform(0.1, 1.0, len(rows)))
        turned = self._rng.uniform(0.0, 2.0 * np.pi, len(rows))
        first = self._task.dynamics.model.nq  # the base's velocity, in the world
        self.states[rows, first : first + 2] += sizes[:, None] * np.stack(
            [np.cos(turned), np.sin(turned)], axis=1
        )

    def _reward(self, controls: Array) -> Array:
        """Returns the reward of each robot: N robots are N steps to the task's cost."""
        context, period = self.context(), self._task.dynamics.time_step
        both = np.concatenate([self.states, self.states[-1:]])
        errors = self._achieved.errors(both[None], controls[None], context[None])[0]
        obeys = np.exp(-(errors[:, :2] ** 2).sum(axis=1) / self._sigma)
        obeys += 0.5 * np.exp(-(errors[:, 2] ** 2) / self._sigma)
        cost = self._task.cost.in_context(context)(self.states, controls)
        reward = np.maximum(obeys - self._cost * cost, 0.0)
        return np.asarray(period * reward, dtype=np.float32)

    def close(self) -> None:
        """Closes nothing, as the robots hold nothing open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Returns an attribute, once for each robot."""
        return [getattr(self, attr_name, None)] * ROBOTS

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        """Is not there: the robots are one environment."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Says that none is wrapped."""
        return [False] * ROBOTS


def targets(task: Task, actions: Array) -> Array:
    """Returns the servos' targets of actions."""
    return np.asarray(resting(task) + ACTION * actions)


def resting(task: Task) -> Array:
    """Returns the targets at which the robot stands, shape (n_u,)."""
    return np.asarray(task.cost.control_targets)


def as_policy(model: PPO, task: Task) -> GaussianPolicy:
    """Returns the network of an actor, normalisation and scale of actions within."""
    normalizer = model.get_vec_normalize_env()
    assert normalizer is not None
    rms = cast(RunningMeanStd, normalizer.obs_rms)
    layers = [
        (layer.weight.detach().numpy().astype(float), layer.bias.detach().numpy().astype(float))
        for layer in (*model.policy.mlp_extractor.policy_net, model.policy.action_net)
        if isinstance(layer, torch.nn.Linear)
    ]
    first, bias = layers[0]
    first = first / np.sqrt(rms.var + normalizer.epsilon)
    layers[0] = first, bias - first @ rms.mean
    last, bias = layers[-1]
    layers[-1] = ACTION * last, resting(task) + ACTION * bias
    shape = Architecture(task.observation.names, HIDDEN, task.dynamics.control_dim, "tanh")
    parameters = np.concatenate([np.r_[w.ravel(), b] for w, b in layers])
    std = ACTION * np.exp(model.policy.log_std.detach().numpy().astype(float))
    return GaussianPolicy(shape, parameters, std)


class Choice(BaseCallback):
    """Tries policies in the second half of the time, which begins with the program."""

    def __init__(self, task: Task, output: Path, seed: int, minutes: float):
        super().__init__()
        self._task, self._output, self._seed = task, output, seed
        self._settings, self._seconds = search_settings(task), 60.0 * minutes
        self._best: Performance | None = None
        self._tried = 0

    def _on_step(self) -> bool:
        return time.process_time() < self._seconds

    def _on_rollout_end(self) -> None:
        if time.process_time() >= 0.5 * self._seconds * (1.0 + self._tried / (TRIES - 1)):
            self._try()

    def _try(self) -> None:
        self._tried += 1
        policy = as_policy(cast(PPO, self.model), self._task)
        tried = try_policy(self._task, self._settings, self._seed, policy, self._tried)
        if self._best is None or tried.beats(self._best):
            self._best = tried
        self._note(tried)

    def _on_training_end(self) -> None:
        self._try()
        assert self._best
        best = finish(self._task, self._settings, self._seed, self._best)
        self._note(best)
        save_policy(best.policy, self._task.name, self._output / "policy.json")

    def _note(self, tried: Performance) -> None:
        row = {
            "try": tried.k,
            "processor_seconds": round(time.process_time(), 1),
            "simulator_steps": self.num_timesteps * self._task.dynamics.substeps,
            "noise": tried.policy.noise_std.mean(),
            "success": tried.success,
            "loss": tried.loss,
        }
        with (self._output / "rows.jsonl").open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(json.dumps(row), flush=True)


def main() -> None:
    """Trains for some minutes of processor time."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--settings", type=json.loads, default={}, help="in JSON")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True)
    torch.set_num_threads(1)
    task = make_task("quadruped")
    own = FIRST | arguments.settings
    robots = Robots(task, arguments.seed, own.pop("sigma"), own.pop("cost"))
    model = PPO(
        "MlpPolicy",
        VecNormalize(robots, norm_reward=True, gamma=FIXED["gamma"]),
        seed=arguments.seed,
        device="cpu",
        policy_kwargs={"net_arch": {"pi": list(HIDDEN), "vf": list(HIDDEN)}},
        batch_size=ROBOTS * int(own["n_steps"]) // BATCHES,
        **own,
        **FIXED,
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    model.learn(10**9, Choice(task, arguments.output, arguments.seed, arguments.minutes))


if __name__ == "__main__":
    main()
