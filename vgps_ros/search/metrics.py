# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""An iteration of a policy search in numbers.

Each number is declared here once, and computed below. The entries of result.json, the message
LearningProgress (`scripts/write_progress_message.py` writes its definition), the table of an
experiment and the recording derive from the declaration.

Two things are watched. Each step of an iteration must raise the bound L(q, θ) of `core.bound`. With
q and θ as iteration k − 1 left them, at the α_k of iteration k,

    m_step_gain = L(q_{k−1}, θ_k) − L(q_{k−1}, θ_{k−1}),
    q_step_gain = L(q_k, θ_k) − L(q_{k−1}, θ_k)            [nat].

Neither is negative where both steps are exact, and neither mixes values of different α. The horizon
is the scored one, so where steps are planned beyond it, a q-step may give some of it up for them.
The gains are those over the marginals that the steps take. Where the task's std_limit cuts these
they are not those of q, and L over them is no bound: the bound itself is that of q without limits.

And both steps trust the marginals N(x̄_t, Σ_t) of q, which are linearised (section 4). Where the
linearisation holds, 95 % of the coordinates of rollouts of π_G, with its noise, lie within two of
its standard deviations: that is the coverage. More do where the limits of the controls cut the
noise, which marginals do not know of.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias

import numpy as np

from vgps_ros.core.bound import expected_cost, expected_divergence
from vgps_ros.core.errors import DivergenceError
from vgps_ros.core.gaussians import entropy
from vgps_ros.core.marginals import sample_deviations, sample_rollout_noise, state_covariances
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.storage.run_folder import policy_digest

if TYPE_CHECKING:  # these import torch, which a reader of metrics does without
    from vgps_ros.search.evaluation import Evaluation
    from vgps_ros.search.iteration import SearchState
    from vgps_ros.search.trajectory_optimization import OptimizationResult
    from vgps_ros.search.workspace import Update, Workspace
    from vgps_ros.tasks import Task


# E[c] counts no rollout at more than this many times max(initial DDP cost, 1): a mean over rollouts
# of which one diverged would be infinite, and without it too low. A walker that lies on the ground
# costs 4,000 times what walking costs (docs/evidence/figure1.csv), and is still told apart.
LARGEST_COST = 1e4


# Bound and coverage take time that teaches nothing, so of many situations they are those of a few.
_MOST_SITUATIONS = 2


class Metric(NamedTuple):
    """Declares a metric: its meaning and unit, and its name in a recording if it is drawn there."""

    description: str
    drawn: str = ""


@dataclass(frozen=True)
class IterationMetrics:
    """The metrics of iteration k, which counts from 1.

    Costs of solutions and of the policy without noise are means over the situations.
    """

    k: int
    alpha: Annotated[float, Metric("alpha_k, the cost's scale", "alpha")]
    initial_ddp_cost: Annotated[
        float, Metric("mean cost of the initial DDP solutions, of line 1", "initial_ddp_cost")
    ]
    ddp_cost: Annotated[float, Metric("mean cost of the current DDP solutions", "ddp_cost")]
    deterministic_cost: Annotated[
        float, Metric("mean cost of the policy without noise; inf: diverged", "deterministic_cost")
    ]
    deterministic_survival: Annotated[
        float, Metric("share of the initial states from which the policy without noise survives")
    ]
    stochastic_cost_mean: Annotated[
        float,
        Metric(
            "mean cost over all rollouts, each at most 10,000 times max(initial_ddp_cost, 1), as "
            "one that diverged",
            "stochastic_cost",
        ),
    ]
    stochastic_cost_median: Annotated[
        float, Metric("median cost over all rollouts; one that diverged counts as inf")
    ]
    stochastic_survival: Annotated[
        float, Metric("share of the rollouts that neither diverged nor fell, in [0, 1]")
    ]
    noise_std: Annotated[
        tuple[float, ...], Metric("shape (n_u,): the policy's noise, in the controls' units")
    ]
    policy_kl: Annotated[
        float,
        Metric("mean E_q[KL(q || pi_theta)] of a step, of the q before line 6 [nat]", "policy_kl"),
    ]
    coverage: Annotated[
        float,
        Metric("share of rollouts of q within two sd of its marginals; 0.95 if linear", "coverage"),
    ]
    policy_entropy: Annotated[float, Metric("entropy of pi_theta(u|x) [nat]")]
    bound: Annotated[
        float, Metric("L(q, theta), the bound on log p(O|theta) at this alpha [nat]", "bound")
    ]
    m_step_gain: Annotated[
        float, Metric("what the M-step added to L(q, theta); none should be lost [nat]")
    ]
    q_step_gain: Annotated[
        float, Metric("what the q-step added to it at this alpha; none should be lost [nat]")
    ]
    q_step_seconds: Annotated[float, Metric("wall time of the trajectory optimisation [s]")]
    m_step_seconds: Annotated[float, Metric("wall time of the rest of the update [s]")]
    simulator_steps: Annotated[
        int, Metric("simulator steps that learning has taken, finite differences included")
    ]
    new_situations: Annotated[
        int, Metric("situations that were drawn anew before the M-step", "new_situations")
    ]
    found_situations: Annotated[
        int, Metric("of these, those with a good solution, which are kept", "found_situations")
    ]
    policy_digest: Annotated[
        str, Metric("SHA-256 of the policy and of the digest before it; see policy_file.py")
    ]

    def entry(self) -> dict[str, Any]:
        """Returns k and the metrics as JSON values; what is not finite is null there."""
        return {f.name: _json_value(getattr(self, f.name)) for f in fields(IterationMetrics)}


