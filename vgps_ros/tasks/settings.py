# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The settings that a task file holds, without its model: to show them takes no MuJoCo."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.settings import Setting, with_values
from vgps_ros.tasks.references import BUILT_IN, task_file_of


@dataclass(frozen=True)
class TaskSettings:
    """Settings that were measured to suit a task.

    Attributes:
        optimizer: of the trajectory optimisation.
        search: of a policy search, by dotted name; the others keep their defaults.
    """

    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    search: Mapping[str, Any] = field(default_factory=dict)


def task_settings(reference: str) -> TaskSettings:
    """Returns the settings of a task.

    Raises:
        InvalidInputError: there is no such task, or its file is wrong.
    """
    path = task_file_of(reference)
    if path is None:  # a function of Python, whose task has them
        from vgps_ros.tasks import make_task

        task = make_task(reference)
        return TaskSettings(task.optimizer, task.search)
    from vgps_ros.tasks.document import Entries
    from vgps_ros.tasks.task_file import read_task_file
    from vgps_ros.tasks.task_schema import flattened

    file, document = read_task_file(path)
    return TaskSettings(
        with_values(OptimizerSettings(), flattened(file.optimizer)),
        Entries(flattened(file.search), document, "search"),
    )


TASK = Setting(
    "task",
    "swimmer",
    f"control problem: {', '.join(BUILT_IN)}, a task file or its folder, or FILE.py:FUNCTION",
)
DEMONSTRATION = Setting(
    "demonstration",
    "",
    "table of a recorded motion to start from, or a policy (.json, .onnx) that makes it; the same "
    "for optimizer and learner; empty: the task's own start",
)
