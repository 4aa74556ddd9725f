# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Learns a policy in this process, without a graph.

It writes result.json, policy.json, distribution.npz, trajectories.npz and learning_curve.png. A
training that was stopped or killed goes on where it was when the same command is given again.
`--task` changes the defaults of other flags: with it `--help` shows its own.
"""

import argparse
import fcntl
import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.programs.command_line import Parser, refuse_existing, settings_from
from vgps_ros.search.settings import METHOD, PRESETS, SearchSettings, check_preset
from vgps_ros.storage.run_folder import RunFolder, load_policy
from vgps_ros.tasks.registry import DEMONSTRATION, TASK, task_settings

if TYPE_CHECKING:
    from vgps_ros.tasks import Task


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.usage = "%(prog)s [-h] [--task TASK] [OPTION VALUE ...] --output OUTPUT"
    parser.add_settings(TASK, METHOD, DEMONSTRATION)
    words = [word for word in parser.words if word not in ("-h", "--help")]
    task = task_settings(parser.parse_known_args(words)[0].task)
    parser.add_settings(SEED)
    parser.add_output("--output", "folder for the results", required=True)
    parser.add_argument(
        "--from",
        dest="first",
        type=Path,
        metavar="RUN",
        help="folder of a finished training whose policy this one begins with, for instance with "
        "other ranges of commands",
    )
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="Dask scheduler whose workers solve the situations, such as tcp://10.0.0.1:8786; they "
        "find the task by the same name; needs vgps_ros[cluster]",
    )
    parser.add_argument(
        "--check", action="store_true", help="only check the arguments: train and write nothing"
    )
    parser.add_argument(
        "--tensorboard",
        action="store_true",
        help="also write the metrics of each iteration to OUTPUT/tensorboard, which `tensorboard "
        "--logdir OUTPUT` shows; needs requirements/tensorboard.txt",
    )
    search = with_values(SearchSettings(), task.search)
    parser.add_settings(*settings_of(search), *settings_of(task.optimizer))
    parser.set_defaults(
        interrupted="interrupted; the same command goes on after the last whole iteration."
    )


def run(arguments: argparse.Namespace) -> None:
    """Trains a policy, shows how it goes, and draws the learning curve."""
    settings = settings_from(arguments, SearchSettings())
    optimizer = settings_from(arguments, OptimizerSettings())
    given = [word.partition("=")[0] for word in arguments.parser.words]
    chosen = {s.name: s.default for s in settings_of(settings)}
    for name, value in PRESETS[settings.preset].items():
        if "--" + name.replace(".", "-").replace("_", "-") in given:
            check_preset(settings.preset, name, chosen[name], value)
    output = RunFolder(arguments.output)
    if output.is_finished():
        refuse_existing([output.result], overwrite=arguments.overwrite)
    task = _task(arguments.task, arguments.demonstration, optimizer)
    first = load_policy(RunFolder(arguments.first).policy)[0] if arguments.first else None
    if arguments.check:
        from vgps_ros.search.methods import check_search

        check_search(arguments.method, task, settings, arguments.seed, first)
        return
    from vgps_ros.search.checkpoints import Checkpoints
    from vgps_ros.search.cluster import Cluster
    from vgps_ros.search.iteration import RemainingTime, SearchIteration
    from vgps_ros.search.solver_processes import SolverProcesses
    from vgps_ros.search.training import train
    from vgps_ros.search.trajectory_optimization import prepare
    from vgps_ros.tasks.task import task_digest
    from vgps_ros.views.console import TrainingProgress
    from vgps_ros.views.learning_curve import EventLog, learning_curve
    from vgps_ros.views.plots import save

    several = settings.situations > 1
    if arguments.cluster and not several:
        raise InvalidInputError("A single situation is solved here; leave out --cluster.")
    cluster = Cluster(arguments.cluster) if arguments.cluster else None
    prepare(task)  # before the first bar, and before processes would each compile the loops
    make = partial(_task, arguments.task, arguments.demonstration, optimizer)
    solvers = SolverProcesses(make, None, cluster, task_digest(task)) if several else None
    events = EventLog(output.events) if arguments.tensorboard else None
    remaining = RemainingTime(settings.iterations)
    with _claim_folder(output.path), solvers or nullcontext(), TrainingProgress() as progress:
        checkpoints = Checkpoints(output.checkpoints, progress.say, overwrite=arguments.overwrite)

        def show(iteration: SearchIteration) -> None:
            progress.iteration(iteration, settings.iterations, remaining.after(iteration))
            for warning in iteration.warnings:
                progress.say(warning)
            if events:
                events.iteration(iteration)

        content = train(
            arguments.method,
            task,
            settings,
            arguments.seed,
            output,
            on_iteration=show,
            on_initial_progress=progress.initial_solves,
            checkpoints=checkpoints,
            solvers=solvers,
            command=shlex.join(["vgps", "train", *arguments.parser.words]),
            first_policy=first,
        )
    if events:
        events.close()
    save(learning_curve(content), output.learning_curve)
    checkpoints.remove()  # when all else is written
    print(
        f"Wrote {output.file_names()} to {output.path}; `vgps plot "
        f"{shlex.quote(str(output.path))}` draws the rest."
    )


def _task(name: str, demonstration: str, optimizer: OptimizerSettings) -> "Task":
    """Returns the task to learn, with the settings by which its trajectories are optimised."""
    from vgps_ros.tasks import make_task

    return replace(make_task(name, demonstration), optimizer=optimizer)


@contextmanager
def _claim_folder(folder: Path) -> Iterator[None]:
    """Keeps a folder for this training alone; raises where another one writes there now."""
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise InvalidInputError(
            f"Another training writes to '{folder}' now; wait for its end, or name another "
            "--output."
        ) from error
    finally:
        os.close(descriptor)
