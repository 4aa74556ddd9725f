"""The policy search methods of section 6, by name, and the loop that runs any of them.

Every method gets the same initial DDP solutions and as many policy updates, the first of which fits
a policy to these solutions, and is evaluated alike.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np

from vgps_ros.core.checks import one_of
from vgps_ros.core.gaussians import entropy, kl_divergence
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.core.settings import Setting
from vgps_ros.search.adapted_weighted_dagger import adapted_weighted_dagger
from vgps_ros.search.adaptive_gps import adaptive_gps
from vgps_ros.search.cost_weighted import cost_weighted
from vgps_ros.search.dagger import dagger
from vgps_ros.search.evaluation import Evaluation, evaluate
from vgps_ros.search.gps import gps
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.trajectory_optimizer import OptimizationResult
from vgps_ros.search.vgps import vgps
from vgps_ros.search.weighted_dagger import weighted_dagger
from vgps_ros.search.workspace import OptimizeAll, Update, Workspace
from vgps_ros.tasks import Task

METHODS: dict[str, Callable[[Workspace], Iterator[Update]]] = {
    "vgps": vgps,
    "gps": gps,
    "adaptive_gps": adaptive_gps,
    "dagger": dagger,
    "weighted_dagger": weighted_dagger,
    "adapted_weighted_dagger": adapted_weighted_dagger,
    "cost_weighted": cost_weighted,
    "cost_weighted_1000": partial(cost_weighted, samples=1000),
}

METHOD = Setting("method", "vgps", "policy search method", choices=tuple(METHODS))


@dataclass(frozen=True)
class SearchIteration:
    """Outcome of iteration k.

    Attributes:
        k: 1 … K.
        alpha: α_k.
        policy: π_θ after the k-th update.
        evaluation: its costs.
        policy_kl: KL(q(u|x) ‖ π_θ(u|x)) along the trajectories before they were adapted to the
            policy, mean over steps [nat].
        policy_entropy: entropy of π_θ(u|x) [nat].
        solutions: q(ζ) of each initial state at the end of the iteration.
        initial_ddp_cost: cost of the solution of line 1, mean over initial states.
        ddp_cost: cost of the current solution, mean over initial states.
        q_step_seconds: wall time of trajectory optimisation.
        m_step_seconds: wall time of the rest of the update.
        simulator_steps: that learning has taken so far, finite differences included.
    """

    k: int
    alpha: float
    policy: GaussianPolicy
    evaluation: Evaluation
    policy_kl: float
    policy_entropy: float
    solutions: tuple[OptimizationResult, ...]
    initial_ddp_cost: float
    ddp_cost: float
    q_step_seconds: float
    m_step_seconds: float
    simulator_steps: int


def search(
    method: str, task: Task, settings: SearchSettings, seed: int, optimize_all: OptimizeAll
) -> Iterator[SearchIteration]:
    """Runs a method, yielding each iteration as it ends.

    Args:
        method: its name.
        task: the control problem.
        settings: of the search.
        seed: of all random draws, at least 0.
        optimize_all: solves the trajectory optimisations.

    Raises:
        InvalidInputError: the method is unknown, or a setting is out of range.
        DivergenceError: the first rollout of line 1 diverges.
    """
    run = METHODS[one_of("method", method, METHODS)]
    work = Workspace(task, settings, seed, optimize_all)
    solutions = work.initial_solutions
    initial_cost = _mean_cost(solutions)
    updates = islice(run(work), settings.iterations)
    for k in range(1, settings.iterations + 1):
        began, optimized = time.perf_counter(), work.optimization_seconds
        update = next(updates)
        q_step = work.optimization_seconds - optimized
        m_step = time.perf_counter() - began - q_step
        policy = update.policy
        yield SearchIteration(
            k=k,
            alpha=settings.alpha(k),
            policy=policy,
            evaluation=evaluate(task, policy, work.starts, settings.evaluation_rollouts, seed, k),
            policy_kl=_policy_kl(policy, work.scored(solutions)),
            policy_entropy=float(entropy(np.diag(policy.noise_std**2))),
            solutions=update.solutions,
            initial_ddp_cost=initial_cost,
            ddp_cost=_mean_cost(update.solutions),
            q_step_seconds=q_step,
            m_step_seconds=m_step,
            simulator_steps=work.simulator_steps,
        )
        solutions = update.solutions


def _policy_kl(policy: GaussianPolicy, distributions: Sequence[TrajectoryDistribution]) -> float:
    noise = np.diag(policy.noise_std**2)
    divergences = [
        kl_divergence(
            q.mean.controls, q.control_covariances, policy.mean(q.mean.states[:-1]), noise
        )
        for q in distributions
    ]
    return float(np.mean(divergences))


def _mean_cost(solutions: Sequence[OptimizationResult]) -> float:
    return float(np.mean([s.cost for s in solutions]))
