# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A quadruped learns to obey commands, and is driven: three minutes on two cores, without ROS.

python examples/09_quadruped.py
"""

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from vgps_ros.search.settings import search_settings
from vgps_ros.search.training import train
from vgps_ros.storage.run_folder import RunFolder, load_policy
from vgps_ros.tasks import make_task

iterations = int(os.environ.get("ITERATIONS", "8"))
folder = RunFolder(Path(os.environ.get("FOLDER") or tempfile.mkdtemp()))
task = make_task("quadruped")
settings = replace(search_settings(task), iterations=iterations)
period, model = task.dynamics.time_step, task.dynamics.model


def drive(policy, commands, rollouts=1, push=0.0):
    """Returns states under commands (T, 3), after pushes [N·s] all round, (rollouts, T+1, n_x)."""
    told = task.signals.turning.context(commands, task.signals.phases(len(commands), first=0.0))
    starts = np.tile(task.initial_state, (rollouts, 1))
    angles = 2 * np.pi * np.arange(rollouts) / rollouts
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    starts[:, model.nq : model.nq + 2] += push / model.body_mass.sum() * directions

    def law(t, states):
        return policy.mean(task.observation.within(told[t])(states))

    return task.dynamics.rollouts(starts, law, len(commands))[0]


def held(*legs):
    """Returns commands (ahead [m/s], left [m/s], turn [rad/s]), each held for some seconds."""
    return np.concatenate([np.tile(c, (round(s / period), 1)) for s, c in legs]).astype(float)


curve = []


def judge(done):
    """Tries the policy of an iteration: 0.6 m/s ahead, and 24 pushes of 25 N·s."""
    ahead = drive(done.policy, held((5, (0.6, 0, 0))))[0]
    pushed = drive(done.policy, held((5, (0, 0, 0))), rollouts=24, push=25.0)
    curve.append((task.distance(ahead[0], ahead[-1]) / 5, task.survived(pushed).mean()))
    speed, up = curve[-1]
    print(f"{done.k}: {speed:.2f} m/s of 0.6 m/s, {up:.0%} bear a push", flush=True)


train("vgps", task, settings, seed=0, output=folder, on_iteration=judge)
policy, _ = load_policy(folder.policy)
states = drive(policy, held((10, (0.6, 0, 0))))[0]
print(f"Asked to go 6 m ahead in 10 s, it goes {task.distance(states[0], states[-1]):.1f} m.")
