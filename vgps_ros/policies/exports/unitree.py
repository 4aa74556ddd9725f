# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy as Unitree's controller loads it: params/deploy.yaml and exported/policy.onnx."""

from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.policies.contract import VELOCITY_COMMANDS
from vgps_ros.policies.exports.terms import (
    COMMAND_NAMES,
    UNITREE_NAMES,
    TermNetwork,
    servo_policy_numbers,
    write_file,
)
from vgps_ros.policies.onnx_file import ExportedPolicy, model_of, network
from vgps_ros.tasks.task import Task


def write_unitree(task: Task, exported: ExportedPolicy, folder: Path) -> None:
    """Writes params/deploy.yaml and exported/policy.onnx, as unitree_rl_lab has them.

    Raises:
        InvalidInputError: the policy reads or gives what a deploy.yaml cannot say.
    """
    controls, signals = task.controls, task.signals
    numbers = servo_policy_numbers(task, exported, "a deploy.yaml", (*UNITREE_NAMES.values(),))
    n_u, origin = len(controls.names), controls.at_joints(np.array(exported.origin))
    sizes = {**dict.fromkeys(UNITREE_NAMES, 3), "gait_phase": 2}
    sizes |= dict.fromkeys(("joint_pos", "joint_vel", "last_action"), n_u)
    steps = {
        term: 1 + max(number.lag for number in numbers if number.term == term)
        for term in UNITREE_NAMES
        if any(number.term == term for number in numbers)
    }
    first, end = dict[str, int](), 0
    for term, count in steps.items():
        first[term], end = end, end + count * sizes[term]
    places = [
        first[n.term] + (steps[n.term] - 1 - n.lag) * sizes[n.term] + n.index for n in numbers
    ]
    offsets = [origin[n.index] * (n.term == "joint_pos") for n in numbers]
    build = TermNetwork()
    read = build.to_double("obs")
    signs = [number.sign for number in numbers]
    actions, _ = network(exported, build, build.pick(read, places, offsets, signs))
    build.give(actions, "actions")
    graph = build.graph([build.declaration("obs", 1, end)], [build.declaration("actions", 1, n_u)])
    ranges: dict[str, Any] = {key: [0.0, 0.0] for key in COMMAND_NAMES}
    for command in signals.commands:
        if command.source in VELOCITY_COMMANDS:
            name = COMMAND_NAMES[VELOCITY_COMMANDS.index(command.source)]
            ranges[name] = [float(command.lowest), float(command.highest)]
    observations = {
        UNITREE_NAMES[term]: {"params": {"period": signals.period} if term == "gait_phase" else {},
                              "clip": None, "scale": [1.0] * sizes[term], "history_length": count}
        for term, count in steps.items()
    }  # fmt: skip
    action = {"clip": None, "joint_names": [".*"], "scale": controls.scale.tolist(),
              "offset": origin.tolist(), "joint_ids": None}  # fmt: skip
    said = {"joint_ids_map": [*range(n_u)], "step_dt": task.dynamics.time_step,
            "stiffness": controls.stiffness.tolist(), "damping": controls.damping.tolist(),
            "default_joint_pos": origin.tolist(),
            "commands": {"base_velocity": {"ranges": {**ranges, "heading": None}}},
            "actions": {"JointPositionAction": action}, "observations": observations}  # fmt: skip
    write_file(folder / "exported" / "policy.onnx", model_of(graph, {}))
    write_file(folder / "params" / "deploy.yaml", said)
