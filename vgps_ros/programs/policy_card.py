# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The card of a policy: README.md, as model hubs show it, with the ONNX file and a moving picture.

It says of the policy only what the task, the run's files and rollouts that are drawn for it say.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml
from rich.console import Console

from vgps_ros.core.memory import LAST_ACTION, terms_of
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.policy_file import PolicyFile
from vgps_ros.programs.evaluate import evaluate_policy, show_evaluation
from vgps_ros.search.run_record import RunRecord
from vgps_ros.simulation.model import deviation_names, sensor_numbers
from vgps_ros.storage.files import replacing
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks import Task
from vgps_ros.views.filmstrip import RenderingError, write_moving_picture

CARD, MODEL, PICTURE = "README.md", "policy.onnx", "motion.gif"
# Of the rollouts that are measured for a card.
_MEASURED: dict[str, Any] = {"perturbation": 0.01, "seed": 0, "stochastic": False}
_SHOWN = 6.0  # length of the moving picture [s]
_COLUMNS = ("output", "joint", "kind", "unit", "at action 0", "scale", "lowest", "highest")
_WIDTH = 110  # of the table of figures [characters]
_SENSE = mujoco.mjtSensor
_UNITS = {
    **dict.fromkeys((_SENSE.mjSENS_GYRO, _SENSE.mjSENS_FRAMEANGVEL), "rad/s"),
    **dict.fromkeys((_SENSE.mjSENS_VELOCIMETER, _SENSE.mjSENS_FRAMELINVEL), "m/s"),
    _SENSE.mjSENS_SUBTREELINVEL: "m/s",
    **dict.fromkeys((_SENSE.mjSENS_FRAMEPOS, _SENSE.mjSENS_SUBTREECOM), "m"),
    **dict.fromkeys((_SENSE.mjSENS_ACCELEROMETER, _SENSE.mjSENS_FRAMELINACC), "m/s²"),
    **dict.fromkeys((_SENSE.mjSENS_TOUCH, _SENSE.mjSENS_FORCE), "N"),
    _SENSE.mjSENS_TORQUE: "N·m",
}


@dataclass(frozen=True)
class ExportedFile:
    """An ONNX file, the precision of its numbers, and the command that has written it."""

    content: bytes
    precision: str
    command: str


def card_files(folder: Path) -> list[Path]:
    """Returns the files that a card consists of."""
    return [folder / name for name in (CARD, MODEL, PICTURE)]


def write_card(
    task: Task, policy: GaussianPolicy, run: RunFolder, exported: ExportedFile, folder: Path
) -> str:
    """Writes the card's files; where nothing can be drawn here, the card says so.

    Args:
        task: the policy's task.
        policy: the policy.
        run: the folder that its training has left, of which any file may be missing.
        exported: the ONNX file, and how it came to be.
        folder: where to write, made if it is missing.

    Returns:
        Why there is no picture; empty if there is one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    missing = ""
    try:
        motion = RunRecord(
            task.mjcf, task.dynamics.time_step, executed_states=_states(task, policy)
        )
        write_moving_picture(motion, folder / PICTURE)
    except RenderingError as error:
        missing = str(error)
    with replacing(folder / MODEL) as file:
        file.write(exported.content)
    with replacing(folder / CARD) as file:
        file.write(_text(task, policy, run, exported, missing).encode())
    return missing


def _states(task: Task, policy: GaussianPolicy) -> Any:
    """Returns the states of a rollout under the task's first commands, until it falls."""
    steps, observation = round(_SHOWN / task.dynamics.time_step), task.observation
    if task.signals.names:
        told = task.planned_context[0, : len(task.signals.commands)]
        observation = observation.within(task.signals.constant_context(told, steps))
    still = np.zeros((1, steps, task.dynamics.control_dim))
    states, _ = task.dynamics.execute(policy, observation, task.initial_state[None], still)
    return states[0][np.isfinite(states[0]).all(axis=1)]


