# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Mirror descent guided policy search (Montgomery and Levine, NIPS 2016), with or without a model.

It alternates, for each situation, between a step of its linear-Gaussian policy q(u|x), which starts
from rollouts, and the supervised fit that all methods share:

    q ← argmin E_q[c]  subject to  KL(q ‖ π_θ) ≤ ε        `bounded_step`
    θ ← argmax L(q, θ)                                    `core.policy_fit`

π_θ is linearised around the rollouts, averaged over them. With an exact fit both steps together
are mirror descent on the policy's expected cost, the "standard average cost criterion" of section
8. The other objective is the maximum likelihood of Algorithm 1, whose q-step stays near the q
before, the way of Levine and Abbeel (NIPS 2014):

    q ← argmin α_k E_q[c] + KL(q ‖ π_θ)  subject to  KL(q ‖ q before) ≤ ε.

The linear dynamics around the mean of the rollouts are the simulator's derivatives, or fitted to
the rollouts (`fitted_dynamics`). In the latter case there is no DDP, and only rollouts touch
the simulator: line 1 begins with the task's first motion and noise, and lowers E_q[c] near the q
before.

The rollouts are those of what q must stay near: of the policy, or of the q before. The bound counts
per control step, as in the authors' code, and where the cost is the objective, it grows and shrinks
as a step's promise was kept. Promises are of the cost of q's mean; with that of its noise, as in
the authors' code, most swimmers ended better, but one much worse (past_the_paper.md). A situation
whose step fails keeps its q.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vgps_ros.core.ddp.solve import Status
from vgps_ros.core.dynamics import ControlLaw
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.marginals import (
    Spread,
    sample_deviations,
    sample_rollout_noise,
    state_covariances,
)
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_cost import PolicyCost, ScaledCost
from vgps_ros.core.policy_network import LEAST_NOISE
from vgps_ros.core.records import (
    Array,
    CostExpansion,
    LinearDynamics,
    Trajectory,
    TrajectoryDistribution,
)
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.comparators.bounded_step import BoundedStep, LinearPolicy, bounded_step
from vgps_ros.search.comparators.fitted_dynamics import (
    Mixture,
    fitted_dynamics,
    mean_trajectory,
    transitions,
)
from vgps_ros.search.rollouts import Executions, Rollouts, roll_out
from vgps_ros.search.situations import Situation, situations
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.search.workspace import Update, Workspace
from vgps_ros.tasks import Task

_LEAST_GROWTH, _MOST_GROWTH = 0.2, 2.0  # of ε from one step to the next
_RANGE = (0.05, 10.0)  # of ε, in multiples of kl_bound
_COMPONENTS = 10  # Gaussians of the fitted dynamics' prior, at most
_REMEMBERED = 3  # iterations whose rollouts the prior is fitted to
_SHORTENINGS = 5  # of a step whose cost rises even where its own model leads


@dataclass(frozen=True)
class Progress:
    """What one situation remembers.

    Attributes:
        bound: ε of its next step, per control step [nat].
        observed: cost of the motion that the latest step started from; NaN before the first one.
        recent: the latest rollouts, for the prior of fitted dynamics.
    """

    bound: float
    observed: float = float("nan")
    recent: tuple[Rollouts, ...] = ()


@dataclass(frozen=True)
class MdgpsUpdate(Update):
    """The result of one iteration, with the progress of each situation."""

    progress: tuple[Progress, ...]


@dataclass(frozen=True)
class _LinearModel:
    """What is known of the dynamics around rollouts."""

    mean: Trajectory  # x̄, ū, the mean of the rollouts
    deviations: Array  # δx of states over which π_θ is averaged, shape (N, T, n_dx)
    linear: LinearDynamics  # f_x, f_u
    spread: Spread  # of x_1 and of the dynamics' noise


