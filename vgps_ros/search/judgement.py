# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Judges how well a policy obeys commands, and for how long it stays up.

A command is achieved by the reading whose target in the cost follows it. Its error is that of the
reading, in the command's unit:

    e = (r − r*) / A,    r* = base + A z + … (`core.cost`).

Errors count from `SETTLING` after the start and after each change of a command, and until a fall. A
rollout obeys if it is up, and if over its last `LATE` seconds the mean error of no command is more
than a tenth of what is commanded, or than `allowed_at_rest`, whichever is larger. So a robot that
slides on its back does not obey, even where the task does not call that a fall.

All draws are of a stream that no training uses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.core.slow_steps import progress_lines
from vgps_ros.robot.executed_control import Driver, RememberingPolicy
from vgps_ros.robot.signals import Signals
from vgps_ros.search.evaluation import perturbed_starts
from vgps_ros.search.settings import search_settings
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks import Task

TIMES = (20.0, 60.0)  # at which a long rollout is judged, beside its end [s]
CHANGE = 3.0  # time after which commands are drawn anew [s]
SETTLING = 1.0  # time after a change of a command in which errors do not count [s]
LATE = 2.0  # time at the end of a rollout in which it must obey [s]
TOLERANCE = 0.1  # largest mean error of a rollout that obeys, as a share of what is commanded
AT_REST = 0.1  # and where less is commanded, of speeds [m/s, rad/s]
_OF_RANGE = 0.125  # and where that is less, of all commands, as a share of their range
STEPS = 100_000_000  # of all rollouts of a judgement together
_GOLDEN = 0.6180339887498949  # its multiples fill a turn evenly
_AT_ONCE = 400_000  # steps of the rollouts whose states are in memory at once

# The places of draws in the stream of judgements.
GRID, TRIALS, PUSHES, SENSORS, SELECTION, CALIBRATION = range(6)


@dataclass(frozen=True)
class CommandReadings:
    """Names the readings that achieve the commands of a task.

    Attributes:
        commands: places of the n_a commands that a reading follows, among the n_c.
        names: names of these readings.
        rows: their places among the cost's readings.
        cost: the cost.
    """

    commands: tuple[int, ...]
    names: tuple[str, ...]
    rows: list[int]
    cost: FeatureCost

    @classmethod
    def of(cls, task: Task) -> "CommandReadings":
        """Returns them; of several readings that follow a command, the one of the largest weight.

        Raises:
            InvalidInputError: the cost has features of its own, in Python.
        """
        cost, following = task.cost, task.cost.following
        if following is None:
            return cls((), (), [], cost)
        if not isinstance(cost.features, Readings):
            raise InvalidInputError(
                f"The cost of {task.name} is not one of readings, so that what achieves a command "
                "is unknown; write its cost as terms of sensors."
            )
        weights = cost.weights.mean(axis=0) if cost.weights.ndim > 1 else cost.weights
        strength = weights[:, None] * following.linear[:, : len(task.signals.commands)] ** 2
        commands = tuple(np.flatnonzero(strength.any(axis=0)).tolist())
        rows = [int(strength[:, i].argmax()) for i in commands]
        names = tuple(cost.features.names[row] for row in rows)
        return cls(commands, names, rows, cost)

    def errors(self, states: Array, controls: Array, context: Array) -> Array:
        """Returns e of each step, shape (N, T, n_a).

        Args:
            states: shape (N, T+1, n_x); NaN where a rollout has diverged, as its errors are then.
            controls: shape (N, T, n_u).
            context: z, shape (N, T, n_z).
        """
        following = self.cost.following
        if not self.commands or following is None:
            return np.zeros((*controls.shape[:2], 0))
        at, steps = self.rows, controls.shape[1]
        following = replace(following, linear=following.linear[at], lifted=following.lifted[at])
        base = replace(self.cost, following=None).starting_at(0, steps).targets
        differences = (self.cost.features(states[:, :-1], controls) - base)[..., at]
        scale = following.linear[np.arange(len(at)), self.commands]
        return np.asarray((differences - following.added(context)) / scale)


@dataclass(frozen=True)
class Behaviour:
    """Records what N rollouts do.

    Attributes:
        up: whether each is up at each of K times, shape (N, K).
        obeys: whether it obeys then, shape (N, K).
        errors: mean of e of each, over the steps that count, shape (N, n_a); 0 where none do.
        squares: mean of e², shape (N, n_a).
        counts: how many steps count, shape (N,).
    """

    up: NDArray[np.bool_]
    obeys: NDArray[np.bool_]
    errors: Array
    squares: Array
    counts: NDArray[np.int64]

    def of(self, rollouts: slice | NDArray[np.int_]) -> "Behaviour":
        """Returns what some of the rollouts do."""
        return Behaviour(*(values[rollouts] for values in vars(self).values()))

    @classmethod
    def joined(cls, parts: Sequence["Behaviour"]) -> "Behaviour":
        """Returns what the rollouts of all parts do, one part after another."""
        fields = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(*(np.concatenate(values) for values in fields))


