# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Registers the tasks as Gymnasium environments when it is imported.

import gymnasium, vgps_ros.environments
environment = gymnasium.make("vgps_ros/Swimmer-v0")
environment = gymnasium.make("vgps_ros/Task-v0", task="hopper/task.yaml")
"""

from gymnasium.envs.registration import register

from vgps_ros.tasks import BUILT_IN

_ENTRY_POINT = "vgps_ros.environments.task_environment:TaskEnvironment"

register(id="vgps_ros/Task-v0", entry_point=_ENTRY_POINT)
for _task in BUILT_IN:
    register(
        id=f"vgps_ros/{_task.title().replace('_', '')}-v0",
        entry_point=_ENTRY_POINT,
        kwargs={"task": _task},
    )