def begin(work: Workspace) -> tuple[OptimizationResult, ...]:
    """Solves line 1: by DDP, or without a model by bounded steps for the cost alone."""
    settings, task = work.settings.mirror, work.task
    if settings.dynamics == "model":
        return work.solve_cost_alone()
    found = []
    for i, (situation, given) in enumerate(situations(task, work.settings, work.seed)):
        here = situation.of(task)
        motion = given or _first_motion(work, here, i)
        solution, progress = _explore(work, here, situation, motion, i)
        for n in range(1, settings.first_steps + 1):
            solution, progress = _advance(work, here, solution, progress, None, (0, i, n))
        found.append(solution)
    return tuple(found)


def mdgps(work: Workspace, last: MdgpsUpdate | None, k: int) -> MdgpsUpdate:
    """Does iteration k."""
    settings = work.settings.mirror
    if last is None:
        first = work.initial_solutions
        none = tuple(Progress(settings.kl_bound) for _ in first)
        return MdgpsUpdate(work.supervised_policy(), first, none)
    found = [
        _advance(work, here, solution, progress, last.policy, (k, i))
        for i, (here, solution, progress) in enumerate(
            zip(work.tasks, last.solutions, last.progress, strict=True)
        )
    ]
    solutions, progress = zip(*found, strict=True)
    # With a model there is one rollout without noise, so that the fit draws its own.
    drawn = None if settings.dynamics == "model" else [each.recent[-1] for each in progress]
    return MdgpsUpdate(work.fit(last.policy, solutions, k, drawn=drawn), solutions, progress)


def _first_motion(work: Workspace, here: Task, i: int) -> Trajectory:
    rng = generator(work.seed, Stream.INITIAL_CONTROLS, i)
    first = here.begin(here, here.initial_state, here.planned_horizon, rng)
    work.simulator_steps += first.simulator_steps
    return first.trajectory


def _explore(
    work: Workspace, here: Task, situation: Situation, motion: Trajectory, i: int
) -> tuple[OptimizationResult, Progress]:
    """Returns q(ζ) around rollouts of a motion's controls with noise."""
    settings, (steps, n_u) = work.settings.mirror, motion.controls.shape
    std = np.broadcast_to(settings.exploration, n_u)
    law = LinearPolicy(
        np.zeros((steps, n_u)),
        np.zeros((steps, n_u, here.dims["n_dx"])),
        np.tile(np.diag(std**2), (steps, 1, 1)),
    )
    rng, count = generator(work.seed, Stream.GUIDING_ROLLOUTS, i), work.settings.policy_rollouts
    controls = motion.controls[:, None] + std * rng.standard_normal((steps, count, n_u))
    rollouts = _drawn(work, _whole_horizon(here), count, partial(_open_loop, controls), rng)
    model = _linear_model(work, here, (rollouts,), (0, i, 0))
    sigma = state_covariances(model.linear, law.gains, law.covariances, model.spread)
    step = BoundedStep(law, np.zeros(sigma.shape[:2]), sigma, 0.0, 0.0)
    return _solution(here, situation, model, step), Progress(settings.kl_bound)


def _advance(
    work: Workspace,
    here: Task,
    before: OptimizationResult,
    progress: Progress,
    policy: GaussianPolicy | None,
    place: tuple[int, ...],
) -> tuple[OptimizationResult, Progress]:
    """Returns the next q(ζ) of a situation; the one before where the step fails."""
    settings, q = work.settings.mirror, before.distribution
    rollouts = _roll_out(work, here, policy, q, place)
    recent = (*progress.recent, rollouts)[-_REMEMBERED:]
    lowers = policy is None or settings.objective == "average"  # a step's objective is the cost
    bound = progress.bound
    try:
        model = _linear_model(work, here, recent, place, q)
        near, minimised, entropy = _problem(work, here, model, policy, q, place[0])
        cost = here.trajectory_cost(model.mean)
        if lowers:
            bound *= _growth(progress.observed, before.modified_cost, cost)
            bound = float(np.clip(bound, *(settings.kl_bound * np.array(_RANGE))))
        start = here.dynamics.space.subtract(here.initial_state, model.mean.states[0])
        for n in range(_SHORTENINGS):
            shortened = bound * _LEAST_GROWTH**n * model.mean.horizon
            step = bounded_step(
                model.linear, minimised, near, start, model.spread, shortened, entropy
            )
            solution = _solution(here, before.situation, model, step)
            if not lowers or solution.modified_cost <= cost:
                return solution, Progress(bound, cost, recent)
        failure = "even its own model says that the cost rises."
    except DivergenceError as error:
        failure = str(error)
    work.warn(f"Solution {place[1]} of iteration {place[0]} stays as it was: {failure}")
    return before, replace(progress, bound=bound, recent=recent)


