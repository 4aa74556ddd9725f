# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""New situations where the policy goes, in place of some of the old ones.

A policy leaves the motions that it was taught, and falls where nothing was taught. So the policy is
rolled out, with pushes or without, and a new situation begins on the way: after the push, shortly
before a fall or where it obeys least, since it has most to learn there, or anywhere.

What the policy itself does from there is the first motion if it bears it. Otherwise that is the
motion that the policy makes in the long run under the same commands, at the same phase of the
clock: the new start's deviation from it decays, and the solve closes the gaps to the dynamics. Of
pushes of 30 N·s on a quadruped of 12 kg, 9 of 10 have a solution so; from the policy's fall it was
found for 3 of 10, and from a law that holds a pose for 1 of 10.

Without commands every situation asks for the same, so that a known law may go on from any step of
its motion: the first motion is what costs least of the policy's own and of those to which the known
laws lead. Where a policy does not catch a ball, its own motion led to a solution for 0 of 5 starts,
and these for 4. So a situation that costs more than by another one's law begins anew from there.

A solution that ends badly is dropped. The policy goes on learning from samples of those q(ζ) that
were replaced.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_fit import Targets, draw_targets
from vgps_ros.core.records import Array, Trajectory, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.robot.signals import Signals
from vgps_ros.search.judgement import LATE, late_error
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.situations import Situation, drawn_context
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.search.workspace import Workspace
from vgps_ros.simulation.model import cyclic_positions, turning_hinges
from vgps_ros.tasks import Task
from vgps_ros.tasks.disturbance import Disturbance, DisturbanceSettings
from vgps_ros.tasks.disturbed_task import disturb_task, draw_disturbance

_AFTER_PUSH = 0.5  # [s]
_NOISE = 0.5  # factor on the policy's noise
_BEFORE_FALL = 0.6  # share of the falls shortly before which a situation begins, not anywhere
_CHANGE = (1.0, 3.0)  # time after which the motion has other commands [s]
_LEAST_OBEYED = 0.25  # share of the new situations, without a fall, that begin where it obeys least
_TOLD_ANEW = 0.5  # share of the others with new commands, where there was no fall
_RETURN = 0.3  # time constant in which a start's deviation decays in its first motion [s]
_WARM_UP = 1.0  # after which the policy's motion is that of the long run [s]
_MOST = 6.0  # cost of a solution, as a multiple of the first ones' median, that is no recovery
_TRIES = 4  # motions of the policy, until one falls; of those that stay up the worst one counts
_END = 0.25  # share of the horizon by which a solution is judged
_BETTER = 0.1  # of the first ones' median cost, by which another one's law must be better
_ARRIVED = 0.05  # of the mean cost of a step: what costs less has arrived where nothing costs


def is_due(work: Workspace, k: int) -> bool:
    """Returns whether situations are replaced before iteration k."""
    settings = work.settings.renew
    return settings.share > 0.0 and settings.begin <= k <= work.settings.iterations - settings.end


def renew(
    work: Workspace, solutions: Sequence[OptimizationResult], policy: GaussianPolicy, k: int
) -> tuple[tuple[OptimizationResult, ...], list[Targets]]:
    """Replaces some situations by new ones, which begin where the policy goes; the first one stays.

    Returns:
        The solutions, and samples of each that was replaced.
    """
    settings, rng = work.settings.renew, generator(work.seed, Stream.RENEWAL, k)
    count = max(1, round(settings.share * (len(solutions) - 1)))
    replaced = [1 + int(i) for i in rng.permutation(len(solutions) - 1)[:count]]
    first = work.initial_solutions
    usual = float(np.median([each.cost for each in first]))

    def request(i: int, situation: Situation, motion: Trajectory) -> OptimizationRequest:
        return replace(
            work.request(i, situation, k),
            cost_scale=1.0,
            max_iterations=settings.ddp_iterations,
            guess=motion.controls,
            guess_states=motion.states,
        )

    def renewed(i: int) -> OptimizationRequest | None:
        begun = _new_situation(work, solutions, policy, k, i)
        motion = _first_motion(work, begun, policy, solutions)
        return request(i, begun.situation, motion) if motion else None

    def improved(i: int) -> OptimizationRequest | None:
        situation, others = solutions[i].situation, [*solutions[:i], *solutions[i + 1 :]]
        here = situation.of(work.task)
        motions = [
            _follow_feedback_law(here, situation.initial_state, each.distribution)
            for each in others
        ]
        best = min(motions, key=partial(_whole_cost, here), default=None)
        if best is None or _whole_cost(here, best) >= solutions[i].cost - _BETTER * usual:
            return None
        return request(i, situation, best)

    stayed = [i for i in range(len(solutions)) if i not in replaced]
    with ThreadPoolExecutor(work.task.dynamics.simulations.threads) as pool:
        requests = list(filter(None, pool.map(renewed, replaced)))
        if not work.task.signals.names:
            requests += filter(None, pool.map(improved, stayed))
    ends = float(np.median([_end_cost(work, each) for each in first]))
    worst = settings.worst * max(ends, _ARRIVED * usual / work.task.horizon)
    most = _MOST * usual
    found, dropped = list(solutions), []
    work.new_situations = len(replaced)
    for each, outcome in zip(requests, work.optimize(requests), strict=True):
        i = each.trajectory_index
        if isinstance(outcome, DivergenceError) or outcome.cost > most:
            continue
        if i in replaced and _end_cost(work, outcome) <= worst:
            dropped.append(_samples(work, solutions[i], k, i))
            found[i] = outcome
            work.found_situations += 1
        elif i not in replaced and outcome.cost < solutions[i].cost:
            found[i] = outcome
    return tuple(found), dropped


