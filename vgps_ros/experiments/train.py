"""Program `train`: Algorithm 1 in this process, without a graph."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vgps_ros.core.ddp import Iteration
from vgps_ros.core.errors import VgpsError
from vgps_ros.core.policy_file import save_policy, write_json
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.experiments.command_line import add_flags, settings_from
from vgps_ros.search.remaining_time import RemainingTime
from vgps_ros.search.result import iteration_entry, result_content
from vgps_ros.search.trajectory_optimizer import (
    OptimizationRequest,
    OptimizationResult,
    OptimizerSettings,
    TrajectoryOptimizer,
)
from vgps_ros.search.vgps import SearchSettings, search_settings, vgps
from vgps_ros.tasks import TASKS, Task, make_task
from vgps_ros.views.plots import learning_curve, save
from vgps_ros.views.run_record import TRAJECTORIES, RunRecord
from vgps_ros.views.training_progress import TrainingProgress


def train(task: Task, settings: SearchSettings, seed: int, output: Path) -> None:
    """Trains a policy and writes result.json and policy.json after each iteration.

    Raises:
        VgpsError: a setting is out of range, or the first rollout diverges.
    """
    output.mkdir(parents=True, exist_ok=True)
    optimizer = TrajectoryOptimizer(task, OptimizerSettings(task.ddp))
    entries = []
    solutions: dict[str, TrajectoryDistribution] = {}  # of the first initial state
    remaining = RemainingTime(settings.iterations)
    with TrainingProgress(settings.iterations, settings.initial_ddp_iterations) as progress:

        def optimize(request: OptimizationRequest) -> OptimizationResult:
            def show(iteration: Iteration) -> None:
                if request.iteration == 0:
                    progress.ddp_iteration(iteration.index)

            result = optimizer.optimize(request, on_iteration=show)
            if request.trajectory_index == 0:
                which = "last" if request.iteration else "initial"
                solutions[which] = result.distribution.first(task.horizon)
            return result

        for iteration in vgps(
            task, settings, seed, lambda requests: [optimize(request) for request in requests]
        ):
            entries.append(iteration_entry(iteration))
            content = result_content(
                task=task.name,
                seed=seed,
                hidden_units=settings.hidden_units,
                num_parameters=iteration.policy.architecture.num_parameters,
                initial_ddp_cost=iteration.initial_ddp_cost,
                iterations=entries,
            )
            write_json(output / "result.json", content)
            save_policy(iteration.policy, task.name, output / "policy.json")
            left = remaining.after(iteration)
            progress.iteration(entries[-1], iteration.initial_ddp_cost, left)
    policy = iteration.policy
    initial, last = solutions["initial"].mean, solutions["last"]
    executed = task.dynamics.rollout(initial.states[0], lambda t, x: policy.mean(x), task.horizon)
    run = RunRecord(
        task.model_path.read_text(),
        task.dynamics.time_step,
        content,
        initial.states,
        last.mean.states,
        last.state_covariances,
        executed.states,
    )
    run.save_trajectories(output)
    save(learning_curve(content), output / "learning_curve.png")
    print(
        f"Wrote result.json, policy.json, {TRAJECTORIES} and learning_curve.png to {output}; "
        f"`ros2 run vgps_ros plot {output}` draws the rest."
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the program."""
    which = argparse.ArgumentParser(prog="train", add_help=False)
    which.add_argument("--task", choices=sorted(TASKS), default="swimmer", help="control problem")
    which.add_argument(
        "--demonstration", default="", help="table of a recorded motion to start from"
    )
    chosen, _ = which.parse_known_args(arguments)
    try:
        task = make_task(chosen.task, chosen.demonstration)
    except VgpsError as error:
        sys.exit(f"train: {error}")
    # The task names the defaults of the other flags.
    parser = argparse.ArgumentParser(
        prog="train",
        parents=[which],
        description="Learns a policy by variational guided policy search in this process, and "
        f"writes result.json, policy.json, {TRAJECTORIES} and learning_curve.png.",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random draws")
    parser.add_argument("--output", type=Path, required=True, help="folder for the results")
    add_flags(parser, search_settings(task), frozenset())
    parsed = parser.parse_args(arguments)
    try:
        settings = settings_from(parsed, search_settings(task))
        train(task, settings, parsed.seed, parsed.output)
    except (VgpsError, OSError) as error:
        sys.exit(f"train: {error}")
    except KeyboardInterrupt:
        sys.exit("train: interrupted; the results up to the last iteration are written.")
