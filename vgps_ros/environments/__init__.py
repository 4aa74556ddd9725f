"""Registers the tasks as Gymnasium environments when it is imported.

import gymnasium, vgps_ros.environments
environment = gymnasium.make("vgps_ros/Swimmer-v0")
"""

from gymnasium.envs.registration import register

for _task in ("swimmer", "walker"):
    register(
        id=f"vgps_ros/{_task.capitalize()}-v0",
        entry_point="vgps_ros.environments.task_environment:TaskEnvironment",
        kwargs={"task": _task},
    )
