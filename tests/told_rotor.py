# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A rotor that turns at a commanded speed, and swings with a clock."""

import functools
from pathlib import Path

from vgps_ros.tasks import Task, make_task
from vgps_ros.tasks.registry import task_file_of

TASK = """\
model: rotor.xml
control_period: 0.05
horizon: 1.0
start: {std: {position: 0.05, velocity: 0.05}, varied: {position: 0.5, velocity: 0.5}}
commands:
  speed: {range: [-1.0, 2.0], from: cmd_vel/angular/z, unit: rad/s}
clock: {frequency: 1.0}
cost:
  - {sensor: rotor/velocity, target: {command: speed, rest: 0.5}}
  - {sensor: rotor/position, target: {swing: 0.3, phase: 0.25}, weight: 0.1}
  - {control: all, weight: 0.1, pose: turned}
observe: [commands, joint_positions, joint_velocities, clock]
search: {hidden_units: [4], evaluation_rollouts: 2}
"""


def write_task(folder: Path, *changes: tuple[str, str]) -> str:
    """Writes the rotor and its task, with some text changed; returns the task's path."""
    text = TASK
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    model = (task_file_of("rotor").parent / "rotor.xml").read_text()
    keyframe = '<keyframe><key name="turned" qpos="0.25"/></keyframe></mujoco>'
    (folder / "rotor.xml").write_text(model.replace("</mujoco>", keyframe))
    (folder / "task.yaml").write_text(text)
    return str(folder / "task.yaml")


def maker(path: str) -> "functools.partial[Task]":
    """Returns what makes the task in another process."""
    return functools.partial(make_task, path)
