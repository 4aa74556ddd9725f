# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Looks a task over before it is trained on: what its cost is made of, and what looks wrong."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from vgps_ros.core.ddp.solve import Iteration
from vgps_ros.core.errors import VgpsError
from vgps_ros.core.records import Array, LinearDynamics, Trajectory
from vgps_ros.search.first_motion import first_motion
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.settings import search_settings
from vgps_ros.search.situations import check_situations
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.tasks import Task

_POINTS = 40  # steps whose derivatives are compared with centred differences
_HARD = 1e-2  # error of a derivative from which on contact is too hard
_AT_LIMIT = 0.1  # share of the steps in which a control may be at its limit
_UNMOVED = 1e-9  # a reading that all controls together move by less does not count as moved


@dataclass
class TaskCheck:
    """The findings about a task.

    Attributes:
        parts: name of each part of the cost with what it costs along the first rollout, and along
            the optimised one.
        costs: the cost of the first rollout, then after each iteration of DDP.
        seconds: wall time of all iterations [s].
        errors: error of the derivatives of each point, relative to the largest entry.
        troubles: a sentence on each thing that looks wrong.
        optimized: the optimised trajectory; None if there is none.
    """

    parts: list[tuple[str, float, float]] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)
    seconds: float = 0.0
    errors: list[float] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)
    optimized: Trajectory | None = None


def check_task(
    task: Task, iterations: int, seed: int, on_iteration: Callable[[int, float], None]
) -> TaskCheck:
    """Looks a task over.

    Args:
        task: the task.
        iterations: most iterations of DDP.
        seed: seed of the first controls, where they are drawn.
        on_iteration: called with the number of each iteration and the cost after it.

    Raises:
        InvalidInputError: the task's settings of the policy search are out of range, or do not
            suit its robot.
    """
    check_situations(task, search_settings(task), seed)
    found = TaskCheck()
    request = first_request(task, seed, iterations)
    try:
        first = first_motion(task, request).trajectory
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
    found.troubles += _unmoved(task, first, linear) + _too_hard(found.errors)

    def note(iteration: Iteration) -> None:
        found.costs.append(iteration.cost)
        on_iteration(iteration.index, iteration.cost)

    began = time.perf_counter()
    try:
        found.optimized = optimize(task, request, note).distribution.mean
    except VgpsError as error:
        found.troubles.append(f"DDP fails: {error}")
    found.seconds = time.perf_counter() - began
    found.parts = _parts(task, first, found.optimized or first)
    if found.optimized:
        found.troubles += _after(task, found.optimized, found.costs)
    return found


def derivative_errors(task: Task, trajectory: Trajectory) -> list[float]:
    """Returns the error of f_x, f_u against centred differences, at steps along a trajectory."""
    at = np.unique(np.linspace(0, trajectory.horizon - 1, _POINTS).astype(int))
    points = Trajectory(trajectory.states[[*at, at[-1] + 1]], trajectory.controls[at])
    plain, centred = (
        np.concatenate([linear.f_x, linear.f_u], axis=2)
        for linear, _ in (task.dynamics.linearize(points, centred=c) for c in (False, True))
    )
    sizes = np.abs(centred).max(axis=(1, 2))
    return list((np.abs(plain - centred).max(axis=(1, 2)) / sizes).tolist())


def _parts(task: Task, first: Trajectory, last: Trajectory) -> list[tuple[str, float, float]]:
    """Returns what each reading and the controls cost along two trajectories."""
    rows = []
    for motion in (first, last):
        readings = task.cost.parts(motion.states[:-1], motion.controls).sum(axis=0)
        controls = float((motion.controls**2 @ task.cost.control_weights).sum())
        rows.append([*readings.tolist(), controls])
    names = [*task.cost_names, "controls"]
    return list(zip(names, *rows, strict=True))


def _unmoved(task: Task, motion: Trajectory, linear: LinearDynamics) -> list[str]:
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


def _too_hard(errors: list[float]) -> list[str]:
    error = float(np.quantile(errors, 0.9))
    if error < _HARD:
        return []
    return [
        f"The derivatives are off by {100 * error:.0f} % in a tenth of the steps: contact is too "
        'hard; soften it (changes: {geoms: {"*": {solref: [0.04, 1], solimp: [0, 0.95, 0.02, 0.5, '
        "2]}}})."
    ]


def _after(task: Task, motion: Trajectory, costs: list[float]) -> list[str]:
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
