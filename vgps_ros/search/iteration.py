"""What is known of an iteration of a policy search as it ends."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.gaussians import kl_divergence
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import TrajectoryDistribution
from vgps_ros.search.evaluation import Evaluation
from vgps_ros.search.trajectory_optimizer import OptimizationResult
from vgps_ros.search.workspace import Update


@dataclass(frozen=True)
class Figures:
    """Outcome of iteration k in numbers; a diverged rollout costs inf.

    Attributes:
        k: 1 … K.
        alpha: α_k.
        initial_ddp_cost: cost of the solution of line 1, mean over initial states.
        ddp_cost: cost of the current solution, mean over initial states.
        deterministic_cost: of the policy without noise, mean over initial states.
        deterministic_survival: share of the initial states from which it survives.
        stochastic_cost_mean: mean over the rollouts that did not diverge.
        stochastic_cost_median: over all rollouts.
        stochastic_survival: share of the rollouts that survive.
        noise_std: σ of the policy [N·m], one a control.
        policy_kl: KL(q(u|x) ‖ π_θ(u|x)) along the trajectories before they were adapted to the
            policy, mean over steps [nat]; in the iteration in which vgps chooses among candidates,
            along those of the first one.
        policy_entropy: entropy of π_θ(u|x) [nat].
        q_step_seconds: wall time of trajectory optimisation.
        m_step_seconds: wall time of the rest of the update.
        simulator_steps: that learning has taken so far, finite differences included.
    """

    k: int
    alpha: float
    initial_ddp_cost: float
    ddp_cost: float
    deterministic_cost: float
    deterministic_survival: float
    stochastic_cost_mean: float
    stochastic_cost_median: float
    stochastic_survival: float
    noise_std: tuple[float, ...]
    policy_kl: float
    policy_entropy: float
    q_step_seconds: float
    m_step_seconds: float
    simulator_steps: int


@dataclass(frozen=True)
class SearchState:
    """All that a run needs in order to go on after iteration k, or after line 1 where k is 0.

    Attributes:
        initial_solutions: of line 1, one for each initial state.
        simulator_steps: that learning has taken so far.
        history: figures of the iterations so far.
        last: what the last one ended with; None at k = 0.
    """

    initial_solutions: tuple[OptimizationResult, ...]
    simulator_steps: int
    history: tuple[Figures, ...]
    last: Update | None

    @property
    def k(self) -> int:
        """Number of iterations that are done."""
        return len(self.history)


@dataclass(frozen=True)
class SearchIteration(Figures):
    """Outcome of iteration k.

    Attributes:
        policy: π_θ after the k-th update.
        evaluation: its costs.
        initial_solutions: q(ζ) of each initial state before the first iteration.
        solutions: q(ζ) of each at the end of the iteration.
        history: figures of all iterations so far, the last of which are this one's; complete also
            where the run went on from a checkpoint.
        warnings: what went wrong in it and was got over, in sentences.
    """

    policy: GaussianPolicy
    evaluation: Evaluation
    initial_solutions: tuple[OptimizationResult, ...]
    solutions: tuple[OptimizationResult, ...]
    history: tuple[Figures, ...]
    warnings: tuple[str, ...]

    @classmethod
    def of(
        cls,
        state: SearchState,
        update: Update,
        evaluation: Evaluation,
        warnings: tuple[str, ...] = (),
    ) -> "SearchIteration":
        """Returns the outcome of the iteration that has led to a state by an update."""
        return cls(
            **vars(state.history[-1]),
            policy=update.policy,
            evaluation=evaluation,
            initial_solutions=state.initial_solutions,
            solutions=update.solutions,
            history=state.history,
            warnings=warnings,
        )


def policy_kl(policy: GaussianPolicy, distributions: Sequence[TrajectoryDistribution]) -> float:
    """Returns KL(q(u|x) ‖ π_θ(u|x)) along the distributions' means, mean over steps [nat]."""
    noise = np.diag(policy.noise_std**2)
    divergences = [
        kl_divergence(
            q.mean.controls, q.control_covariances, policy.mean(q.mean.states[:-1]), noise
        )
        for q in distributions
    ]
    return float(np.mean(divergences))


def mean_solution_cost(solutions: Sequence[OptimizationResult]) -> float:
    """Returns the cost of the solutions' means, averaged over initial states."""
    return float(np.mean([s.cost for s in solutions]))