@dataclass(frozen=True)
class Trial:
    """The rollouts of a judgement, before they are run.

    Attributes:
        starts: x_1 of each, shape (N, n_x).
        commands: shape (N, T, n_c).
        noise: of the controls, shape (N, T, n_u), [N·m]; zeros for the policy without noise.
        lag: steps by which the policy reads the state too late.
        misread: what is added to each reading of the state, shape (N, T, r); None: nothing.
        phases: the clock's φ at each start, shape (N,), in turns; None: 0.
    """

    starts: Array
    commands: Array
    noise: Array
    lag: int = 0
    misread: Array | None = None
    phases: Array | None = None

    def of(self, rows: Sequence[int]) -> "Trial":
        """Returns some of them."""
        arrays = {name: a[rows] for name, a in vars(self).items() if isinstance(a, np.ndarray)}
        return Trial(**(vars(self) | arrays))


def behaviour(task: Task, driver: Driver, rollouts: Trial, times: Sequence[float]) -> Behaviour:
    """Runs rollouts, and says what they do.

    Args:
        task: dynamics, cost and what falling is.
        driver: the policy; it may read another model's states, of which the names count alone.
        rollouts: starts, commands and noise.
        times: times at which the rollouts are judged [s].
    """
    states, controls, context = execute_trial(task, driver, rollouts)
    standing = np.isfinite(states).all(axis=2) & ~task.fallen(states)
    standing = np.logical_and.accumulate(standing, axis=1)
    achieved = CommandReadings.of(task)
    errors = achieved.errors(states, controls, context)
    period = task.dynamics.time_step
    is_settled = settled_steps(rollouts.commands, round(SETTLING / period))
    counted = is_settled & standing[:, :-1]
    errors = np.where(counted[..., None], errors, 0.0)
    counts = counted.sum(axis=1)
    told = np.abs(rollouts.commands[..., list(achieved.commands)])
    allowed = np.maximum(TOLERANCE * told, allowed_at_rest(task.signals)[list(achieved.commands)])
    up, obeys = [], []
    for time in times:
        end = round(time / period)
        late = slice(max(0, end - round(LATE / period)), end)
        mean = _mean(errors[:, late], counted[:, late].sum(axis=1))
        up.append(standing[:, end])
        obeys.append(standing[:, end] & (np.abs(mean) <= allowed[:, end - 1]).all(axis=1))
    return Behaviour(
        np.stack(up, axis=1),
        np.stack(obeys, axis=1),
        _mean(errors, counts),
        _mean(errors**2, counts),
        counts,
    )


def allowed_at_rest(signals: Signals) -> Array:
    """Returns the mean error of each command that obeys however little is commanded, (n_c,)."""
    speeds = ("m/s", "rad/s")
    return np.array(
        [
            min(AT_REST if c.unit in speeds else np.inf, _OF_RANGE * (c.highest - c.lowest))
            for c in signals.commands
        ]
    )


def late_error(task: Task, states: Array, controls: Array, context: Array) -> float:
    """Returns the largest mean error over the last `LATE` seconds, as a share of the range.

    It is that of N rollouts of T steps, with the arguments of `Achieved.errors`; 0 where no reading
    achieves a command.
    """
    achieved, steps = CommandReadings.of(task), round(LATE / task.dynamics.time_step)
    errors = achieved.errors(states, controls, context)[:, -steps:].mean(axis=1)
    commands = [task.signals.commands[i] for i in achieved.commands]
    ranges = np.array([command.highest - command.lowest for command in commands])
    return float(np.max(np.abs(errors) / ranges, initial=0.0))