def _text(
    task: Task, policy: GaussianPolicy, run: RunFolder, exported: ExportedFile, missing: str
) -> str:
    known = yaml.safe_load(run.environment.read_text()) if run.environment.is_file() else {}
    training = known.get("training") or {}
    settings = training.get("settings")  # None where nothing is recorded
    trained = training.get("command", "# not recorded: this is the policy alone, without its run")
    result = evaluate_policy(
        task,
        driver_of(task.deployment, PolicyFile("the policy", task.name, policy)),
        **_rollout_settings(task),
        **_MEASURED,
    )
    figures = Console(file=io.StringIO(), width=_WIDTH, markup=False, emoji=False)
    show_evaluation(result, task, figures)
    dt, name = task.dynamics.time_step, Path(task.name).parent.name or task.name
    front = {
        "library_name": "vgps_ros",
        "pipeline_tag": "robotics",
        "tags": ["robotics", "mujoco", "onnx", "guided-policy-search", name],
    }
    picture = f"No moving picture: {missing}" if missing else f"![The policy at work]({PICTURE})"
    sections = {
        f"A policy for the task {name}": picture,
        "What it is": f"It maps {len(policy.observed)} readings to {len(policy.noise_std)} "
        f"controls each {dt:g} s, by {policy.architecture.num_parameters} parameters. It was "
        "learned with vgps_ros, in simulation.",
        "How it was made": f"```bash\n{trained}\n{exported.command}\n```\n\n"
        + _table(
            ("what", "value"),
            [
                ("commit", known.get("commit", "not recorded")),
                ("task", f"`{task.name}`"),
                ("method", training.get("method", "not recorded")),
                ("seed", training.get("seed", "not recorded")),
                *(settings or {}).items(),
            ],
        ),
        "How it does": "Measured in simulation for this card, as `vgps evaluate` does:\n\n```text\n"
        f"{figures.file.getvalue().strip()}\n```",  # type: ignore[attr-defined]
        "What it reads": _table(("input", "reading", "unit"), _readings(task, policy)),
        "What it controls": "A control is the value at action 0 plus scale × action.\n\n"
        + _table(_COLUMNS, _controls(task)),
        "Limits": "\n".join(f"- {sentence}" for sentence in _limits(task, settings)),
        "How to run it": _PROGRAM.format(
            model=MODEL, dt=dt, n=len(policy.observed), precision=exported.precision
        ),
    }
    front_matter = f"---\n{yaml.safe_dump(front, sort_keys=False)}---\n"
    titles = [f"{'#' if i == 0 else '##'} {title}" for i, title in enumerate(sections)]
    parts = (
        f"\n{title}\n\n{text}\n" for title, text in zip(titles, sections.values(), strict=True)
    )
    return front_matter + "".join(parts)


_PROGRAM = """```python
import numpy as np
import onnxruntime

policy = onnxruntime.InferenceSession("{model}")
obs = np.zeros((1, {n}), np.{precision})  # the readings, in this order and in these units
(actions,) = policy.run(["actions"], {{"obs": obs}})[0]  # of which each holds for {dt:g} s
```

`vgps execute-policy` drives a robot in ROS 2 by this file, within limits."""


def _rollout_settings(task: Task) -> dict[str, Any]:
    """Returns how many rollouts are measured, and how long they are [s]."""
    return {"seconds": 10.0, "rollouts": 4 if task.signals.commands else 10}


def _readings(task: Task, policy: GaussianPolicy) -> list[tuple[Any, ...]]:
    """Returns each input: its place, what it is, and its unit where that is known."""
    model, units = task.dynamics.model, {c.name: c.unit for c in task.signals.commands}
    n_v = model.nv
    deviations = deviation_names(model)
    for i, is_angle in enumerate(task.angles):
        units[deviations[i]] = "rad" if is_angle else "m"
        units[deviations[n_v + i]] = "rad/s" if is_angle else "m/s"
    for name, (sensor, _) in sensor_numbers(model).items():
        units[name] = _UNITS.get(model.sensor_type[sensor], "")
    terms = [
        (name, lag)
        for name, lag in terms_of(policy.observed)
        for _ in range(len(policy.noise_std) if name == LAST_ACTION else 1)
    ]
    return [
        (i, f"`{name}`" + (f", {lag} steps ago" if lag else ""), units.get(name, ""))
        for i, (name, lag) in enumerate(terms)
    ]


def _controls(task: Task) -> list[tuple[Any, ...]]:
    """Returns each output: its joint, kind and unit, its value at 0, its scale and its limits."""
    c = task.controls
    at_zero, low, high = (
        c.offset + c.scale * u for u in (c.resting(task.initial_state), *c.limits)
    )
    return [
        (
            i,
            f"`{name}`",
            c.kinds[i],
            c.units[i],
            *(f"{x[i]:.4g}" for x in (at_zero, c.scale, low, high)),
        )
        for i, name in enumerate(c.names)
    ]


def _limits(task: Task, settings: Mapping[str, Any] | None) -> list[str]:
    """Returns sentences on where the policy may fail, of which each is true of this task."""
    model, seconds = task.dynamics.model, task.horizon * task.dynamics.time_step
    sentences = [
        "It was trained in simulation only: nothing here says how it does on a real robot.",
        f"It has learned from motions of {seconds:.3g} s.",
    ]
    if settings is None:
        sentences.append("Which disturbances it has met is not recorded.")
    elif (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any() and task.fallen.lowest.size:
        is_uneven = _any(settings, "slope", "ridges", "steps")
        ground = "with slopes, ridges or steps" if is_uneven else "flat"
        sentences.append(f"The ground from which it has learned is {ground}.")
    kinds = {"push": "pushes", "payload": "payloads", "friction": "other friction"}
    for has, words, comma in ((True, "has", " and "), (False, "has not", " or ")):
        named = [w for n, w in kinds.items() if settings is not None and _any(settings, n) is has]
        if named:
            sentences.append(f"It {words} learned with {comma.join(named)}.")
    if task.signals.commands:
        ranges = (
            f"{c.name} from {c.lowest:g} to {c.highest:g}{f' {c.unit}' if c.unit else ''}"
            for c in task.signals.commands
        )
        sentences.append(f"It has learned to obey {', '.join(ranges)}.")
    return sentences


def _any(settings: Mapping[str, Any], *names: str) -> bool:
    return any(settings.get(f"disturb.{name}") for name in names)


def _table(head: tuple[str, ...], rows: list[tuple[Any, ...]]) -> str:
    """Returns a table in Markdown."""
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)
