"""Learns a policy in this process, without a graph.

It writes result.json, policy.json, distribution.npz, trajectories.npz and learning_curve.png. A
training that was stopped or killed goes on where it was when the same command is given again.
`--task` and `--params-file` change the defaults of other flags: with them `--help` shows theirs.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import with_values
from vgps_ros.experiments.command_line import (
    Parser,
    add_overwrite,
    add_setting,
    add_settings,
    refuse_existing,
    settings_from,
)
from vgps_ros.experiments.params_file import parameters_of, with_parameters_of
from vgps_ros.search.settings import METHOD, SearchSettings
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks.settings import DEMONSTRATION, TASK, TASKS

if TYPE_CHECKING:
    from vgps_ros.tasks import Task


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    first = Parser(prog=parser.prog, add_help=False)
    for p in (first, parser):
        p.add_argument(
            "--params-file",
            type=Path,
            metavar="FILE",
            help="parameter file of the graph, whose blocks policy_learner and "
            "trajectory_optimizer become the defaults of the flags",
        )
    file = first.parse_known_args(parser.words)[0].params_file
    learner = parameters_of("policy_learner", file)
    for setting in (TASK, METHOD, DEMONSTRATION):
        chosen = replace(setting, default=learner.get(setting.name, setting.default))
        chosen.check(chosen.default)
        for p in (first, parser):
            add_setting(p, chosen)
    task = TASKS[first.parse_known_args(parser.words)[0].task]
    add_setting(parser, SEED)
    parser.add_argument("--output", type=Path, required=True, help="folder for the results")
    add_overwrite(parser)
    parser.add_argument(
        "--check", action="store_true", help="only check the arguments: train and write nothing"
    )
    defaults = with_values(SearchSettings(), task.search)
    add_settings(parser, with_parameters_of(defaults, "policy_learner", file))
    add_settings(parser, with_parameters_of(task.optimizer, "trajectory_optimizer", file))
    parser.set_defaults(
        interrupted="interrupted; the same command goes on after the last whole iteration."
    )


def run(arguments: argparse.Namespace) -> None:
    """Trains as the arguments say."""
    settings = settings_from(arguments, SearchSettings())
    optimizer = settings_from(arguments, OptimizerSettings())
    output = RunFolder(arguments.output)
    if output.is_finished():
        refuse_existing([output.result], overwrite=arguments.overwrite)
    if arguments.check:
        return
    from vgps_ros.simulation.warnings import silence_mujoco
    from vgps_ros.tasks import make_task

    silence_mujoco()
    task = replace(make_task(arguments.task, arguments.demonstration), optimizer=optimizer)
    train_with_progress(arguments.method, task, settings, arguments.seed, output)


def train_with_progress(
    method: str, task: "Task", settings: SearchSettings, seed: int, output: RunFolder
) -> None:
    """Trains a policy, shows how it goes, and draws the learning curve.

    A training that was stopped goes on; its checkpoints are removed when all else is written.

    Raises:
        VgpsError: a setting is out of range, the first rollout diverges, or the folder holds a
            training with other settings that has not ended.
    """
    from vgps_ros.experiments.training import train
    from vgps_ros.search.checkpoints import Checkpoints
    from vgps_ros.search.iteration import RemainingTime
    from vgps_ros.views.plots import learning_curve, save
    from vgps_ros.views.training_progress import TrainingProgress

    remaining = RemainingTime(settings.iterations)
    with TrainingProgress(settings.initial_ddp_iterations) as progress:
        checkpoints = Checkpoints(output.checkpoints, progress.say)
        content = train(
            method,
            task,
            settings,
            seed,
            output,
            on_iteration=lambda i: progress.iteration(i, settings.iterations, remaining.after(i)),
            on_initial_ddp=lambda i: progress.ddp_iteration(i.index),
            checkpoints=checkpoints,
        )
    save(learning_curve(content), output.learning_curve)
    checkpoints.remove()
    print(
        f"Wrote {output.file_names()} to {output.path}; `vgps plot {output.path}` draws the rest."
    )
