# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Looks a task over: dimensions, cost, derivatives, DDP's progress, a picture, what looks wrong.

It takes seconds, and changes nothing. Example: vgps check hopper/task.yaml
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vgps_ros.core.errors import VgpsError
from vgps_ros.core.records import Array, LinearDynamics, Trajectory
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Setting
from vgps_ros.programs.command_line import Parser, picture, refuse_existing

if TYPE_CHECKING:
    from vgps_ros.core.ddp.solve import Iteration
    from vgps_ros.tasks import Task

ITERATIONS = Setting("iterations", 40, "most iterations of DDP", minimum=1, maximum=10_000)

_POINTS = 40  # steps whose derivatives are compared with centred differences
_HARD = 1e-2  # error of a derivative from which on contact is too hard
_AT_LIMIT = 0.1  # share of the steps in which a control may be at its limit
_UNMOVED = 1e-9  # a reading that all controls together move by less does not count as moved


@dataclass
class TaskCheck:
    """The findings about a task."""

    # Each part of the cost: its name, what it costs along the first and the optimised motion.
    parts: list[tuple[str, float, float]] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)  # at first, and after each iteration of DDP
    seconds: float = 0.0  # wall time of all iterations
    errors: list[float] = field(default_factory=list)  # of the derivatives, of the largest entry
    troubles: list[str] = field(default_factory=list)  # a sentence on each
    optimized: Trajectory | None = None


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of this command."""
    parser.add_argument("task", help="a name, a task file or its folder, or FILE.py:FUNCTION")
    parser.add_settings(ITERATIONS, SEED)
    text = "file for a picture of the optimised motion, such as motion.png"
    parser.add_output("--picture", text, type=picture)


def run(arguments: argparse.Namespace) -> None:
    """Checks the task, and prints what it finds."""
    from rich.console import Console
    from rich.progress import Progress

    from vgps_ros.tasks import make_task

    if arguments.picture:
        refuse_existing([arguments.picture], overwrite=arguments.overwrite)
    task = make_task(arguments.task)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("DDP", total=arguments.iterations)
        found = examine_task(
            task,
            arguments.iterations,
            arguments.seed,
            lambda index, _: progress.update(bar, completed=index),
        )
    _show(task, found)
    if arguments.picture and found.optimized:
        _draw(task, found, arguments.picture)


def _show(task: "Task", found: TaskCheck) -> None:
    """Prints what was found."""
    from rich.table import Column, Table
    from rich.text import Text

    from vgps_ros.views.console import table_console

    console, dims, freedoms = table_console(), task.dims, task.dynamics.model.nv
    console.print(
        f"{dims['n_x']} numbers a state ({freedoms} degrees of freedom, positions and "
        f"velocities), {dims['n_u']} controls, {task.controls.label()} "
        f"({', '.join(task.controls.names)}), "
        f"{task.horizon} steps of {task.dynamics.time_step:g} s and {task.lookahead} beyond, each "
        f"of {task.dynamics.substeps} simulator steps."
    )
    console.print(f"The policy reads {', '.join(task.observation.names)}.")
    if found.parts:
        table = Table(
            "part of the cost",
            Column("first rollout", justify="right"),
            Column("optimised", justify="right"),
        )
        for name, first, last in found.parts:
            table.add_row(name, f"{first:.4g}", f"{last:.4g}")
        table.add_row(
            "all",
            f"{sum(first for _, first, _ in found.parts):.4g}",
            f"{sum(last for _, _, last in found.parts):.4g}",
            style="bold",
        )
        console.print(table)
    if len(found.costs) > 1:
        count = len(found.costs) - 1
        console.print(
            f"DDP: {found.costs[0]:.4g} to {found.costs[-1]:.4g} in {count} iterations and "
            f"{found.seconds:.1f} s, {found.seconds / count:.3f} s each."
        )
    if found.errors:
        median, most = np.quantile(found.errors, [0.5, 0.9])
        console.print(
            f"Derivatives differ from centred differences by {median:.1e} (median over steps), "
            f"{most:.1e} (90 %)."
        )
    for trouble in found.troubles:
        console.print(Text.assemble(("!", "bold red"), f" {trouble}"))
    if not found.troubles:
        console.print("Nothing looks wrong.", style="green")


def _draw(task: "Task", found: TaskCheck, path: Path) -> None:
    from vgps_ros.search.run_record import RunRecord
    from vgps_ros.views.filmstrip import RenderingError, filmstrip
    from vgps_ros.views.plots import motion, save

    assert found.optimized is not None
    run = RunRecord(task.mjcf, task.dynamics.time_step, executed_states=found.optimized.states)
    try:
        figure = filmstrip(run)
    except RenderingError:  # no OpenGL on this machine
        figure = motion(run)
    assert figure is not None
    save(figure, path)
    print(f"Wrote {path}.")


def examine_task(
    task: "Task", iterations: int, seed: int, on_iteration: Callable[[int, float], None]
) -> TaskCheck:
    """Looks a task over.

    `on_iteration` is called with the number of each iteration and the cost after it.

    Raises:
        InvalidInputError: the task's settings of the policy search are out of range, or do not
            suit its robot.
    """
    from vgps_ros.search.optimization_request import first_request, nominal_of
    from vgps_ros.search.settings import search_settings
    from vgps_ros.search.situations import check_situations
    from vgps_ros.search.trajectory_optimization import optimize

    check_situations(task, search_settings(task), seed)
    found = TaskCheck()
    request = first_request(task, seed, iterations)
    try:
        first = nominal_of(task, request).trajectory
        found.costs.append(float(task.cost.values(first).sum()))
    except VgpsError as error:
        found.troubles.append(f"The first rollout fails: {error}")
        return found
    if not (np.isfinite(first.states).all() and np.isfinite(found.costs[0])):
        found.troubles.append(
            "The first rollout diverges: begin with smaller controls (begin: std), add damping "
            '(changes: {joints: {"*": {damping: 1.0}}}), or choose a shorter time step.'
        )
        return found
    linear, _ = task.dynamics.linearize(first)
    found.errors = derivative_errors(task, first)
    found.troubles += _unmoved(task, first, linear)
    if (hardness := float(np.quantile(found.errors, 0.9))) >= _HARD:
        found.troubles.append(
            f"The derivatives are off by {100 * hardness:.0f} % in a tenth of the steps: contact "
            'is too hard; soften it (changes: {geoms: {"*": {solref: [0.04, 1], solimp: [0, 0.95, '
            "0.02, 0.5, 2]}}})."
        )

    def note(iteration: "Iteration") -> None:
        found.costs.append(iteration.cost)
        on_iteration(iteration.index, iteration.cost)

    began = time.perf_counter()
    try:
        found.optimized = optimize(task, request, note).distribution.mean
    except VgpsError as error:
        found.troubles.append(f"DDP fails: {error}")
    found.seconds = time.perf_counter() - began
    costs = []
    for motion in (first, found.optimized or first):
        readings = task.cost.parts(motion.states[:-1], motion.controls).sum(axis=0)
        deviations = motion.controls - task.cost.control_targets
        controls = float((deviations**2 @ task.cost.control_weights).sum())
        costs.append([*readings.tolist(), controls])
    found.parts = list(zip([*task.cost_names, "controls"], *costs, strict=True))
    if found.optimized:
        found.troubles += _after(task, found.optimized, found.costs)
    return found


def derivative_errors(task: "Task", trajectory: Trajectory) -> list[float]:
    """Returns the error of f_x, f_u against centred differences, at steps along a trajectory."""
    at = np.unique(np.linspace(0, trajectory.horizon - 1, _POINTS).astype(int))
    points = Trajectory(trajectory.states[[*at, at[-1] + 1]], trajectory.controls[at])
    plain, centred = (
        np.concatenate([linear.f_x, linear.f_u], axis=2)
        for linear, _ in (task.dynamics.linearize(points, centred=c) for c in (False, True))
    )
    sizes = np.abs(centred).max(axis=(1, 2))
    return list((np.abs(plain - centred).max(axis=(1, 2)) / sizes).tolist())


def _unmoved(task: "Task", motion: Trajectory, linear: LinearDynamics) -> list[str]:
    """Names the readings of the cost that no control changes along a motion, by the chain rule."""
    states, controls = motion.states[:-1], motion.controls
    _, j_x, j_u = task.cost.features.linearize(states, controls)
    moved = np.abs(j_u).sum(axis=(0, 2))
    adjoint: Array = np.zeros(j_x.shape[1:])  # of the sum of each reading over the later steps
    for t in reversed(range(motion.horizon)):
        moved += np.abs(adjoint @ linear.f_u[t]).sum(axis=1)
        adjoint = j_x[t] + adjoint @ linear.f_x[t]
    return [
        f"No control moves the cost's {name}: is it the right sensor, and are the actuators strong "
        "enough?"
        for name, size in zip(task.cost_names, moved, strict=True)
        if size < _UNMOVED
    ]


def _after(task: "Task", motion: Trajectory, costs: list[float]) -> list[str]:
    """Names what looks wrong about the optimised motion."""
    troubles = []
    low, high = task.dynamics.control_limits
    beyond = ((motion.controls <= low) | (motion.controls >= high)) & np.isfinite(high)
    shares = beyond.mean(axis=0)
    for name, share in zip(task.actuated_joint_names, shares, strict=True):
        if share > _AT_LIMIT:
            troubles.append(
                f"The control of {name} is at its limit in {100 * share:.0f} % of the steps, "
                "which DDP keeps to: allow more, or give controls more weight, if it should have "
                "some left for what disturbs it."
            )
    if costs[0] and (len(costs) < 2 or costs[-1] > 0.99 * costs[0]):  # nothing can be below 0
        troubles.append(
            "DDP hardly lowers the cost: begin with another motion, or raise "
            "ddp.initial_regularization and ddp.regularization_floor (optimizer)."
        )
    if task.fallen(motion.states[: task.horizon]).any():
        troubles.append(
            "The optimised motion falls: score what keeps the robot up, or find a first motion "
            "that does not fall by `begin: {law: sampling}`."
        )
    return troubles