def _growth(before: float, expected: float, now: float) -> float:
    """Returns the factor on ε by how the latest step kept its promise (section 4.2 of the paper).

    If the step's error grows with the square of ε, the best ε is that with half the promise kept.
    """
    promise, error = before - expected, now - expected
    if not promise > 0.0:
        return 1.0
    return float(np.clip(promise / (2.0 * max(error, 1e-9)), _LEAST_GROWTH, _MOST_GROWTH))


def _roll_out(
    work: Workspace,
    here: Task,
    policy: GaussianPolicy | None,
    q: TrajectoryDistribution,
    place: tuple[int, ...],
) -> Rollouts:
    """Draws rollouts of what the step stays near, the policy or q, over the planned horizon.

    With a model there is one, without noise, along which the dynamics are differentiated.
    """
    settings, task, space = work.settings, _whole_horizon(here), here.dynamics.space
    rng, count = generator(work.seed, Stream.POLICY_ROLLOUTS, *place), settings.policy_rollouts
    factor = 1.0
    if settings.mirror.dynamics == "model":
        count, factor = 1, 0.0
        task = replace(task, initial_std=np.zeros_like(task.initial_std))
    if policy and settings.mirror.objective == "average":
        driven = replace(policy, noise_std=np.maximum(factor * policy.noise_std, LEAST_NOISE))
        executed = Executions(work.seed).of(task, driven, count, *place)
        work.simulator_steps += executed.steps
        return executed.scored().sound()
    noise = factor * sample_rollout_noise(q, count, rng)

    def law(t: int, x: Array) -> Array:
        away = space.subtract(x, q.mean.states[t])
        return np.asarray(q.mean.controls[t] + away @ q.gains[t].T + noise[:, t])

    return _drawn(work, task, count, law, rng)


def _open_loop(controls: Array, t: int, _: Array) -> Array:
    return np.asarray(controls[t])


def _drawn(
    work: Workspace, task: Task, count: int, law: ControlLaw, rng: np.random.Generator
) -> Rollouts:
    """Draws rollouts of a law, which are counted."""
    rollouts, steps = roll_out(task, count, rng, law)
    work.simulator_steps += steps
    return rollouts.sound()


def _whole_horizon(here: Task) -> Task:
    return replace(here, horizon=here.planned_horizon, lookahead=0)


