# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Executes a policy without ROS: MuJoCo steps, and the policy answers.

vgps train --task swimmer --iterations 20 --output recordings/swimmer
python examples/07_policy_without_ros.py recordings/swimmer
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

from vgps_ros.robot.executed_control import ExecutedPolicy
from vgps_ros.storage.run_folder import RunFolder, load_policy
from vgps_ros.tasks import recorded_task

SECONDS = 10.0

learned, name = load_policy(RunFolder(Path(sys.argv[1])).policy)
task, policy = recorded_task(name), ExecutedPolicy(learned)
model = task.dynamics.model
data = mujoco.MjData(model)
data.qpos[:], data.qvel[:] = np.split(task.initial_state, [model.nq])

low, high = task.dynamics.control_limits
state = np.concatenate([data.qpos, data.qvel])
first = state
for _ in range(round(SECONDS / task.dynamics.time_step)):
    inputs = task.observation(state)  # the readings that learned.architecture.observed names
    data.ctrl[:] = np.clip(policy.mean(inputs), low, high)
    mujoco.mj_step(model, data, nstep=task.dynamics.substeps)
    state = np.concatenate([data.qpos, data.qvel])
    if task.limits(state) or task.fallen(state):
        sys.exit(f"The robot fell after {data.time:.2f} s.")
print(f"It went {task.distance(first, state):.2f} m in {data.time:g} s.")
