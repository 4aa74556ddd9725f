# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Measures how far, how fast and for how long a learned policy goes, from perturbed starts.

Where disturbances are named, it also measures how many rollouts survive each.

Of a task with commands it measures at each command of a grid, and while commands change every 3 s:
the share of rollouts that are up after 20 s, 60 s and at the end; the share that obeys then, whose
mean error over the last 2 s is at most a tenth of each command, or 0.1 m/s or rad/s, or an eighth
of its range if that is less than these; and the errors of each commanded number, from 1 s after the
start or a change of a command on. Also what the motions ask of the robot: power, cost of transport,
slip, impact. Disturbances are tried while commands change, for 20 s at most.
Intervals are Wilson's, of 95 %.
"""

import argparse
import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.seeding import SEED, Stream, generator
from vgps_ros.core.settings import Range, Setting
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.programs.command_line import Parser, picture, refuse_existing
from vgps_ros.storage.files import write_json
from vgps_ros.storage.run_folder import RunFolder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rich.console import Console

    from vgps_ros.core.records import Array
    from vgps_ros.policies.policy_file import PolicyFile
    from vgps_ros.robot.executed_control import Driver
    from vgps_ros.tasks import Task

OWN = ("seconds", "rollouts", "perturbation", "seed", "stochastic")
# Lengths and numbers of rollouts where none are given, of tasks with commands and of others.
COMMANDED = {"seconds": 60.0, "rollouts": 40}
UNCOMMANDED = {"seconds": 10.0, "rollouts": 20}
LONGEST_TRIAL = 20.0  # of a disturbance while commands change [s]


def _try_disturbances(
    task: "Task", driver: "Driver", arguments: argparse.Namespace
) -> tuple[dict[str, Any], "Callable[[str, float, int], Array] | None"]:
    """Tries the disturbances that the arguments name; returns the survival by kind, and a replay.

    Of a robot that obeys commands, all usual ones are tried where none is named.
    """
    from vgps_ros.search.evaluation import perturbed_starts
    from vgps_ros.search.judgement import (
        TRIALS,
        Trial,
        changing_commands,
        drawn_noise,
        first_phases,
    )
    from vgps_ros.search.robustness import KINDS, USUAL, replay_rollout, robustness, suits
    from vgps_ros.tasks.disturbance import DisturbanceSettings, check_push_ends

    values = {kind: list(getattr(arguments, kind)) for kind in KINDS if hasattr(arguments, kind)}
    if not values and task.signals.commands:
        values = {k: list(v) for k, v in USUAL.items() if suits(task, k, arguments.body)}
    if arguments.body and not {"pushes", "payloads", "masses"} & values.keys():
        raise InvalidInputError(
            f"--body {arguments.body} is pushed or bears a payload, but neither is tried; add "
            "--pushes or --payloads, or leave it out."
        )
    if not values:
        return {}, None
    seconds = arguments.seconds
    if task.signals.commands:
        seconds = min(seconds, LONGEST_TRIAL)
    elif not isinstance(driver.policy, GaussianPolicy):
        raise InvalidInputError(
            f"--{next(iter(values)).replace('_', '-')} needs a policy of vgps_ros, but this is a "
            "third-party ONNX policy; leave it out."
        )
    steps = max(1, round(seconds / task.dynamics.time_step))
    rng = generator(arguments.seed, Stream.JUDGEMENT, TRIALS)
    starts = perturbed_starts(task, arguments.perturbation, arguments.rollouts, rng)
    commands = np.array([changing_commands(task, steps, rng) for _ in starts])
    scale = driver.policy.noise_std * float(arguments.stochastic)
    noise = drawn_noise(scale, (len(starts), steps), rng)
    settings = DisturbanceSettings(
        body=arguments.body,
        push_before=seconds / 2,  # then there is time to recover, or to fall
        push_duration=arguments.push_duration,
    )
    if any(values.get("pushes", ())):
        check_push_ends(settings, seconds, "a rollout", "--push-duration", "lengthen --seconds")
    trial = Trial(starts, commands, noise, phases=first_phases(len(starts)))
    found = robustness(task, driver, trial, values, arguments.seed, settings)
    return found, partial(replay_rollout, task, driver, trial, arguments.seed, settings)


def evaluate_policy(task: "Task", driver: "Driver", **own: Any) -> dict[str, Any]:
    """Returns what a policy does without disturbances; `own` are the settings named in OWN.

    Raises:
        InvalidInputError: the rollouts are too short or too many.
    """
    from vgps_ros.search.evaluation import measure_driving
    from vgps_ros.search.gait import gaits
    from vgps_ros.search.judgement import judge_controller

    if task.signals.commands:
        result = {"task": task.name, **own, **judge_controller(task, driver, **own)}
        for found, gait in zip(result["commands"], gaits(task, driver), strict=True):
            found["gait"] = gait
        return result
    return measure_driving(task, driver, **own)


def show_evaluation(result: dict[str, Any], task: "Task", console: "Console") -> None:
    """Prints a result of `evaluate_policy` as a table."""
    print_table = _show_controller if task.signals.commands else _show
    print_table(result, console, task)


def _show(result: dict[str, Any], console: "Console", task: "Task") -> None:
    """Prints a result as a table; of a robot that cannot fall it says nothing about survival."""
    from rich.table import Column, Table

    from vgps_ros.search.evaluation import FIGURES, SPREAD

    can_fall = bool(task.fallen.lowest.size)
    policy = "stochastic" if result["stochastic"] else "deterministic"
    survival = f", survival {100 * result['survival']:.0f} %" if can_fall else ""
    table = Table(
        "until it falls or time is up" if can_fall else "until time is up",
        *(Column(column, justify="right") for column in SPREAD),
        title=f"{result['task']}, {policy} policy, {result['rollouts']} rollouts of "
        f"{result['seconds']:g} s{survival}",
    )
    rows = {name: result[key] for key, name in FIGURES.items()}
    rows |= {f"{name}, from its target at the end": each for name, each in result["misses"].items()}
    for name, values in rows.items():
        table.add_row(name, *(f"{value:.3f}" for value in values.values()))
    console.print(table)
    _show_robustness(result, console)


def _show_controller(result: dict[str, Any], console: "Console", task: "Task") -> None:
    """Prints how a policy obeys commands as a table."""
    from rich.table import Column, Table

    from vgps_ros.search.judgement import CHANGE, LATE, SETTLING, TOLERANCE, allowed_at_rest

    times, units = result["times"], result["units"]
    limits = zip(task.signals.commands, allowed_at_rest(task.signals), strict=True)
    up = "not fallen" if task.fallen.lowest.size else "not diverged"
    allowed = ", ".join(f"{c.name} {limit:g}{f' {c.unit}' * bool(c.unit)}" for c, limit in limits)
    policy = "stochastic" if result["stochastic"] else "deterministic"
    table = Table(
        Column("command", no_wrap=True),
        *(Column(f"up {time:g} s", justify="right") for time in times),
        Column(f"obeys {times[-1]:g} s", justify="right"),
        *(
            Column(f"{name}{f' [{units[name]}]' if units[name] else ''}", justify="right")
            for name in result["achieved_by"]
        ),
        title=f"{result['task']}, {policy} policy, {result['rollouts']} rollouts of "
        f"{result['seconds']:g} s at each command",
        caption=f"Up: {up} (interval of 95 %). Obeys: up, and the mean error over the last "
        f"{LATE:g} s is at most {100 * TOLERANCE:g} % of each command, or as small as {allowed}. "
        f"On the right: errors, root mean square (mean), from {SETTLING:g} s after a change on.",
        caption_justify="left",
    )

    def row(name: str, found: dict[str, Any]) -> None:
        ups = zip(found["survival"], found["survival_interval"], strict=True)
        errors = ((found["rms"][c], found["mean"][c]) for c in result["achieved_by"])
        table.add_row(
            name,
            *(_share(*each) for each in ups),
            _share(found["obeys"][-1], found["obeys_interval"][-1]),
            *("none" if rms is None else f"{rms:.3f} ({mean:+.3f})" for rms, mean in errors),
        )

    for i, found in enumerate(result["commands"]):
        row(_name(found["command"]), found)
        table.rows[-1].end_section = i == len(result["commands"]) - 1
    row("all of these", result["all_commands"])
    row(f"changing each {CHANGE:g} s", result["changing"])
    console.print(table)
    _show_gaits(result["commands"], task, console)
    _show_robustness(result, console)


def _show_gaits(commands: list[dict[str, Any]], task: "Task", console: "Console") -> None:
    """Prints what the motions at rest and at each command's ends ask of the robot."""
    from rich.table import Column, Table

    columns = {
        "power": "power [W]",
        "cost_of_transport": "cost of transport",
        "load": "largest load",
        "slip": "slip [m/s]",
        "impact": "impact",
    }
    table = Table(
        "command",
        *(Column(name, justify="right") for name in columns.values()),
        caption="Mean mechanical power at the joints; by weight and speed; the largest force of an "
        "actuator by its limit; speed of the feet along the ground; the ground's largest force by "
        "the robot's weight.",
        caption_justify="left",
    )
    ends = {(c.name, value) for c in task.signals.commands for value in (c.lowest, c.highest)}
    for found in commands:
        moved = [each for each in found["command"].items() if each[1]]
        if found["gait"] and (not moved or (len(moved) == 1 and moved[0] in ends)):
            values = (found["gait"][key] for key in columns)
            cells = ("none" if value is None else f"{value:.3g}" for value in values)
            table.add_row(_name(found["command"]), *cells)
    if table.row_count:
        console.print(table)