def _linear_model(
    work: Workspace,
    here: Task,
    recent: tuple[Rollouts, ...],
    place: tuple[int, ...],
    q: TrajectoryDistribution | None = None,
) -> _LinearModel:
    """Returns the linear dynamics around the latest rollouts."""
    space, now = here.dynamics.space, recent[-1]
    rng = generator(work.seed, Stream.DYNAMICS_DERIVATIVES, *place)
    if len(now.states) < (1 if q and work.settings.mirror.dynamics == "model" else 2):
        raise DivergenceError(
            "Too few rollouts are left, since most diverged: lower mirror.exploration or "
            "mirror.kl_bound."
        )
    known = mean_trajectory(space, now.states, now.controls[:, :-1])
    following = known.states[-1:]  # the state after the last control has no cost, and no part here
    mean = Trajectory(np.concatenate([known.states, following]), now.controls.mean(axis=0))
    alpha = 1.0  # of the limits on the marginals
    spread = here.optimizer.marginals.spread(
        here.initial_std, here.std_limit, here.velocities, alpha
    )
    if work.settings.mirror.dynamics == "model":
        linear, steps = here.dynamics.linearize(mean)
        work.simulator_steps += steps
        assert q is not None  # DDP makes the first one
        deviations = sample_deviations(q, here.optimizer.policy_samples, rng)
    else:
        origin = here.initial_state
        points = [transitions(space, origin, r.states, r.controls[:, :-1]) for r in recent]
        pool = np.concatenate([each.reshape(-1, each.shape[-1]) for each in points])
        prior = Mixture.fitted(pool, _COMPONENTS, rng)
        fitted, std = fitted_dynamics(space, now.states, now.controls[:, :-1], prior, origin)
        linear = LinearDynamics(*(np.concatenate([f, f[-1:]]) for f in vars(fitted).values()))
        noise = np.hypot(spread.dynamics_std, np.concatenate([std, std[-1:]]))
        spread = replace(spread, dynamics_std=noise)
        deviations = space.subtract(now.states, mean.states[:-1])
    return _LinearModel(mean, deviations, linear, spread)


def _problem(
    work: Workspace,
    here: Task,
    model: _LinearModel,
    policy: GaussianPolicy | None,
    q: TrajectoryDistribution,
    k: int,
) -> tuple[LinearPolicy, CostExpansion, float]:
    """Returns what a step stays near, the cost that it minimises, and the weight of the entropy."""
    settings, mean, space = work.settings.mirror, model.mean, here.dynamics.space
    moved = space.subtract(mean.states[:-1], q.mean.states[:-1])
    gains = q.gains @ np.linalg.inv(space.turns(moved))  # in the frames of the rollouts' mean

    def policy_cost(policy: GaussianPolicy, alpha: float) -> CostExpansion:
        """Returns α c − log π_θ, averaged over the rollouts."""
        scaled = ScaledCost(here.cost, alpha)
        return PolicyCost(scaled, policy, here.observation, model.deviations, gains).expand(mean)

    if policy and settings.objective == "average":
        return LinearPolicy.of(policy_cost(policy, 0.0)), here.cost.expand(mean), 0.0
    ahead = q.mean.controls - mean.controls + np.einsum("tux,tx->tu", q.gains, moved)
    near = LinearPolicy(ahead, gains, q.control_covariances)
    if policy:
        return near, policy_cost(policy, work.settings.alpha(k)), 1.0
    return near, here.cost.expand(mean), 0.0


def _solution(
    here: Task, situation: Situation, model: _LinearModel, step: BoundedStep
) -> OptimizationResult:
    """Returns q(ζ) of a step, centred on the motion that the linear model expects of it.

    What counted around the rollouts' mean is carried to the frames of that motion.
    """
    mean, policy, space = model.mean, step.policy, here.dynamics.space
    states = space.add(mean.states, step.means)
    states[0] = here.initial_state
    feedback = np.einsum("tux,tx->tu", policy.gains, step.means[:-1])
    turns = space.turns(step.means)
    back = np.linalg.inv(turns[:-1])
    q = TrajectoryDistribution(
        mean=Trajectory(states, mean.controls + policy.feedforward + feedback),
        gains=policy.gains @ back,
        control_covariances=policy.covariances,
        linear_dynamics=LinearDynamics(
            turns[1:] @ model.linear.f_x @ back, turns[1:] @ model.linear.f_u
        ),
        state_covariances=turns @ step.state_covariances @ np.swapaxes(turns, 1, 2),
        context=situation.context,
    )
    return OptimizationResult(
        situation=situation,
        distribution=q,
        cost=here.trajectory_cost(q.mean.first(here.horizon)),
        modified_cost=here.trajectory_cost(q.mean),
        status=Status.ITERATION_LIMIT,
        settings=here.optimizer,
        iterations=(),
        simulator_steps=0,
    )