@dataclass(frozen=True)
class _Beginning:
    """A new situation."""

    situation: Situation  # the situation
    commands: Array  # the commands with which it begins, shape (n_c,)
    phase: float  # the clock's φ at its start, in turns
    signals: Signals  # of its context; after a push the clock turns also at rest


def _new_situation(
    work: Workspace, solutions: Sequence[OptimizationResult], policy: GaussianPolicy, k: int, i: int
) -> _Beginning:
    """Returns a situation that begins where a motion of the policy goes.

    Of a few motions it takes the first one with a fall, or else the one that obeys least, or costs
    most where there are no commands.
    """
    task, settings, signals = work.task, work.settings, work.task.signals
    rng = generator(work.seed, Stream.RENEWAL, k, i)
    period = task.dynamics.time_step
    lasting = draw_disturbance(task, settings.disturb, rng)
    motion = _roll_out_policy(work, solutions, policy, replace(lasting, push=(0.0, 0.0)), rng)
    for _ in range(_TRIES - 1):
        if motion.fall < len(motion.commands):
            break
        other = _roll_out_policy(work, solutions, policy, replace(lasting, push=(0.0, 0.0)), rng)
        motion = max(motion, other, key=lambda each: each.error)
    steps, fall, end = len(motion.commands), motion.fall, motion.push_end
    early, late = (round(n * settings.renew.fall_lead / period) for n in (3, 1))
    least_obeyed = fall == steps and rng.uniform() < _LEAST_OBEYED
    if least_obeyed:
        at = steps - 1 - int(rng.integers(min(steps, round(LATE / period))))
    elif 0 < end < fall:
        latest = min(round(_AFTER_PUSH / period), (fall - end) // 2 if fall < steps else steps)
        at = min(end + int(rng.integers(1 + latest)), fall - 1)
    elif fall < steps and rng.uniform() < _BEFORE_FALL:
        at = max(0, fall - int(rng.integers(late, max(early, late + 1))))
    else:
        at = int(rng.integers(max(1, fall - late if fall < steps else steps)))
    begun = _back_home(task, motion.states[at])
    commands, phase = motion.commands[at], float(motion.phases[at])
    if motion.awake[at] or fall < steps:
        signals = signals.turning
    context = signals.constant_context(commands, task.planned_horizon, phase)
    if fall == steps and not end and not least_obeyed and rng.uniform() < _TOLD_ANEW:
        context = drawn_context(task, settings, rng)
        commands, phase = context[0, : len(commands)], signals.phase_of(context[0])
    return _Beginning(Situation(begun, context, lasting), commands, phase, signals)


@dataclass(frozen=True)
class _PolicyMotion:
    """A motion of the policy, under commands that change once."""

    states: Array  # shape (T+1, n_x)
    commands: Array  # of each step, shape (T, n_c)
    phases: Array  # the clock's φ, shape (T,)
    push_end: int  # step after a push; 0 where there is none
    fall: int  # step of the fall; T where there is none
    awake: NDArray[np.bool_]  # whether a clock that stops turns in each step, shape (T,)
    # Largest mean error of a command over the last seconds, as a share of its range, or of a task
    # without commands the mean cost of a step; inf after a fall.
    error: float


def _roll_out_policy(
    work: Workspace,
    solutions: Sequence[OptimizationResult],
    policy: GaussianPolicy,
    disturbance: Disturbance,
    rng: np.random.Generator,
) -> _PolicyMotion:
    """Rolls the policy out for a while, from some start, under some commands, often with a push."""
    task, settings, signals = work.task, work.settings, work.task.signals
    period, space = task.dynamics.time_step, task.dynamics.space
    steps, push_end = max(2, round(settings.renew.seconds / period)), 0
    if settings.renew.push and rng.uniform() < settings.renew.pushed:
        push = drawn_push(task, settings, rng.uniform(0.1, 1.0), settings.renew.seconds / 4, rng)
        disturbance = replace(disturbance, push=push.push, push_time=push.push_time)
        push_end = round((push.push_time + push.push_duration) / period)
    start = task.initial_state
    if rng.uniform() < 0.5:
        start = solutions[int(rng.integers(len(solutions)))].situation.initial_state
    start = space.add(start, task.initial_std * rng.standard_normal(space.tangent_dim))
    first, later = (signals.draw(rng, settings.commands) for _ in range(2))
    change = min(steps, round(rng.uniform(*_CHANGE) / period))
    commands = np.concatenate([np.tile(first, (change, 1)), np.tile(later, (steps - change, 1))])
    phases = signals.phases(steps, rng.uniform())
    here, noise = disturb_task(task, disturbance), _NOISE * policy.noise_std
    context, unrest = signals.context(commands, phases), here.unrest
    states, controls = here.dynamics.execute(
        policy,
        here.observation.within(signals.turning.context(commands, phases)),
        start[None],
        noise * rng.standard_normal((1, steps, len(noise))),
        unrest=unrest,
        calm=context[None],
    )
    sound = np.isfinite(states[0]).all(axis=1) & ~task.fallen(states[0])
    fall = steps if sound.all() else int(np.argmin(sound))
    error = np.inf
    if sound.all() and signals.commands:
        error = late_error(task, states, controls, context[None])
    elif sound.all():
        cost = task.in_context(context).cost.starting_at(0, steps)
        error = float(cost(states[:, :-1], controls, 0).mean())
    awake = unrest.awake(states[0, :-1]) if unrest else np.zeros(steps, dtype=bool)
    return _PolicyMotion(states[0], commands, phases, push_end, fall, awake, error)


def drawn_push(
    task: Task, settings: SearchSettings, share: float, before: float, rng: np.random.Generator
) -> Disturbance:
    """Draws a push as new situations have them, in any direction, before a time [s].

    Its impulse is the largest one, `renew.push`, times the root of the share.
    """
    size = settings.renew.push * np.sqrt(share)
    drawn = DisturbanceSettings(body=settings.disturb.body, push=size, push_before=before)
    return draw_disturbance(task, drawn, rng)


def _back_home(task: Task, state: Array) -> Array:
    """Returns a state (n_x,) at the place of the task's start, where all places are the same."""
    space, moved = task.dynamics.space, state.copy()
    in_x = dict(zip(*(places.tolist() for places in reversed(space.plain)), strict=True))
    level = [in_x[i] for i in cyclic_positions(task.dynamics.model)]
    moved[level] = task.initial_state[level]
    return moved


def _first_motion(
    work: Workspace,
    begun: _Beginning,
    policy: GaussianPolicy,
    solutions: Sequence[OptimizationResult],
) -> Trajectory | None:
    """Returns the motion from which a new situation's solve starts; None if it diverges."""
    task, situation, signals = work.task, begun.situation, begun.signals
    here = situation.of(task)
    start, n_u = situation.initial_state, task.dynamics.control_dim

    def motion(origin: Array, context: Array) -> Trajectory:
        silent, told = np.zeros((1, len(context), n_u)), here.observation.within(context)
        states, controls = here.dynamics.execute(policy, told, origin[None], silent)
        return Trajectory(states[0], controls[0])

    own = motion(start, situation.context)
    if not signals.names:
        known = [_follow_feedback_law(here, start, each.distribution) for each in solutions]
        own = min([own, *known], key=partial(_whole_cost, here))
    if task.survived(own.states[None])[0]:
        return own
    warm = round(_WARM_UP / task.dynamics.time_step)
    before = begun.phase - warm * signals.frequency * task.dynamics.time_step
    running_up = signals.constant_context(begun.commands, warm, before % 1.0)
    usual = motion(task.initial_state, np.concatenate([running_up, situation.context]))
    if task.survived(usual.states[None])[0]:
        rest = Trajectory(usual.states[warm:], usual.controls[warm:])
        return _join_at_start(task, start, rest)
    return own if np.isfinite(own.states).all() else None


def _whole_cost(task: Task, motion: Trajectory) -> float:
    """Returns what a motion costs; inf where it falls or diverges."""
    survived = task.survived(motion.states[None])[0]
    return float(task.cost.values(motion).sum()) if survived else float("inf")


def _follow_feedback_law(task: Task, start: Array, q: TrajectoryDistribution) -> Trajectory:
    """Follows the feedback law of a q(ζ), then holds still where it arrives.

    The law goes on from the step at which the policy would read most alike. The rest need not be
    feasible. The last steps' law is left out, since it holds little.
    """
    space, model, mean = task.dynamics.space, task.dynamics.model, q.mean
    read = task.observation(np.concatenate([mean.states, start[None]]))
    distances = np.linalg.norm((read[:-1] - read[-1]) / np.maximum(read.std(axis=0), 1e-3), axis=1)
    at = int(distances[: max(1, round((1.0 - _END) * mean.horizon))].argmin())
    moved, difference = np.zeros(space.tangent_dim), space.subtract(start, mean.states[at])
    turning = turning_hinges(model)
    moved[turning] = 2.0 * np.pi * np.round(difference[turning] / (2.0 * np.pi))
    level = cyclic_positions(model)
    moved[level] = difference[level]
    nominal = Trajectory(space.add(mean.states[at:], moved), mean.controls[at:])
    (led,) = task.dynamics.follow_each(start, [nominal], q.gains[at:])
    stays = led.states[-1].copy()
    stays[model.nq :] = 0.0
    resting = task.controls.resting(stays)
    return Trajectory(
        np.concatenate([led.states, np.tile(stays, (at, 1))]),
        np.concatenate([led.controls, np.tile(resting, (at, 1))]),
    )


def _join_at_start(task: Task, start: Array, motion: Trajectory) -> Trajectory:
    """Returns a motion from another start, which comes back to the one given as time passes.

    The motion is moved and turned to where the start is. The rest of their difference decays,
    e^(−t/τ), while the base goes as far as its difference of velocity carries it.
    """
    space, model = task.dynamics.space, task.dynamics.model
    level = cyclic_positions(model)
    states = (
        _turn_to_heading(model, motion.states, start) if len(level) == 2 else motion.states.copy()
    )
    difference = space.subtract(start, states[0])
    times = task.dynamics.time_step * np.arange(motion.horizon + 1)
    fading = np.exp(-times / _RETURN)[:, None]
    deviations = fading * difference
    come = _RETURN * (1.0 - fading)
    deviations[:, level] = difference[level] + come * difference[[model.nv + i for i in level]]
    return Trajectory(space.add(states, deviations), motion.controls)


def _turn_to_heading(model: mujoco.MjModel, states: Array, start: Array) -> Array:
    """Returns states (T, n_x) turned about the vertical to the heading of a start.

    A robot whose base is no free joint keeps its heading.
    """
    if model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        return states.copy()
    place, pose = slice(0, 3), slice(3, 7)
    speed = slice(model.nq, model.nq + 3)  # in the world's frame

    def heading(state: Array) -> float:
        return float(Rotation.from_quat(state[pose], scalar_first=True).as_euler("ZYX")[0])

    turn = Rotation.from_euler("Z", heading(start) - heading(states[0]))
    turned = states.copy()
    turned[:, place] = turn.apply(states[:, place] - states[0, place]) + states[0, place]
    poses = turn * Rotation.from_quat(states[:, pose], scalar_first=True)
    turned[:, pose] = poses.as_quat(scalar_first=True)
    turned[:, speed] = turn.apply(states[:, speed])
    return turned


def _end_cost(work: Workspace, solution: OptimizationResult) -> float:
    """Returns the mean cost of a step at the end of the scored horizon; inf after a fall."""
    here, horizon = solution.situation.of(work.task), work.task.horizon
    motion = solution.distribution.mean.first(horizon)
    if here.fallen(motion.states).any():
        return float("inf")
    return float(here.cost.values(motion)[-max(1, round(_END * horizon)) :].mean())


def _samples(work: Workspace, solution: OptimizationResult, k: int, i: int) -> Targets:
    """Draws samples of a q(ζ) that is replaced, from which the policy goes on learning."""
    settings, rng = work.settings.fit, generator(work.seed, Stream.DATASET, k, i)
    (q,), observation = work.taught([solution]), work.task.observation
    return draw_targets([q], observation, settings.samples_per_step, rng, settings.late)
