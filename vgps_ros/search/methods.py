# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The policy search methods of section 6, by name, and the loop that runs any of them.

Every method gets the same initial DDP solutions and as many policy updates, the first of which fits
a policy to these solutions, and is evaluated alike.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from vgps_ros.core.checks import one_of
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.settings import check_settings, differences
from vgps_ros.search.checkpoints import Checkpoints, Run
from vgps_ros.search.comparators.cost_weighted import cost_weighted
from vgps_ros.search.comparators.dagger import Imitation, imitate
from vgps_ros.search.comparators.gps import GuidedUpdate, guided_search
from vgps_ros.search.comparators.mdgps import MdgpsUpdate, begin, mdgps
from vgps_ros.search.evaluation import Evaluation, evaluate
from vgps_ros.search.iteration import SearchIteration, SearchState
from vgps_ros.search.metrics import lost_bound, lost_coverage, measure
from vgps_ros.search.selection import finish, is_evaluated, try_policy
from vgps_ros.search.settings import SearchSettings, architecture, with_preset
from vgps_ros.search.situations import check_situations
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.search.vgps import VgpsUpdate, vgps
from vgps_ros.search.workspace import OptimizeAll, Update, Workspace
from vgps_ros.tasks import Task


@dataclass(frozen=True)
class Method:
    """A policy search method.

    Attributes:
        iterate: does iteration k: maps the workspace, what iteration k − 1 ended with (None at
            k = 1) and k to what this one ends with.
        update: the type of that.
        raises_bound: whether both of its steps maximise L(q, θ) over the marginals of q, so that a
            lower bound is trouble, and so are marginals that do not hold.
        begin: makes the first solutions.
    """

    iterate: Callable[[Workspace, Any, int], Update]
    update: type[Update]
    raises_bound: bool = False
    begin: Callable[[Workspace], tuple[OptimizationResult, ...]] = Workspace.solve_cost_alone


METHODS = {
    "vgps": Method(vgps, VgpsUpdate, raises_bound=True),
    "gps": Method(partial(guided_search, adapts=False), GuidedUpdate),
    "adaptive_gps": Method(partial(guided_search, adapts=True), GuidedUpdate),
    "dagger": Method(partial(imitate, weighted=False, adapts=False), Imitation),
    "weighted_dagger": Method(partial(imitate, weighted=True, adapts=False), Imitation),
    "adapted_weighted_dagger": Method(partial(imitate, weighted=True, adapts=True), Imitation),
    "cost_weighted": Method(cost_weighted, Update),
    "cost_weighted_1000": Method(partial(cost_weighted, samples=1000), Update),
    "mdgps": Method(mdgps, MdgpsUpdate, begin=begin),
}


def check_search(
    method: str,
    task: Task,
    settings: SearchSettings,
    seed: int,
    first_policy: GaussianPolicy | None = None,
) -> SearchSettings:
    """Checks what a search would refuse; returns its settings, with those of the preset.

    Raises:
        InvalidInputError: the method is unknown, a setting or the seed is out of range, the policy
            is too large, the first one has another network, or settings do not suit the task.
    """
    one_of("method", method, METHODS)
    check_settings(settings)
    settings = with_preset(settings, task)
    if seed < 0:
        raise InvalidInputError(f"seed is {seed}, but it must be at least 0.")
    if task.observation.past and method != "vgps":
        raise InvalidInputError(
            f"The policies of {task.name} read former steps, which {method} does not draw; leave "
            "out last_action and history of the task, or use vgps."
        )
    network = architecture(task, settings)  # which refuses one that is too large
    if first_policy:
        theirs, ours = differences(vars(first_policy.architecture), vars(network))
        if theirs:
            raise InvalidInputError(
                f"The policy to begin with has {theirs}, but this training has {ours}; train with "
                "the same network, or without it."
            )
    check_situations(task, settings, seed)
    return settings


_LITTLE = 0.5  # share of the rollouts; seeds that learn reach .7 to 1


def search(
    method: str,
    task: Task,
    settings: SearchSettings,
    seed: int,
    optimize_all: OptimizeAll,
    checkpoints: Checkpoints | None = None,
    first_policy: GaussianPolicy | None = None,
) -> Iterator[SearchIteration]:
    """Runs a method, yielding each iteration as it ends.

    Args:
        method: its name.
        task: the control problem.
        settings: of the search.
        seed: of all random draws, at least 0.
        optimize_all: solves the trajectory optimisations.
        checkpoints: where each iteration is kept as it ends, and where a run that was stopped goes
            on from: it yields the last iteration that was kept once more, then the next ones.
        first_policy: the policy that the first fit begins with; None: it is drawn at random.

    Raises:
        InvalidInputError: the method is unknown, a setting is out of range, the checkpoints are
            those of another run, or an optimizer has other settings than the run was begun with.
        DivergenceError: the first rollout of line 1 diverges.
        OSError: a checkpoint cannot be written.
    """
    settings = check_search(method, task, settings, seed, first_policy)
    chosen = METHODS[method]
    run = Run(method, task, settings, seed, first_policy)
    found = checkpoints.latest(run, chosen.update) if checkpoints else None
    known = found.initial_solutions if found else ()
    work = Workspace(task, settings, seed, optimize_all, known, chosen.begin, first_policy)

    def evaluated(update: Update, k: int) -> Evaluation:
        work.enter(update.solutions)
        rollouts = settings.evaluation_rollouts
        return evaluate(work.tasks, update.policy, rollouts, work.executions, k)

    if found:
        state, work.simulator_steps = found, found.simulator_steps
        if found.last:
            yield SearchIteration.of(found, evaluated(found.last, found.k))
    else:
        best = None
        if first_policy and is_evaluated(settings, settings.iterations):
            best = try_policy(task, settings, seed, first_policy, 0)
        state = SearchState(work.initial_solutions, work.simulator_steps, (), None, best)
        if checkpoints:
            checkpoints.save(run, state)
    for k in range(state.k + 1, settings.iterations + 1):
        began, optimized = time.perf_counter(), work.optimization_seconds
        update = chosen.iterate(work, state.last, k)
        q_step = work.optimization_seconds - optimized
        m_step = time.perf_counter() - began - q_step
        best, notice = state.best, ""
        if is_evaluated(settings, k):
            this = try_policy(task, settings, seed, update.policy, k)
            best = this if best is None or this.beats(best) else best
            notice = f"The policy of iteration {k} {this.summary(task, settings)}."
            if k == settings.iterations and best is not this:
                which = f"That of iteration {best.k}" if best.k else "The first policy"
                notice += f" {which} is kept, which {best.summary(task, settings)}."
            if k == settings.iterations:
                final = finish(task, settings, seed, best)
                update = replace(update, policy=final.policy)
                if final is not best:
                    notice += f" With calibrated commands it {final.summary(task, settings)}."
            if k == settings.iterations and best.success < _LITTLE:
                notice += " That is little: another --seed may do better, since seeds differ much."
        evaluation = evaluated(update, k)
        history = (*state.history, measure(work, state, update, evaluation, q_step, m_step))
        state = SearchState(work.initial_solutions, work.simulator_steps, history, update, best)
        if checkpoints:
            checkpoints.save(run, state)
        figures, alarms = history[-1], (*work.take_warnings(), *filter(None, [notice]))
        # With new situations the M-step also fits what L(q, θ) of the old ones does not know.
        if chosen.raises_bound and not settings.renew.share:
            alarms = (*alarms, *lost_bound(figures), *lost_coverage(figures))
        yield SearchIteration.of(state, evaluation, alarms)
