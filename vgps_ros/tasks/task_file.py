# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a task file: a control problem as data, in one YAML file beside a robot's MJCF.

For example, a pendulum that is swung up:

    # yaml-language-server: $schema=/path/of/vgps_ros/tasks/task.schema.json
    model: pendulum.xml
    control_period: 0.02                                     # [s]
    horizon: 3.0                                             # [s]
    sensors:
      tip: {type: framepos, site: tip}
    cost:
      - {sensor: tip, index: z, target: 1.0}
      - {control: all, weight: 1.0e-3}
    observe: [{joint: hinge, as: sin_cos}, joint_velocities]
    begin: {law: noise, std: 1.0}                            # [N·m]

The first line makes editors that know yaml-language-server check the file and show descriptions; it
names the path of `task.schema.json`, which lies beside this module. `schema` has all keys.
"""

import importlib.util
import os
import re
from pathlib import Path

from vgps_ros.core.checks import quoted
from vgps_ros.tasks.checks import check_task_file
from vgps_ros.tasks.schema import TaskFile
from vgps_ros.tasks.yaml_file import Document, as_record, read_document

SCHEMA_PATH = Path(__file__).resolve().with_name("task.schema.json")
_PACKAGE = re.compile(r"package://([A-Za-z]\w*)/(.+)")


def read_task_file(path: Path) -> tuple[TaskFile, Document]:
    """Reads a task file, and checks all that needs no model.

    Args:
        path: the file, or a folder with a `task.yaml`.

    Returns:
        The task, and the document, which knows the line of each entry for later errors.

    Raises:
        InvalidInputError: the file cannot be read, or an entry is wrong.
    """
    document = read_document(path / "task.yaml" if os.path.isdir(path) else path)
    task = as_record(document, TaskFile)
    check_task_file(task, document)
    find_model(task, document)
    return task, document


def find_model(task: TaskFile, document: Document) -> Path:
    """Returns the path of the task's model.

    `package://PACKAGE/PATH` is a file of a Python package, which is not imported, or of the shared
    folder of a ROS package.

    Raises:
        InvalidInputError: there is no such package or file.
    """
    if not task.model.startswith("package:"):
        return document.existing(("model",), document.path.parent, task.model)
    found = _PACKAGE.fullmatch(task.model)
    if not found or ".." in Path(found[2]).parts:
        raise document.error(
            ("model",),
            f"it is {quoted(task.model)}, but it must be package://PACKAGE/PATH inside a package.",
        )
    folders = _package_folders(found[1])
    document.refuse(
        not folders,
        ("model",),
        f"there is no package {found[1]}, neither of Python nor in AMENT_PREFIX_PATH; install it, "
        "or source its workspace.",
    )
    existing = (folder for folder in folders if (folder / found[2]).is_file())
    return document.existing(("model",), next(existing, folders[0]), found[2])


def _package_folders(name: str) -> list[Path]:
    """Returns the folders of a Python package and of a ROS package of this name."""
    try:
        found = importlib.util.find_spec(name)
    except (ImportError, ValueError):  # of modules that are half there
        found = None
    python = (found.submodule_search_locations if found else None) or []
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    shared = [Path(prefix) / "share" / name for prefix in prefixes]
    return [folder for folder in (*map(Path, python), *shared) if folder.is_dir()]