METRICS: dict[str, Metric] = {
    f.name: f.type.__metadata__[0]  # type: ignore[union-attr]
    for f in fields(IterationMetrics)
    if f.name != "k"
}


def measure(
    work: "Workspace",
    before: "SearchState",
    update: "Update",
    evaluation: "Evaluation",
    q_step_seconds: float,
    m_step_seconds: float,
) -> IterationMetrics:
    """Computes the metrics of the iteration that has led from a state to an update."""
    policy, k = update.policy, before.k + 1
    place = work.seed, Stream.COVERAGE, k
    after = work.scored(update.solutions)
    covered = [
        coverage(task, q, generator(*place, i))
        for i, (task, q) in enumerate(zip(work.tasks, after[:_MOST_SITUATIONS], strict=False))
    ]
    initial_ddp_cost = float(np.mean([s.cost for s in before.initial_solutions]))
    return IterationMetrics(
        k=k,
        alpha=work.settings.alpha(k),
        initial_ddp_cost=initial_ddp_cost,
        ddp_cost=float(np.mean([s.cost for s in update.solutions])),
        **evaluation_metrics(evaluation, initial_ddp_cost),
        noise_std=tuple(policy.noise_std.tolist()),
        policy_entropy=float(entropy(np.diag(policy.noise_std**2))),
        coverage=float(np.mean(covered)),
        **_bound_metrics(work, before, policy, update.solutions),
        q_step_seconds=q_step_seconds,
        m_step_seconds=m_step_seconds,
        simulator_steps=work.simulator_steps,
        new_situations=work.new_situations,
        found_situations=work.found_situations,
        policy_digest=policy_digest(policy, before.digest),
    )


def evaluation_metrics(evaluation: "Evaluation", initial_ddp_cost: float) -> dict[str, Any]:
    """Computes the metrics by name that sum up an evaluation."""
    costs = evaluation.stochastic_costs
    bounded = np.minimum(costs, LARGEST_COST * max(initial_ddp_cost, 1.0))
    return {
        "deterministic_cost": float(evaluation.deterministic_costs.mean()),
        "deterministic_survival": float(evaluation.deterministic_survived.mean()),
        "stochastic_cost_mean": float(bounded.mean()),
        "stochastic_cost_median": float(np.quantile(costs, 0.5, method="higher")),
        "stochastic_survival": float(evaluation.stochastic_survived.mean()),
    }


def result_content(
    task: str,
    method: str,
    seed: int,
    policy: GaussianPolicy | None,
    history: Sequence[IterationMetrics],
) -> dict[str, Any]:
    """Returns the content of result.json; the last policy may be unknown, as in some bags."""
    return {
        "task": task,
        "method": method,
        "seed": seed,
        "hidden_units": list(policy.architecture.hidden_units) if policy else [],
        "num_parameters": policy.architecture.num_parameters if policy else 0,
        "initial_ddp_cost": history[-1].initial_ddp_cost,
        "iterations": [metrics.entry() for metrics in history],
    }


def _json_value(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_json_value(entry) for entry in value]
    return value if isinstance(value, str) or math.isfinite(value) else None


Distributions: TypeAlias = Sequence[TrajectoryDistribution]

# A step that loses less than this share of the bound is within the error of averages over samples.
_TOLERANCE = 1e-3
_REMEDIES = {
    "M-step": "raise fit.samples_per_step or fit.iterations",
    "q-step": "raise policy_samples or ddp_iterations",
}


