# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Keeps the best policy of a search, since survival moves from iteration to iteration.

In the second half of a search each policy is tried in the same rollouts: from starts around the
task's, without noise, every other one under commands that change, the others under one that holds,
and with one push each of those that new situations have. A training whose situations are renewed
ends with the policy that was up and obeyed its commands most often (see `judgement`); of several
that did so equally often, with the one of the least error.

In the end its commands are calibrated, unless it then succeeds clearly less often, or a little less
often with a larger error (see `calibration`).

The M-step knows only the states that it was shown, and one may ruin a policy elsewhere. So a step
after which far fewer rollouts succeed is taken only as far as that does not happen.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search.calibration import calibrate
from vgps_ros.search.judgement import (
    SELECTION,
    CommandReadings,
    Trial,
    changing_commands,
    first_phases,
)
from vgps_ros.search.renewal import drawn_push
from vgps_ros.search.robustness import behaviours
from vgps_ros.search.settings import SearchSettings
from vgps_ros.tasks import Task
from vgps_ros.tasks.disturbance import Disturbance
from vgps_ros.tasks.disturbed_task import UNDISTURBED

_LOST = 0.25  # share of the rollouts that no step may lose: four deviations of 40 at 80 %
_ALIKE = 0.05  # share of the rollouts that tells nothing: one deviation of 40
_SHORTER = (1.0, 0.5, 0.25)  # of a step, that are tried one after another


@dataclass(frozen=True)
class Performance:
    """Records how a policy did.

    Attributes:
        policy: the policy.
        k: the iteration that it is of.
        success: share of the rollouts that are up and obey at their end.
        loss: what tells policies of equal success apart: the mean of (e / range)² over the commands
            and the steps that count, inf where no step counts; of a task without commands the mean
            cost of a step.
    """

    policy: GaussianPolicy
    k: int
    success: float
    loss: float

    def beats(self, other: "Performance") -> bool:
        """Returns whether it is to be kept rather than an earlier one."""
        mine, theirs = (self.success, -self.loss), (other.success, -other.loss)
        return mine >= theirs

    def is_no_worse_than(self, other: "Performance") -> bool:
        """Returns whether it succeeds as often, or a little less often with no larger error."""
        is_alike = self.success >= other.success - _ALIKE and self.loss <= other.loss
        return self.success >= other.success or is_alike

    def summary(self, task: Task, settings: SearchSettings) -> str:
        """Returns a summary: a sentence without its subject."""
        if task.signals.commands:
            done = f"obeyed in {100 * self.success:.0f} %"
            pushed = " with pushes" if settings.renew.push else ""
            return f"{done} of {settings.keep.rollouts} rollouts{pushed}"
        of = f"of {settings.keep.rollouts} rollouts of {settings.keep.seconds:g} s"
        up = f"stayed up in {100 * self.success:.0f} % and " if task.fallen.lowest.size else ""
        return f"{up}cost {self.loss:.3g} in each step {of}"


def is_evaluated(settings: SearchSettings, k: int) -> bool:
    """Returns whether the policy of iteration k is tried."""
    return settings.renew.share > 0.0 and settings.keep.rollouts > 0 and 2 * k > settings.iterations


def sound_step(
    task: Task,
    settings: SearchSettings,
    seed: int,
    before: GaussianPolicy,
    fitted: GaussianPolicy,
    k: int,
) -> GaussianPolicy:
    """Returns the policy of iteration k's M-step, or of a shorter step where it ruins the policy.

    Args:
        task: the control problem.
        settings: settings of the search.
        seed: seed of the search.
        before: the policy from which the step starts.
        fitted: the policy with which it ends.
        k: the iteration.
    """
    if not is_evaluated(settings, k):
        return fitted
    least = try_policy(task, settings, seed, before, k).success - _LOST
    change = fitted.parameters - before.parameters
    for share in _SHORTER:
        policy = fitted
        if share < 1.0:
            policy = replace(fitted, parameters=before.parameters + share * change)
        if try_policy(task, settings, seed, policy, k).success >= least:
            return policy
    return before


def finish(task: Task, settings: SearchSettings, seed: int, best: Performance) -> Performance:
    """Returns the best policy with calibrated commands, if it succeeds about as often with them."""
    policy = calibrate(task, seed, best.policy)
    if policy is best.policy:
        return best
    found = try_policy(task, settings, seed, policy, best.k)
    return found if found.is_no_worse_than(best) else best


def try_policy(
    task: Task, settings: SearchSettings, seed: int, policy: GaussianPolicy, k: int
) -> Performance:
    """Tries the policy of iteration k; all are tried in the same rollouts."""
    return Performance(policy, k, *_success_and_loss(task, settings, seed, policy))


@lru_cache(maxsize=4)  # each policy is tried as the result of one step, and as the start of another
def _success_and_loss(
    task: Task, settings: SearchSettings, seed: int, policy: GaussianPolicy
) -> tuple[float, float]:
    trial, pushes = _rollouts(task, settings, seed)
    found = behaviours(task, Driver.of(task.observation, policy), pushes, trial)
    if not task.signals.commands:
        return float(found.up[:, -1].mean()), _mean_cost(task, policy, trial)
    achieved = [task.signals.commands[i] for i in CommandReadings.of(task).commands]
    error = 0.0
    if achieved and not found.counts.any():
        error = np.inf
    elif achieved:
        ranges = np.array([c.highest - c.lowest for c in achieved])
        error = np.average(found.squares / ranges**2, axis=0, weights=found.counts).mean()
    return float(found.obeys[:, -1].mean()), float(error)


@lru_cache(maxsize=1)
def _rollouts(task: Task, settings: SearchSettings, seed: int) -> tuple[Trial, list[Disturbance]]:
    """Returns the rollouts in which each policy is tried, and the push of each."""
    rng, space = generator(seed, Stream.JUDGEMENT, SELECTION), task.dynamics.space
    count, steps = settings.keep.rollouts, round(settings.keep.seconds / task.dynamics.time_step)
    starts = task.initial_std * rng.standard_normal((count, space.tangent_dim))
    commands = np.array([changing_commands(task, steps, rng) for _ in range(count)])
    commands[1::2] = commands[1::2, :1]
    trial = Trial(
        space.add(task.initial_state, starts),
        commands,
        np.zeros((count, steps, task.dynamics.control_dim)),
        phases=first_phases(count),
    )
    pushes = [UNDISTURBED] * count
    if settings.renew.push:
        before, shares = settings.keep.seconds / 2, rng.uniform(0.1, 1.0, count)
        pushes = [drawn_push(task, settings, share, before, rng) for share in shares]
    return trial, pushes


def _mean_cost(task: Task, policy: GaussianPolicy, trial: Trial) -> float:
    """Returns what a step of the undisturbed rollouts costs; inf where one diverges."""
    steps = trial.noise.shape[1]
    context = task.signals.context(np.empty((steps, 0)), task.signals.phases(steps, 0.0))
    observation = task.observation.within(context)
    states, controls = task.dynamics.execute(policy, observation, trial.starts, trial.noise)
    if not np.isfinite(states).all():
        return float("inf")
    cost = task.in_context(context).cost.starting_at(0, steps)
    return float(cost(states[:, :-1], controls, 0).mean())
