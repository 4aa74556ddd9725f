# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Resolves what a user calls a task by: a name, a task file or its folder, or a Python function.

Names are those of the folders beside this module, and of the entry-point group `vgps_ros.tasks`,
through which other packages offer tasks. An entry point is a function that returns a `Task`. A
task's settings are read without its model, so that help which shows them takes no MuJoCo.
"""

import os
import runpy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from vgps_ros.core.checks import nearest, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.settings import Setting

_FOLDER = Path(__file__).parent
BUILT_IN = tuple(sorted(path.parent.name for path in _FOLDER.glob("*/task.yaml")))
_FORMS = "a task file (.yaml) or its folder, or FILE.py:FUNCTION"


def task_names() -> list[str]:
    """Returns the names of all tasks that are installed, those of other packages too."""
    return [*BUILT_IN, *(point.name for point in entry_points(group="vgps_ros.tasks"))]


def task_file_of(reference: str) -> Path | None:
    """Returns the task file that a reference stands for; None if it stands for Python code.

    Raises:
        InvalidInputError: there is no such task; the message has what there is.
    """
    if reference in BUILT_IN:
        return _FOLDER / reference / "task.yaml"
    if _function_of(reference) or _installed_task(reference):
        return None
    path = Path(reference).expanduser()
    if path.suffix in (".yaml", ".yml") or (path / "task.yaml").is_file():
        return path / "task.yaml" if path.is_dir() else path
    names = task_names()
    raise InvalidInputError(
        f"There is no task {quote(reference)}; name one of {', '.join(names)}, {_FORMS}."
        f"{nearest(reference, names)}"
    )


def task_function_of(reference: str) -> Callable[[], Any] | None:
    """Returns the function that makes a task; None if its task file says all.

    Raises:
        InvalidInputError: the reference names a file or function that is not there.
    """
    if reference in BUILT_IN:
        if not (_FOLDER / reference / "task.py").is_file():
            return None
        found: Any = import_module(f"vgps_ros.tasks.{reference}.task")
        return found.task
    if function := _function_of(reference):
        return _load_function(*function)
    point = _installed_task(reference)
    return point.load() if point else None


def copy_of(reference: str, folder: Path) -> tuple[dict[str, Any], dict[Path, Path]]:
    """Returns what a task's file says, for one in another folder, and which tables go with it.

    Raises:
        InvalidInputError: there is no such task, or Python code makes it.
    """
    from vgps_ros.tasks.task_file import find_model, read_document

    path = task_file_of(reference)
    if path is None or task_function_of(reference):
        raise InvalidInputError(
            f"The task {reference} is made by Python code, but a new task file begins with one "
            "that is there; name a task that is one."
        )
    content = read_document(path).data
    if not content["model"].startswith("package:"):
        content["model"] = os.path.relpath(find_model(content["model"], path.parent), folder)
    begin, is_elsewhere = content.get("begin"), folder.resolve() != path.parent.resolve()
    table = begin.get("file") if isinstance(begin, dict) and is_elsewhere else None
    return content, {path.parent / table: folder / table} if table else {}


def runs_code(reference: str) -> bool:
    """Returns whether to make a task means to run a file that is not installed."""
    return _function_of(reference) is not None


def _function_of(reference: str) -> tuple[Path, str] | None:
    path, _, name = reference.rpartition(":")
    return (Path(path).expanduser(), name) if path.endswith(".py") else None


def _installed_task(name: str) -> EntryPoint | None:
    found = entry_points(group="vgps_ros.tasks", name=name)
    return next(iter(found), None)


@cache  # a file is run once
def _load_function(path: Path, name: str) -> Callable[[], Any]:
    """Runs a file, and returns a function of it."""
    if not path.is_file():
        raise InvalidInputError(f"There is no file {quote(str(path))}; name {_FORMS}.")
    try:
        found = runpy.run_path(str(path))
    except Exception as error:
        raise InvalidInputError(f"{path} does not run: {type(error).__name__}: {error}.") from error
    function: Any = found.get(name)
    if not callable(function):
        known = [key for key, value in found.items() if callable(value)]
        raise InvalidInputError(f"{path} has no function {quote(name)}.{nearest(name, known)}")
    return function


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
    from vgps_ros.tasks.task_file import read_task_file, settings_in

    return TaskSettings(*settings_in(*read_task_file(path)))


TASK = Setting(
    "task",
    "swimmer",
    f"control problem: {', '.join(BUILT_IN)}, a task file or its folder, or FILE.py:FUNCTION",
)
DEMONSTRATION = Setting(
    "demonstration",
    "",
    "table of a recorded motion to start from, or a policy (.json, .onnx) that "
    "makes it; the same for optimizer and learner; empty: the task's own start",
)