def _bound_metrics(
    work: "Workspace",
    before: "SearchState",
    theta: GaussianPolicy,
    update: "Sequence[OptimizationResult]",
) -> dict[str, float]:
    """Computes the metrics by name; all are means over some situations that stayed.

    Iteration k led from the state before it to π_θ and the update's solutions.
    """
    task, alpha = work.task, work.settings.alpha(before.k + 1)
    solutions = before.last.solutions if before.last else before.initial_solutions
    stayed = [
        i
        for i, (old, new) in enumerate(zip(solutions, update, strict=True))
        if old.situation.is_same(new.situation)
    ][:_MOST_SITUATIONS]
    after = work.scored([update[i] for i in stayed])

    def cost(qs: Distributions) -> float:
        """Returns α E_q[Σ c]."""
        pairs = zip(qs, [work.tasks[i] for i in stayed], strict=True)
        return alpha * _mean([expected_cost(q, here.cost) for q, here in pairs])

    def divergence(qs: Distributions, policy: GaussianPolicy) -> float:
        """Returns Σ_t E_q[KL(q ‖ π_θ)], at the same points for all q and θ of the run."""
        rngs = (generator(work.seed, Stream.BOUND, i) for i in stayed)
        pairs = zip(qs, rngs, strict=True)
        return _mean([expected_divergence(q, policy, task.observation, r) for q, r in pairs])

    policy = before.last.policy if before.last else work.first_policy()
    qs = work.scored([solutions[i] for i in stayed])
    fitted = divergence(qs, theta)
    try:
        whole = [unlimited_marginals(work.tasks[i], q) for i, q in zip(stayed, after, strict=True)]
        bound = -cost(whole) - divergence(whole, theta)
    except DivergenceError:  # without std_limit the marginals explode
        bound = -math.inf
    return {
        "bound": bound,
        "m_step_gain": divergence(qs, policy) - fitted,
        "q_step_gain": cost(qs) + fitted - cost(after) - divergence(after, theta),
        "policy_kl": fitted / task.horizon,
    }


def unlimited_marginals(task: "Task", q: TrajectoryDistribution) -> TrajectoryDistribution:
    """Returns q with the marginals that it has where the task's std_limit does not cut them.

    Raises:
        DivergenceError: they explode.
    """
    unlimited = np.full_like(task.std_limit, np.inf)
    settings = task.optimizer.marginals
    spread = settings.spread(task.initial_std, unlimited, task.velocities, 1.0)
    sigma = state_covariances(q.linear_dynamics, q.gains, q.control_covariances, spread)
    return replace(q, state_covariances=sigma)


def lost_bound(metrics: IterationMetrics) -> list[str]:
    """Returns a sentence for each step of an iteration that has lowered the bound."""
    gains = {"M-step": metrics.m_step_gain, "q-step": metrics.q_step_gain}
    return [
        f"The {step} of iteration {metrics.k} lowered the bound L(q, theta) by {-gain:.3g} nat to "
        f"{metrics.bound:.5g}, which it should raise: {_REMEDIES[step]} if that goes on."
        for step, gain in gains.items()
        if gain < -_TOLERANCE * abs(metrics.bound)
    ]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


_ROLLOUTS = 4  # of each q
# What two standard deviations cover of a Gaussian that is twice as wide as predicted.
LEAST_COVERAGE = 0.68
LARGEST_COVERAGE = 0.999  # of one that is at most half as wide; few rollouts seldom reach it


def coverage(task: "Task", q: TrajectoryDistribution, rng: np.random.Generator) -> float:
    """Returns the share of the coordinates that lie within two sd of q's marginals, in [0, 1].

    Those of a rollout that diverged do not, and coordinates without any spread do not count.
    """
    dynamics, space = task.dynamics, task.dynamics.space
    starts = space.add(q.mean.states[0], sample_deviations(q, _ROLLOUTS, rng)[:, 0])
    controls = q.mean.controls + sample_rollout_noise(q, _ROLLOUTS, rng)
    motions = [
        motion.states
        for start, u in zip(starts, controls, strict=True)
        for motion in dynamics.follow_each(start, [replace(q.mean, controls=u)], q.gains)
    ]
    deviations = np.abs(space.subtract(np.stack(motions), q.mean.states))
    std = np.sqrt(np.diagonal(q.state_covariances, axis1=1, axis2=2))
    return float(np.mean((deviations <= 2.0 * std)[:, std > 0.0]))


def lost_coverage(metrics: IterationMetrics) -> list[str]:
    """Returns a sentence if the marginals are not those of q's rollouts after an iteration.

    Iteration 1 is passed over: the policy's first noise is wide, and usually too wide for them.
    """
    if metrics.k == 1 or LEAST_COVERAGE <= metrics.coverage < LARGEST_COVERAGE:
        return []
    remedy = (
        "Usual in the first iterations; if it stays, raise alpha, or the task's std_limit where it "
        "cuts the marginals."
        if metrics.coverage < LEAST_COVERAGE
        else "Where noise reaches the controls' limits rollouts spread less than it does; if it "
        "stays, raise alpha or the controls' weight in the cost."
    )
    return [
        f"Iteration {metrics.k}: the linear model is inaccurate (its 95 % band covers "
        f"{100.0 * metrics.coverage:.0f} % of rollouts). {remedy}"
    ]
