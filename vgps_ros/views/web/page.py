# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a page on which anyone drives an exported policy in a browser.

The page is one file, which opens by a double click, from any server, and from a letter. It holds
MuJoCo's own WebAssembly, ONNX Runtime, three.js, the robot's MJCF and the policy's ONNX file, each
compressed; no request leaves it. What the policy reads is described here by MuJoCo's own numbers,
so its programs know nothing of tasks. It does not use `mjswan`, the package for such pages, which
needs mujoco 3.11.0 exactly, so that it cannot be installed beside our MuJoCo 4, and takes 45 MB.
"""

import base64
import gzip
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.observation import StateReadings
from vgps_ros.policies.onnx_file import ExportedPolicy
from vgps_ros.robot.deployment import Conditions
from vgps_ros.robot.signals import Command
from vgps_ros.robot.unrest import RATE, TILT, Unrest
from vgps_ros.simulation.frames import frame_names
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks import Task
from vgps_ros.views.robot_shape import RobotShape
from vgps_ros.views.web import PAGE_FILES

_HERE = Path(__file__).resolve().parent
PARTS = _HERE / "parts"  # what scripts/build_web_parts.bash writes
_NAMES = (
    *("three.core.js", "three.module.js", "OrbitControls.js", "mujoco.js", "mujoco.wasm"),
    *("ort.wasm.bundle.min.mjs", "ort-wasm-simd-threaded.wasm", "licences.txt"),
)
# Which of the speeds that the page measures a command is about: ahead, to the left, turning.
_AXES = {"cmd_vel/linear/x": 0, "cmd_vel/linear/y": 1, "cmd_vel/angular/z": 2}
_PROGRAMS = ("robot.js", "view.js", "page.js")


def page_of(
    task: Task, exported: ExportedPolicy, content: bytes, facts: Mapping[str, str]
) -> dict[str, bytes]:
    """Returns the files of the page by name: its own, and what others may want of what it holds.

    Args:
        task: the task of the policy.
        exported: the policy.
        content: its ONNX file.
        facts: what the page says of itself, such as the commit, by name.

    Raises:
        InvalidInputError: the policy reads something that the page cannot compute.
        VgpsError: the page's parts are missing.
    """
    mjcf = for_older_mujoco(task.mjcf).encode()
    robot = json.dumps({**_page_values(task, exported), "facts": dict(facts)}, allow_nan=False)
    held = {"robot.json": robot.encode(), "robot.xml": mjcf, "policy.onnx": content}
    parts = {name: _part(name) for name in _NAMES} | {
        name: base64.b64encode(gzip.compress(each, mtime=0)).decode() for name, each in held.items()
    }
    page = (_HERE / "page.html").read_text(encoding="utf-8")
    for mark, lines in {
        "<!-- contents -->": [
            f'<script type="text/plain" id="{name}">{part}</script>' for name, part in parts.items()
        ],
        "/* programs */": [(_HERE / name).read_text(encoding="utf-8") for name in _PROGRAMS],
    }.items():
        page = page.replace(mark, "\n".join(lines))
    return dict(zip(PAGE_FILES, (page.encode(), content, mjcf), strict=True))


def for_older_mujoco(mjcf: str) -> str:
    """Returns an MJCF that MuJoCo 3.14 reads, too, the newest that runs in browsers.

    MuJoCo 4 writes what the input of each actuator is, which changes nothing of its forces.
    """
    return re.sub(r'(<general\b[^>]*?) input="(?:pos|vel)"', r"\1", mjcf)


def _part(name: str) -> str:
    """Returns a part of the page, compressed, as base64."""
    try:
        return (PARTS / name).read_text(encoding="ascii")
    except FileNotFoundError as error:
        raise VgpsError(
            f"The page needs the part {name}, which is fetched once: run `make web`."
        ) from error


def _page_values(task: Task, exported: ExportedPolicy) -> dict[str, Any]:
    """Returns what the page has to know of a task and its policy."""
    model, layout, signals = task.dynamics.model, task.deployment.layout, task.signals
    frames, past = frame_names(model), task.observation.past
    base = frames.index(layout.base_frame)
    moves = layout.base is not None or layout.planar is not None
    origin = np.array(exported.origin or np.zeros(task.dynamics.control_dim))
    acts = past is not None and past.actions
    ahead = Command("ahead", 0.0, 0.0, "cmd_vel/linear/x", "m/s")
    return {
        "name": task.name,
        "period": task.dynamics.time_step,
        "substeps": task.dynamics.substeps,
        "state": task.initial_state.tolist(),
        "readings": _reads(task.observation.readings),
        "fallen": _falls(task.fallen),
        "history": past.history if past else 0,
        "first_action": (past.resting - origin).tolist() if past and acts else [],
        "context": list(task.observation.columns),
        "frequency": signals.frequency,
        "unrest": _unrest(task.unrest),
        "commands": [_command(command) for command in signals.commands],
        "speeds": [_command(ahead)] if moves else [],
        "origin": origin.tolist(),
        "precision": exported.precision,
        "base": base,
        "pushed": base if moves else model.nbody - 1,
        "above": RobotShape(model).plane == (0, 1),
    }


def _unrest(unrest: Unrest | None) -> dict[str, Any] | None:
    if unrest is None:
        return None
    said = {"up": unrest.up.tolist(), "tilt": TILT, "fastest": RATE}
    return {name: getattr(unrest, name) for name in ("rotation", "rate", "steps")} | said


def _command(command: Command) -> dict[str, Any]:
    names = ("name", "lowest", "highest", "rest", "unit")
    return {name: getattr(command, name) for name in names} | {"axis": _AXES.get(command.source)}


def _falls(conditions: Conditions) -> dict[str, Any]:
    """Returns the readings of conditions and their ranges, in which None stands for no limit."""
    ends = {"lowest": conditions.lowest, "highest": conditions.highest}
    rows = {
        name: [value if np.isfinite(value) else None for value in values.tolist()]
        for name, values in ends.items()
    }
    return _reads(conditions.readings) | rows


def _reads(readings: StateReadings) -> dict[str, Any]:
    """Returns how the page computes readings."""
    if not isinstance(readings, Readings):
        raise InvalidInputError(
            f"The page cannot compute {', '.join(readings.names[:3])}, which are no readings of "
            "MuJoCo's model; export it without --web."
        )
    plan = readings.plan
    kinds, places = plan.kinds.tolist(), plan.places.tolist()
    return {"needs": plan.needs, "kinds": kinds, "places": places}