def judge_controller(
    task: Task,
    driver: Driver,
    *,
    seconds: float,
    rollouts: int,
    perturbation: float,
    seed: int,
    stochastic: bool,
) -> dict[str, Any]:
    """Tries a policy at each command of a grid, and while commands change.

    Args:
        task: a task with commands.
        driver: the policy, with what it reads.
        seconds: length of each rollout [s].
        rollouts: their number at each command.
        perturbation: as for `measure_driving`.
        seed: of all random draws.
        stochastic: whether the policy's noise is drawn.

    Returns:
        Figures at each command and while commands change, each as `figures` gives them, and those
        of all rollouts at the grid's commands together.

    Raises:
        InvalidInputError: the rollouts are too short or too many.
    """
    check_lengths(task, seconds)
    signals, steps = task.signals, round(seconds / task.dynamics.time_step)
    grid = command_grid(signals)
    total = (len(grid) + 1) * rollouts
    if total * steps > STEPS:
        raise InvalidInputError(
            f"{rollouts} rollouts of {steps} steps at each of {len(grid) + 1} commands are too "
            f"many: use at most {STEPS} steps in all."
        )
    rng = generator(seed, Stream.JUDGEMENT, GRID)
    starts = perturbed_starts(task, perturbation, total, rng)
    scale = driver.policy.noise_std if stochastic else np.zeros_like(driver.policy.noise_std)
    phases, times = first_phases(total), judged_times(seconds)
    size, parts = max(1, _AT_ONCE // steps), []
    report = progress_lines(f"Tries commands on {task.name}")
    for first in range(0, total, size):
        own = range(first, min(first + size, total))
        commands = [
            np.tile(grid[i // rollouts], (steps, 1))
            if i < len(grid) * rollouts
            else changing_commands(task, steps, rng)
            for i in own
        ]
        noise = drawn_noise(scale, (len(own), steps), rng)
        given = Trial(starts[own], np.array(commands), noise, phases=phases[own])
        parts.append(behaviour(task, driver, given, times))
        report(own.stop / total)
    found = Behaviour.joined(parts)
    each = [found.of(slice(i * rollouts, (i + 1) * rollouts)) for i in range(len(grid) + 1)]
    achieved = CommandReadings.of(task)
    names = [command.name for command in signals.commands]
    return {
        "times": list(times),
        "units": {command.name: command.unit for command in signals.commands},
        "achieved_by": {
            names[i]: name for i, name in zip(achieved.commands, achieved.names, strict=True)
        },
        "commands": [
            {"command": dict(zip(names, row.tolist(), strict=True)), **figures(task, own)}
            for row, own in zip(grid, each, strict=False)
        ],
        "all_commands": figures(task, found.of(slice(0, len(grid) * rollouts))),
        "changing": figures(task, each[-1]),
    }


def command_grid(signals: Signals) -> Array:
    """Returns commands to try, shape (G, n_c).

    They are: all at rest; each command alone at its lowest and highest value and half way there;
    each pair of commands half way there.
    """
    rest, at = signals.rest, np.arange(len(signals.rest))
    half = [(0.5 * (c.lowest + c.rest), 0.5 * (c.rest + c.highest)) for c in signals.commands]
    rows = [rest]
    for i, command in enumerate(signals.commands):
        rows += [np.where(at == i, v, rest) for v in (command.lowest, *half[i], command.highest)]
    for i, j in combinations(range(len(rest)), 2):
        pairs = product(half[i], half[j])
        rows += [np.where(at == i, v, np.where(at == j, w, rest)) for v, w in pairs]
    return np.array(list(dict.fromkeys(tuple(row.tolist()) for row in rows)))


def changing_commands(task: Task, steps: int, rng: np.random.Generator) -> Array:
    """Draws commands, anew after each `CHANGE` seconds, shape (steps, n_c)."""
    hold = max(1, round(CHANGE / task.dynamics.time_step))
    settings = search_settings(task).commands
    drawn = [task.signals.draw(rng, settings) for _ in range(-(-steps // hold))]
    return np.repeat(np.array(drawn), hold, axis=0)[:steps]


def drawn_noise(scale: Array, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Draws noise of so much a number, shape (*shape, len(scale)); nothing is drawn for zeros."""
    if not scale.any():
        return np.zeros((*shape, len(scale)))
    return np.asarray(scale * rng.standard_normal((*shape, len(scale))))


def first_phases(rollouts: int) -> Array:
    """Returns the clock's phase φ at each start, shape (rollouts,): spread evenly over a turn."""
    return np.asarray((_GOLDEN * np.arange(rollouts)) % 1.0)


def judged_times(seconds: float) -> tuple[float, ...]:
    """Returns the times at which rollouts of so many seconds are judged [s]."""
    return (*(time for time in TIMES if time < seconds - 1e-9), seconds)


def check_lengths(task: Task, seconds: float) -> None:
    """Checks that rollouts are long enough to tell whether commands are obeyed.

    Raises:
        InvalidInputError: they are shorter than `SETTLING` and `LATE` together.
    """
    if task.signals.commands and seconds < SETTLING + LATE:
        raise InvalidInputError(
            f"seconds is {seconds:g}, but the errors of commands count after {SETTLING:g} s, and "
            f"are judged over {LATE:g} s; use at least {SETTLING + LATE:g}."
        )


def interval(share: float, count: int) -> tuple[float, float]:
    """Returns Wilson's interval of 95 % of a share of so many rollouts."""
    from scipy.stats import binomtest  # which is slow to load

    low, high = binomtest(round(share * count), count).proportion_ci(method="wilson")
    return float(low), float(high)


def figures(task: Task, found: Behaviour) -> dict[str, Any]:
    """Returns shares at each time with their intervals, and errors of each command.

    The errors are over all steps that count: a root of the mean square `rms`, and the `mean`, each
    None where no step counts.
    """
    count = len(found.up)
    result: dict[str, Any] = {}
    for name, values in (("survival", found.up), ("obeys", found.obeys)):
        shares = values.mean(axis=0).tolist()
        result[name] = shares
        result[f"{name}_interval"] = [list(interval(share, count)) for share in shares]
    names = [task.signals.commands[i].name for i in CommandReadings.of(task).commands]
    if not found.counts.any():
        return result | {key: dict.fromkeys(names) for key in ("rms", "mean")}
    pooled = (
        np.average(values, axis=0, weights=found.counts) for values in (found.squares, found.errors)
    )
    squares, means = (values.tolist() for values in pooled)
    result["rms"] = {name: value**0.5 for name, value in zip(names, squares, strict=True)}
    result["mean"] = dict(zip(names, means, strict=True))
    return result


def _contexts(signals: Signals, rollouts: Trial) -> Array:
    """Returns z of each step, shape (N, T, n_z)."""
    count, steps = rollouts.commands.shape[:2]
    firsts = np.zeros(count) if rollouts.phases is None else rollouts.phases
    phases = np.array([signals.phases(steps, first) for first in firsts])
    return signals.context(rollouts.commands, phases)


def execute_trial(task: Task, driver: Driver, rollouts: Trial) -> tuple[Array, Array, Array]:
    """Runs rollouts; returns states (N, T+1, n_x), controls (N, T, n_u) and z (N, T, n_z)."""
    policy, unrest, context = driver.policy, task.unrest, _contexts(task.signals, rollouts)
    observation = driver.observation.within(_contexts(task.signals.turning, rollouts))
    names, readings = driver.observation.readings.names, task.observation.readings
    if readings.names != names:
        readings = Readings(task.dynamics.simulations, names, measured=True)
    observation = replace(observation, readings=readings)
    noise, lag, misread = rollouts.noise, rollouts.lag, rollouts.misread
    if isinstance(policy, RememberingPolicy):
        observation, policy = replace(observation, past=policy.past), policy.policy
    if isinstance(policy, GaussianPolicy):
        states, controls = task.dynamics.execute(
            policy,
            observation,
            rollouts.starts,
            noise,
            lag=lag,
            sensor_noise=misread,
            unrest=unrest,
            calm=context,
        )
        return states, controls, context
    told, past, policy_law = observation.values_told(), [], driver.new_law()
    calm, awake = observation.within(context).values_told(), np.zeros(len(noise), dtype=np.int64)

    def law(t: int, x: Array) -> Array:
        if unrest:
            awake[unrest.restless(x)] = t + unrest.steps
        past.append(readings(x))
        read = past[max(0, t - lag)]
        read = read if misread is None else read + misread[:, t]
        if observation.told:
            now = np.where((t < awake)[:, None], told[:, t], calm[:, t])
            read = np.concatenate([read, now], axis=1)
        return policy_law(read, noise[:, t])

    states, controls, _ = task.dynamics.rollouts(rollouts.starts, law, noise.shape[1])
    return states, controls, context


def settled_steps(commands: Array, steps: int) -> NDArray[np.bool_]:
    """Returns whether the commands (N, T, n_c) have not changed for so many steps, shape (N, T)."""
    at = np.arange(commands.shape[1])
    changes = np.zeros(commands.shape[:2], dtype=np.int64)
    changes[:, 1:] = np.where((commands[:, 1:] != commands[:, :-1]).any(axis=2), at[1:], 0)
    return np.asarray(at - np.maximum.accumulate(changes, axis=1) >= steps)


def _mean(values: Array, counts: NDArray[np.int64]) -> Array:
    """Returns the means over the counted steps of values (N, T, m) that are 0 elsewhere, (N, m)."""
    return np.asarray(values.sum(axis=1) / np.maximum(counts, 1)[:, None])
