# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A swimmer learns in this process, without ROS, and swims with its policy.

python examples/02_swimmer.py [FOLDER]
"""

import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from vgps_ros.search.settings import search_settings
from vgps_ros.search.training import train
from vgps_ros.storage.run_folder import RunFolder, load_policy
from vgps_ros.tasks import make_task

iterations = int(os.environ.get("ITERATIONS", "20"))
folder = RunFolder(Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()))

task = make_task("swimmer")
settings = replace(search_settings(task), iterations=iterations, hidden_units=(5,))
train(
    "vgps", task, settings, seed=0, output=folder,
    on_iteration=lambda done: print(f"{done.k}: policy {done.deterministic_cost:.1f}, "
                                    f"DDP {done.ddp_cost:.1f}", flush=True),
)  # fmt: skip

policy, _ = load_policy(folder.policy)
swim = task.dynamics.rollout(
    task.initial_state, lambda t, x: policy.mean(task.observation(x)), task.horizon
)
distance = task.distance(swim.states[0], swim.states[-1])
print(f"It swims {distance:.2f} m in {task.horizon * task.dynamics.time_step:g} s.")
print(f"`vgps plot {folder.path}` draws it.")
