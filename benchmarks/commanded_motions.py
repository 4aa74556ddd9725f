# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What DDP's own motions do of a command, without any policy: where does a limit come from?

Each value of the command is a motion of some seconds, longer than those that a policy learns from.
It begins with the optimum of the value before, the first one with the task's own motion. A row of
Markdown says what is asked, the mean that is done from one second on, from which share of starts
around the task's the feedback of q keeps the robot up, and what a second costs.

    python -m benchmarks.commanded_motions recordings/g1/task.yaml turn 0 0.2 0.4 0.6 0.8 1.0 1.2
"""

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from vgps_ros.core.records import Trajectory, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.commanded_motion import CommandedMotion
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.trajectory_optimization import OptimizationResult, optimize
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.tasks import Task, make_task
from vgps_ros.tasks.task import Nominal

STARTS = 20


def lasting(task: Task, seconds: float) -> Task:
    """Returns the task of a longer horizon, whose solves end late, where nothing is commanded."""
    longer = replace(
        task,
        horizon=round(seconds / task.dynamics.time_step),
        optimizer=replace(task.optimizer, first_tolerance=0.0),
    )
    return longer.commanded(task.signals.rest)


def solved(
    task: Task, command: str, value: float, iterations: int, first: Trajectory | None
) -> tuple[Task, OptimizationResult]:
    """Returns the task where one command has a value, and its solve from a first motion."""
    names = [each.name for each in task.signals.commands]
    told = np.where(np.array(names) == command, value, task.signals.rest)
    here = task.commanded(told)
    start = Nominal(first) if first else None
    return here, optimize(here, first_request(here, 0, iterations), start=start)


def borne(task: Task, q: TrajectoryDistribution) -> float:
    """Returns in which share of the starts around the task's the feedback of q keeps it up."""
    rng, space = generator(0, Stream.EVALUATION), task.dynamics.space
    draws = task.initial_std * rng.standard_normal((STARTS, space.tangent_dim))
    up = []
    for start in space.add(task.initial_state, draws):
        (motion,) = task.dynamics.follow_each(start, [q.mean], q.gains)
        states = motion.states[: task.horizon + 1]
        up.append(bool(np.isfinite(states).all() and not task.fallen(states).any()))
    return float(np.mean(up))


def parts(task: Task, motion: Trajectory) -> dict[str, float]:
    """Returns what each term and the controls cost in a second."""
    seconds = motion.horizon * task.dynamics.time_step
    costs = task.cost.parts(motion.states[:-1], motion.controls).sum(axis=0) / seconds
    deviations = motion.controls - task.cost.control_targets
    controls = float((deviations**2 @ task.cost.control_weights).sum()) / seconds
    return dict(zip([*task.cost_names, "controls"], [*costs.tolist(), controls], strict=True))


def main() -> None:
    """Prints a row for each value of a command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("task", help="its name or file")
    parser.add_argument("command")
    parser.add_argument("values", type=float, nargs="+")
    parser.add_argument("--seconds", type=float, default=3.0, help="length of a motion")
    parser.add_argument("--iterations", type=int, default=60, help="of DDP, at most")
    given = parser.parse_args()
    silence_mujoco()
    task, motion = lasting(make_task(given.task), given.seconds), None
    print(
        "| asked | done | up | by feedback | cost of a second | the largest terms | DDP | seconds |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for value in given.values:
        began = time.process_time()
        here, found = solved(task, given.command, value, given.iterations, motion)
        motion = found.distribution.mean
        scored = motion.first(here.horizon)
        done = CommandedMotion.of(here, scored, here.planned_context[: here.horizon])
        if done is None:
            sys.exit(f"Nothing in the cost of {task.name} follows a command.")
        column = [each.name for each in done.commands].index(given.command)
        achieved = done.done[done.counts, column].mean()
        up = not here.fallen(scored.states).any()
        costs = parts(here, scored)
        shown = sorted(costs.items(), key=lambda item: -item[1])[:4]
        terms = ", ".join(f"{name} {cost:.1f}" for name, cost in shown)
        how = f"{len(found.iterations)} iterations, {found.status.value}"
        cells = [f"{value:g}", f"{achieved:.3f}", "yes" if up else "no"]
        cells += [f"{borne(here, found.distribution):.0%}", f"{sum(costs.values()):.1f}"]
        cells += [terms, how, f"{time.process_time() - began:.0f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
