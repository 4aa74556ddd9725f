"""Program `train`: a policy search in this process, without a graph."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from vgps_ros.core.errors import VgpsError
from vgps_ros.experiments.command_line import add_flags, settings_from
from vgps_ros.experiments.params_file import with_parameters_of
from vgps_ros.experiments.training import train
from vgps_ros.search.checkpoints import Checkpoints
from vgps_ros.search.methods import METHOD, METHODS
from vgps_ros.search.remaining_time import RemainingTime
from vgps_ros.search.settings import SearchSettings, search_settings
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks import TASKS, Task, make_task
from vgps_ros.views.plots import learning_curve, save
from vgps_ros.views.training_progress import TrainingProgress


def train_with_progress(
    method: str, task: Task, settings: SearchSettings, seed: int, output: RunFolder
) -> None:
    """Trains a policy, shows how it goes, and draws the learning curve.

    A training that was stopped goes on; its checkpoints are removed when all else is written.

    Raises:
        VgpsError: a setting is out of range, the first rollout diverges, or the folder holds a
            training with other settings that has not ended.
    """
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
        f"Wrote {output.file_names()} to {output.path}; "
        f"`ros2 run vgps_ros plot {output.path}` draws the rest."
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    silence_mujoco()
    which = argparse.ArgumentParser(prog="train", add_help=False)
    which.add_argument("--task", choices=sorted(TASKS), default="swimmer", help="control problem")
    which.add_argument("--method", choices=METHODS, default=METHOD.default, help=METHOD.description)
    which.add_argument(
        "--demonstration", default="", help="table of a recorded motion to start from"
    )
    which.add_argument(
        "--params-file",
        type=Path,
        help="parameter file of the graph, whose blocks policy_learner and trajectory_optimizer "
        "become the defaults of the flags",
    )
    chosen, _ = which.parse_known_args(arguments)
    try:
        task = make_task(chosen.task, chosen.demonstration)
        defaults, optimizer = search_settings(task), task.optimizer
        if chosen.params_file:
            defaults = with_parameters_of(defaults, "policy_learner", chosen.params_file)
            optimizer = with_parameters_of(optimizer, "trajectory_optimizer", chosen.params_file)
    except (VgpsError, OSError) as error:
        sys.exit(f"train: {error}")
    # The task, and then the file, name the defaults of the other flags.
    parser = argparse.ArgumentParser(
        prog="train",
        parents=[which],
        description="Learns a policy in this process, and "
        "writes result.json, policy.json, distribution.npz, trajectories.npz and "
        "learning_curve.png. "
        "One that was stopped or killed goes on where it was when the same command is given again.",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random draws")
    parser.add_argument("--output", type=Path, required=True, help="folder for the results")
    add_flags(parser, defaults)
    add_flags(parser, optimizer)
    parsed = parser.parse_args(arguments)
    try:
        settings = settings_from(parsed, defaults)
        task = replace(task, optimizer=settings_from(parsed, optimizer))
        train_with_progress(parsed.method, task, settings, parsed.seed, RunFolder(parsed.output))
    except (VgpsError, OSError) as error:
        sys.exit(f"train: {error}")
    except KeyboardInterrupt:
        sys.exit("train: interrupted; the same command goes on after the last whole iteration.")