def _name(command: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in command.items() if value) or "at rest"


def _share(share: float, interval: list[float]) -> str:
    low, high = (100.0 * end for end in interval)
    return f"{100 * share:.0f} % ({low:.0f}-{high:.0f})"


def _errors(errors: "Iterable[float | None]") -> str:
    return " ".join("none" if error is None else f"{error:.3f}" for error in errors)


def _show_robustness(result: dict[str, Any], console: "Console") -> None:
    """Prints how many rollouts survive each disturbance, if any was tried."""
    from rich.table import Table

    from vgps_ros.search.robustness import ENOUGH, KINDS

    if not (tried := result.get("robustness")):
        return
    obeys = any("obeys" in found for found in tried.values())
    enough = f"{100 * ENOUGH:.0f} %"
    columns = ["disturbance", "size", "survive", f"{enough} survive"]
    table = Table(*columns, *(["obey", f"{enough} obey", "errors (rms)"] if obeys else []))
    for kind, found in tried.items():
        cells = [KINDS[kind], "\n".join(f"{value:g}" for value in found["values"])]
        for shares, borne in (("survival", "borne"), ("obeys", "obeyed"))[: 1 + obeys]:
            ends = found[borne]
            listed = found.get(f"{shares}_interval")
            cells.append(
                "\n".join(
                    _share(share, listed[i]) if listed else f"{100 * share:.0f} %"
                    for i, share in enumerate(found[shares])
                )
            )
            cells.append(f"{ends[0]:g} to {ends[1]:g}" if ends else "none")
        if obeys:
            cells.append("\n".join(_errors(one.values()) for one in found["rms"]))
        table.add_row(*cells, end_section=True)
    console.print(table)


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("run", type=Path, help="folder of a run, a policy.json or an ONNX file")
    add_trials(parser)
    parser.add_argument(
        "--plot", type=picture, metavar="FILE", help="draw how many survive each disturbance"
    )


