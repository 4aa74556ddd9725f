# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""New situations where the policy goes, in place of some of the old ones.

A policy leaves the motions that it was taught, and falls where nothing was taught. So the policy is
rolled out, and a new situation begins on the way: shortly before a fall, where it has most to
learn, or anywhere. Half of the new situations add a kick. Their first motion is the cheapest of
several: the policy's own, the task's, and those of the feedback of old q(ζ). What is found no
solution for is dropped. The policy goes on learning from samples of the q(ζ) that were replaced.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.errors import DivergenceError, VgpsError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_fit import Targets, draw_targets
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.situations import Situation, drawn_context
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.search.workspace import Workspace
from vgps_ros.simulation.model import cyclic_positions
from vgps_ros.tasks import Task
from vgps_ros.tasks.disturbed_task import disturbed, draw_disturbance

_BEFORE_FALL = (0.3, 0.9)  # [s]
_RETURN = 0.3  # τ, in which a kicked robot comes back to its motion [s]
_KICKED = 0.5  # share of the new situations
_TOLD_ANEW = 0.6  # share of the new situations with new commands


def is_due(work: Workspace, k: int) -> bool:
    """Returns whether situations are replaced before iteration k."""
    settings = work.settings.renew
    return settings.share > 0.0 and settings.begin <= k <= work.settings.iterations - settings.end


def renew(
    work: Workspace, solutions: Sequence[OptimizationResult], policy: GaussianPolicy, k: int
) -> tuple[tuple[OptimizationResult, ...], list[Targets]]:
    """Replaces some situations by new ones; the first one stays.

    Args:
        work: problem and settings.
        solutions: q(ζ) of the situations.
        policy: π_θ, which shows where to begin.
        k: the iteration.

    Returns:
        The solutions, and samples of each that was replaced.
    """
    settings, rng = work.settings.renew, generator(work.seed, Stream.RENEWAL, k)
    count = max(1, round(settings.share * (len(solutions) - 1)))
    replaced = 1 + rng.permutation(len(solutions) - 1)[:count]
    requests = []
    for i in replaced:
        situation, calm = _new_situation(work, solutions, policy, k, int(i))
        motion = _first_motion(work, situation, calm, policy, k, int(i))
        if motion is None:
            continue
        request = replace(
            work.request(int(i), situation, k),
            cost_scale=1.0,
            max_iterations=settings.ddp_iterations,
            guess=motion.controls,
            guess_states=motion.states,
        )
        requests.append(request)
    worst = settings.worst * float(np.median([each.cost for each in solutions]))
    found, dropped = list(solutions), []
    for request, outcome in zip(requests, work.optimize(requests), strict=True):
        i = request.trajectory_index
        if not isinstance(outcome, DivergenceError) and outcome.cost <= worst:
            dropped.append(_samples(work, solutions[i], k, i))
            found[i] = outcome
    return tuple(found), dropped


def _new_situation(
    work: Workspace,
    solutions: Sequence[OptimizationResult],
    policy: GaussianPolicy,
    k: int,
    i: int,
) -> tuple[Situation, Array]:
    """Returns a situation that begins where a motion of the policy goes.

    Also returns its start without the kick, shape (n_x,).
    """
    task, settings = work.task, work.settings
    rng = generator(work.seed, Stream.RENEWAL, k, i)
    disturbance = draw_disturbance(task, settings.disturb, rng)
    here, signals = disturbed(task, replace(disturbance, push=(0.0, 0.0))), task.signals
    steps = max(2, round(settings.renew.seconds / task.dynamics.time_step))
    space = task.dynamics.space
    if rng.uniform() < 0.5:
        start = task.initial_state
    else:
        start = solutions[int(rng.integers(len(solutions)))].situation.initial_state
    start = space.add(start, task.initial_std * rng.standard_normal(space.tangent_dim))
    commands = signals.draw(rng, settings.commands.still)
    first = rng.uniform() if signals.moves(commands) else 0.0
    each = np.tile(commands, (steps, 1))
    phases = signals.phases(each, first)
    noise = (
        settings.renew.noise
        * policy.noise_std
        * rng.standard_normal((1, steps, len(policy.noise_std)))
    )
    told = here.observation.within(signals.context(each, phases[:-1]))
    states, _ = here.dynamics.execute(policy, told, start[None], noise)
    at = _where(here, states[0], rng, settings.renew.before_fall)
    calm = begun = _back_home(task, states[0, at])
    if settings.renew.kick and rng.uniform() < _KICKED:
        kick = settings.renew.kick * rng.standard_normal(space.tangent_dim)
        begun = space.add(calm, kick * base_velocities(task))
    if rng.uniform() < _TOLD_ANEW:
        context = drawn_context(task, settings, rng)
    else:
        each = np.tile(commands, (task.planned_horizon, 1))
        context = signals.context(each, signals.phases(each, phases[at])[:-1])
    return Situation(begun, context, disturbance), calm


