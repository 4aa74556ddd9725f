# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Measures how far, how fast and for how long a learned policy goes, from perturbed starts.

Where disturbances are named, it also measures how many rollouts survive each.
"""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.seeding import SEED, Stream, generator
from vgps_ros.core.settings import Setting
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.programs.command_line import Parser, picture, refuse_existing
from vgps_ros.storage.files import write_json
from vgps_ros.storage.run_folder import RunFolder

if TYPE_CHECKING:
    from vgps_ros.core.executed_control import Policy
    from vgps_ros.tasks import Task


def _try_disturbances(
    task: "Task", policy: "Policy", arguments: argparse.Namespace
) -> dict[str, Any]:
    """Tries the disturbances that the arguments name; returns the survival by kind."""
    from vgps_ros.search.evaluation import perturbed_starts
    from vgps_ros.search.robustness import KINDS, Trials, robustness
    from vgps_ros.tasks.disturbance import DisturbanceSettings, check_push_ends

    values = {kind: list(getattr(arguments, kind)) for kind in KINDS if hasattr(arguments, kind)}
    if arguments.body and not {"pushes", "payloads"} & values.keys():
        raise InvalidInputError(
            f"--body {arguments.body} is pushed or bears a payload, but neither is tried; add "
            "--pushes or --payloads, or leave it out."
        )
    if not values:
        return {}
    if not isinstance(policy, GaussianPolicy):
        raise InvalidInputError(
            f"--{next(iter(values))} needs a policy of vgps_ros, but this is a third-party ONNX "
            "policy; leave it out."
        )
    steps = max(1, round(arguments.seconds / task.dynamics.time_step))
    rng = generator(arguments.seed, Stream.EVALUATION, 1)
    starts = perturbed_starts(task, arguments.perturbation, arguments.rollouts, rng)
    scale = policy.noise_std if arguments.stochastic else np.zeros_like(policy.noise_std)
    noise = scale * rng.standard_normal((len(starts), steps, len(scale)))
    settings = DisturbanceSettings(
        body=arguments.body,
        push_before=arguments.seconds / 2,  # then there is time to recover, or to fall
        push_duration=arguments.push_duration,
    )
    if any(values.get("pushes", ())):
        check_push_ends(
            settings, arguments.seconds, "a rollout", "--push-duration", "lengthen --seconds"
        )
    trials = Trials(starts, noise, arguments.seed, settings)
    return robustness(task, policy, trials, values)


def _show(result: dict[str, Any], *, can_fall: bool) -> None:
    """Prints a result as a table; of a robot that cannot fall it says nothing about survival."""
    from rich.table import Column, Table

    from vgps_ros.search.evaluation import FIGURES, SPREAD
    from vgps_ros.search.robustness import ENOUGH, KINDS
    from vgps_ros.views.console import table_console

    policy = "stochastic" if result["stochastic"] else "deterministic"
    survival = f", survival {100 * result['survival']:.0f} %" if can_fall else ""
    table = Table(
        "until it falls or time is up" if can_fall else "until time is up",
        *(Column(column, justify="right") for column in SPREAD),
        title=f"{result['task']}, {policy} policy, {result['rollouts']} rollouts of "
        f"{result['seconds']:g} s{survival}",
    )
    for key, name in FIGURES.items():
        table.add_row(name, *(f"{value:.3f}" for value in result[key].values()))
    table_console().print(table)
    if "robustness" not in result:
        return
    table = Table("disturbance", "size", "survive", f"{100 * ENOUGH:.0f} % survive")
    for kind, found in result["robustness"].items():
        borne = found["borne"]
        table.add_row(
            KINDS[kind],
            "\n".join(f"{value:g}" for value in found["values"]),
            "\n".join(f"{100 * share:.0f} %" for share in found["survival"]),
            f"{borne[0]:g} to {borne[1]:g}" if borne else "none",
            end_section=True,
        )
    table_console().print(table)


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("run", type=Path, help="folder of a run, a policy.json or an ONNX file")
    parser.add_argument("--task", help="the task; default: the one that the policy's file names")
    perturbation = (
        "standard deviation of the first joint angles [rad]; that of their velocities is ten times "
        "it"
    )
    parser.add_settings(
        Setting("seconds", 10.0, "length of a rollout [s]", minimum=1e-3, maximum=1e5),
        Setting("rollouts", 20, "number of rollouts", minimum=1, maximum=1_000_000),
        Setting("perturbation", 0.01, perturbation, minimum=0.0, maximum=100.0),
        SEED,
    )
    parser.add_settings(
        Setting(
            "pushes", (0.0,), "impulses to try, each once in a rollout's first half [N*s]",
            minimum=0.0, maximum=1e6,
        ),
        Setting("slopes", (0.0,), "slopes to try, upwards [rad]", minimum=-1.0, maximum=1.0),
        Setting("payloads", (0.0,), "masses to add [kg]", minimum=0.0, maximum=1e6),
        Setting("frictions", (1.0,), "factors on friction", minimum=0.0, maximum=100.0),
        unset="nothing is tried",
    )  # fmt: skip
    parser.add_settings(
        Setting("body", "", "body that is pushed and bears a payload; empty: the heaviest one"),
        Setting("push_duration", 0.1, "length of a push [s]", minimum=1e-6, maximum=1e3),
    )
    parser.add_argument(
        "--plot", type=picture, metavar="FILE", help="draw how many survive each disturbance"
    )
    parser.add_argument("--stochastic", action="store_true", help="draw the policy's noise")
    parser.add_output(
        "--json",
        "also write the result to this file; - prints it instead of the table",
        metavar="FILE",
    )


def run(arguments: argparse.Namespace) -> None:
    """Evaluates the policy that the arguments name."""
    files = [file for file in (arguments.json, arguments.plot) if file and file != Path("-")]
    refuse_existing(files, overwrite=arguments.overwrite)
    path = arguments.run
    file = open_policy(RunFolder(path).policy if path.is_dir() else path)
    if not (arguments.task or file.task):
        raise InvalidInputError(f"{file.name} names no task; give --task.")
    from vgps_ros.search.evaluation import measure_driving
    from vgps_ros.tasks import make_task, recorded_task
    from vgps_ros.tasks.driver import driver_of

    task = make_task(arguments.task) if arguments.task else recorded_task(file.task)
    own = ("seconds", "rollouts", "perturbation", "seed", "stochastic")
    driver = driver_of(task, file)
    result = measure_driving(task, driver, **{name: getattr(arguments, name) for name in own})
    if found := _try_disturbances(task, driver.policy, arguments):
        result["robustness"] = found
    if arguments.plot:
        if not found:
            raise InvalidInputError(
                "--plot draws disturbances, but none is named; add --pushes, --slopes, --payloads "
                "or --frictions."
            )
        from vgps_ros.views.plots import survival_curves

        survival_curves({task.name: found}, arguments.rollouts).savefig(arguments.plot, dpi=150)
    if arguments.json == Path("-"):
        print(json.dumps(result))
        return
    _show(result, can_fall=bool(task.fallen.lowest.size))
    if arguments.json:
        write_json(arguments.json, result)