# Disturbances that are tried: the value of none, the lowest, the highest, and what they are.
_TRIED: dict[str, tuple[float, float, float, str]] = {
    "pushes": (0.0, 0.0, 1e6, "impulses to try, each once in a rollout's first half [N*s]"),
    "slopes": (0.0, -1.0, 1.0, "slopes to try, upwards, or of a task with commands in all "
               "directions [rad]"),
    "ridges": (0.0, 0.0, 1.0, "largest heights of ridges [m]"),
    "steps": (0.0, 0.0, 1.0, "heights of steps up and down [m]"),
    "payloads": (0.0, 0.0, 1e6, "masses to add [kg]"),
    "masses": (1.0, 0.01, 100.0, "factors on the mass of a body, as of a trunk"),
    "frictions": (1.0, 0.0, 100.0, "factors on friction"),
    "dampings": (1.0, 0.0, 100.0, "factors on the damping of all joints"),
    "armatures": (1.0, 0.0, 100.0, "factors on the armature of all joints, the inertia of their "
                  "rotors"),
    "strengths": (1.0, 0.01, 100.0, "factors on the largest forces of all actuators"),
    "latencies": (0.0, 0.0, 10.0, "times by which the policy reads the state too late, rounded up "
                  "to control steps [s]"),
    "sensor_noise": (0.0, 0.0, 100.0, "factors on the noise of usual sensors: 0.01 rad and 0.5 "
                     "rad/s of joints, 0.1 rad/s of a gyro, 0.03 of gravity's direction, 0.1 m/s "
                     "of speeds, 0.01 m of places"),
    "contacts": (0, 0, 1, "hardness of contacts: 0 the model's, 1 MuJoCo's default"),
    "engines": (0, 0, 1, "how MuJoCo computes: 0 as the model says, 1 with the other kind of "
                "friction cone, conjugate gradients, Euler's integrator and half the time step"),
}  # fmt: skip