def _where(task: Task, states: Array, rng: np.random.Generator, before_fall: float) -> int:
    """Returns the step of a motion (T+1, n_x) at which a situation begins."""
    sound = np.isfinite(states).all(axis=1) & ~task.fallen(states)
    last, period = len(states) - 1, task.dynamics.time_step
    if sound.all():
        return int(rng.integers(last))
    fall = int(np.argmin(sound))
    early, late = (round(seconds / period) for seconds in reversed(_BEFORE_FALL))
    if rng.uniform() < before_fall:
        return max(0, fall - int(rng.integers(late, early)))
    return int(rng.integers(max(1, fall - late)))


def _back_home(task: Task, state: Array) -> Array:
    """Returns a state (n_x,) at the place of the task's start, where all places are the same."""
    space, moved = task.dynamics.space, state.copy()
    in_x = dict(zip(*(places.tolist() for places in reversed(space.plain)), strict=True))
    level = [in_x[i] for i in cyclic_positions(task.dynamics.model)]
    moved[level] = task.initial_state[level]
    return moved


def _first_motion(
    work: Workspace,
    situation: Situation,
    calm: Array,
    policy: GaussianPolicy,
    k: int,
    i: int,
) -> Trajectory | None:
    """Returns the motion from which a situation's first solve starts; None: all of them diverge.

    After a kick it is the policy's motion without the kick, which the kick's deviation joins and
    leaves again; the solve closes the gaps. Otherwise it is the cheaper one of the policy's own and
    the task's.
    """
    task, here = work.task, situation.of(work.task)
    steps, start = task.planned_horizon, situation.initial_state
    silent = np.zeros((1, steps, task.dynamics.control_dim))
    states, controls = here.dynamics.execute(policy, here.observation, calm[None], silent)
    motions = [Trajectory(states[0], controls[0])]
    if calm is not start and np.isfinite(states).all():
        return _joined(task, start, motions[0])
    rng = generator(work.seed, Stream.INITIAL_CONTROLS, k, i)
    with contextlib.suppress(VgpsError):
        motions.append(_task_motion(here, start, rng))
    sound = [motion for motion in motions if np.isfinite(motion.states).all()]
    return min(sound, key=here.trajectory_cost, default=None)


def _joined(task: Task, start: Array, motion: Trajectory) -> Trajectory:
    """Returns a motion that begins elsewhere, and comes back to the one given as time passes.

    The difference of the starts decays, e^(−t/τ); where all places are the same, the base goes as
    far as its difference of velocity carries it meanwhile.
    """
    space, n_v = task.dynamics.space, task.dynamics.model.nv
    difference = space.subtract(start, motion.states[0])
    times = task.dynamics.time_step * np.arange(motion.horizon + 1)
    fading = np.exp(-times / _RETURN)
    deviations = fading[:, None] * difference
    level = cyclic_positions(task.dynamics.model)
    come = _RETURN * (1.0 - fading)
    deviations[:, level] += come[:, None] * difference[[n_v + i for i in level]]
    return Trajectory(space.add(motion.states, deviations), motion.controls)


def _task_motion(task: Task, start: Array, rng: np.random.Generator) -> Trajectory:
    """Returns the task's own first motion from a start."""
    steps = task.planned_horizon
    if task.demonstrate is not None:
        return task.demonstrate(start, steps, rng)
    guess = task.guess(rng) if task.guess else np.zeros((steps, task.dynamics.control_dim))
    return task.dynamics.rollout(start, lambda t, _: guess[t], steps)


def base_velocities(task: Task) -> NDArray[np.bool_]:
    """Returns which coordinates of a deviation are velocities of the robot's base, (n_dx,).

    The base is the first body that moves.
    """
    model: mujoco.MjModel = task.dynamics.model
    of_base = model.dof_bodyid == model.dof_bodyid[0]
    n_v = model.nv
    return np.concatenate([np.zeros(n_v, bool), of_base, np.zeros(model.na, bool)])


def _samples(work: Workspace, solution: OptimizationResult, k: int, i: int) -> Targets:
    """Draws samples of a q(ζ) that is replaced, from which the policy goes on learning."""
    settings = work.settings.fit
    rng = generator(work.seed, Stream.DATASET, k, i)
    (q,) = work.scored([solution])
    return draw_targets([q], work.task.observation, settings.form, settings.samples_per_step, rng)