def add_trials(parser: Parser) -> None:
    """Declares how policies are tried, and where the result goes."""
    parser.add_argument("--task", help="the task; default: the one that the policy's file names")
    perturbation = (
        "standard deviation of the first joint angles [rad]; that of their velocities is ten times "
        "it"
    )
    parser.add_settings(
        Setting("seconds", 10.0, Range(1e-3, 1e5), "length of a rollout [s]"),
        unset="10; of a task with commands 60",
    )
    rollouts = "number of rollouts, at each command if there are any"
    parser.add_settings(
        Setting("rollouts", 20, Range(1, 1_000_000), rollouts),
        unset="20; of a task with commands 40",
    )
    parser.add_settings(Setting("perturbation", 0.01, Range(0.0, 100.0), perturbation), SEED)
    tried = (Setting(name, (none,), Range(low, high), text)
             for name, (none, low, high, text) in _TRIED.items())  # fmt: skip
    parser.add_settings(
        *tried, unset="not tried; of a task with commands, usual sizes if no kind is named"
    )
    parser.add_settings(
        Setting(
            "body",
            "",
            "body that is pushed, bears a payload or has another mass; empty: the heaviest one",
        ),
        Setting("push_duration", 0.1, Range(1e-6, 1e3), "length of a push [s]"),
    )
    parser.add_argument("--stochastic", action="store_true", help="draw the policy's noise")
    parser.add_output(
        "--json",
        "also write the result to this file; - prints it instead of the table",
        metavar="FILE",
    )


def open_run(path: Path, reference: str | None) -> tuple["PolicyFile", "Task"]:
    """Returns the policy of a run or a file, and the task by reference, or the one that it names.

    Raises:
        InvalidInputError: it is no policy, or names no task.
    """
    file = open_policy(RunFolder(path).policy if path.is_dir() else path)
    if not (reference or file.task):
        raise InvalidInputError(f"{file.name} names no task; give --task.")
    from vgps_ros.tasks import make_task, recorded_task

    return file, make_task(reference) if reference else recorded_task(file.task)


def judge_policy(
    file: "PolicyFile", task: "Task", arguments: argparse.Namespace
) -> tuple[dict[str, Any], "Callable[[str, float, int], Array] | None"]:
    """Returns what a policy does, with the disturbances that the arguments name, and a replay.

    The replay returns the states of one rollout by kind, value and number; None if there is none.
    """
    from vgps_ros.policies.driver import driver_of, for_policy

    commanded = bool(task.signals.commands)
    for name, value in (COMMANDED if commanded else UNCOMMANDED).items():
        vars(arguments).setdefault(name, value)
    own = {name: getattr(arguments, name) for name in OWN}
    task = for_policy(task, file)
    driver = driver_of(task.deployment, file)
    result = evaluate_policy(task, driver, **own)
    tried, replay = _try_disturbances(task, driver, arguments)
    return result | ({"robustness": tried} if tried else {}), replay


def run(arguments: argparse.Namespace) -> None:
    """Evaluates the policy that the arguments name."""
    files = [file for file in (arguments.json, arguments.plot) if file and file != Path("-")]
    refuse_existing(files, overwrite=arguments.overwrite)
    file, task = open_run(arguments.run, arguments.task)
    result, _ = judge_policy(file, task, arguments)
    if arguments.plot:
        if "robustness" not in result:
            raise InvalidInputError(
                "--plot draws disturbances, but none is named; add --pushes, --slopes, --payloads "
                "or --frictions."
            )
        from vgps_ros.views.plots import survival_curves

        curves = survival_curves({task.name: result["robustness"]}, arguments.rollouts)
        curves.savefig(arguments.plot, dpi=150)
    if arguments.json == Path("-"):
        print(json.dumps(result))
        return
    from vgps_ros.views.console import table_console

    show_evaluation(result, task, table_console())
    if arguments.json:
        write_json(arguments.json, result)
