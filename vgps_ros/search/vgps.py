"""Variational guided policy search, Algorithm 1 of Levine and Koltun (NIPS 2013).

It alternates between two problems until the policy reproduces what the trajectory optimiser found:

    q(ζ) ← argmin KL(q ‖ p(ζ | O, θ))    DDP on α_k c − log π_θ       (line 6)
    θ    ← argmax L(q, θ)                supervised fit to q's marginals (line 4)

Several initial states may be given; each has its own q, and all train one policy (section 5).
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.gaussians import entropy, kl_divergence
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.policy_fit import FitSettings, fit_policy, initial_policy
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.core.settings import check_settings, setting, with_values
from vgps_ros.search.evaluation import Evaluation, evaluate
from vgps_ros.search.trajectory_optimizer import OptimizationRequest, OptimizationResult
from vgps_ros.tasks import Task

OptimizeAll = Callable[[Sequence[OptimizationRequest]], Sequence[OptimizationResult]]
"""Solves independent requests, in order; in this process or through optimizer nodes."""


@dataclass(frozen=True)
class SearchSettings:
    """Settings of Algorithm 1."""

    iterations: int = setting(50, "iterations K of Algorithm 1", minimum=1, maximum=100_000)
    hidden_units: tuple[int, ...] = setting(
        (5,), "width of each hidden layer of the policy", minimum=1, maximum=10_000
    )
    activation: str = setting(
        "softplus", "activation of the hidden layers", choices=("softplus", "tanh", "relu")
    )
    hidden_bias: bool = setting(True, "whether hidden layers have bias terms")
    output_bias: bool = setting(True, "whether the output layer has bias terms")
    initial_alpha: float = setting(
        1.0, "alpha, the cost's scale, at k = 0", minimum=1e-9, maximum=1e9
    )
    final_alpha: float = setting(0.1, "alpha after the annealing", minimum=1e-9, maximum=1e9)
    annealing_iterations: int = setting(
        50, "iterations over which alpha falls exponentially", minimum=1, maximum=100_000
    )
    initial_ddp_iterations: int = setting(
        80, "DDP iterations of the initial solve (line 1)", minimum=1, maximum=100_000
    )
    ddp_iterations: int = setting(
        3, "DDP iterations of each later solve (line 6)", minimum=1, maximum=100_000
    )
    num_initial_states: int = setting(
        1, "initial states, each with its own q, that train one policy", minimum=1, maximum=1000
    )
    evaluation_rollouts: int = setting(
        20, "stochastic rollouts per initial state and iteration", minimum=1, maximum=100_000
    )
    fit: FitSettings = field(default_factory=FitSettings)

    def alpha(self, k: int) -> float:
        """Returns α_k = exp((K−k)/K log α_0 + k/K log α_K), constant after the annealing."""
        done = min(k / self.annealing_iterations, 1.0)
        return float(
            np.exp((1 - done) * np.log(self.initial_alpha) + done * np.log(self.final_alpha))
        )


@dataclass(frozen=True)
class SearchIteration:
    """Outcome of iteration k.

    Attributes:
        k: 1 … K.
        alpha: α_k.
        policy: π_θ after line 4.
        evaluation: its costs.
        policy_kl: KL(q(u|x) ‖ π_θ(u|x)) along the trajectories that it was fitted to, mean over
            steps [nat].
        policy_entropy: entropy of π_θ(u|x) [nat].
        solutions: q(ζ) of each initial state after line 6.
        initial_ddp_cost: cost of the solution of line 1, mean over initial states.
        ddp_cost: cost of the current solution, mean over initial states.
        q_step_seconds: wall time of line 6.
        m_step_seconds: wall time of line 4.
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


def architecture(task: Task, settings: SearchSettings) -> Architecture:
    """Returns the shape of the task's policy."""
    return Architecture(
        observed=task.observed,
        hidden_units=settings.hidden_units,
        control_dim=task.dynamics.control_dim,
        activation=settings.activation,
        hidden_bias=settings.hidden_bias,
        output_bias=settings.output_bias,
    )


def initial_states(task: Task, settings: SearchSettings, seed: int) -> list[Array]:
    """Returns x_1 of each trajectory: the task's own, or draws around it if there are several."""
    if settings.num_initial_states == 1:
        return [task.initial_state]
    rng = generator(seed, Stream.INITIAL_STATES)
    draws = rng.standard_normal((settings.num_initial_states, len(task.initial_state)))
    return list(task.initial_state + task.varied_state_std * draws)


def vgps(
    task: Task, settings: SearchSettings, seed: int, optimize_all: OptimizeAll
) -> Iterator[SearchIteration]:
    """Runs Algorithm 1, yielding each iteration as it ends.

    Args:
        task: the control problem.
        settings: of the algorithm.
        seed: of all random draws, at least 0.
        optimize_all: solves the trajectory optimisations.

    Raises:
        InvalidInputError: a setting is out of range.
        DivergenceError: the first rollout of line 1 diverges.
    """
    check_settings(settings)
    if seed < 0:
        raise InvalidInputError(f"seed is {seed}, but it must be at least 0.")
    starts = initial_states(task, settings, seed)
    # Line 1.
    solutions = optimize_all(
        [
            OptimizationRequest(
                trajectory_index=i,
                iteration=0,
                seed=seed,
                cost_scale=settings.alpha(0),
                max_iterations=settings.initial_ddp_iterations,
                initial_state=start,
                guess=task.guess(generator(seed, Stream.INITIAL_CONTROLS, i))
                if task.guess
                else None,
            )
            for i, start in enumerate(starts)
        ]
    )
    initial_ddp_cost = _mean_cost(solutions)
    policy = initial_policy(
        architecture(task, settings),
        _scored(task, solutions),
        generator(seed, Stream.POLICY_PARAMETERS),
    )
    for k in range(1, settings.iterations + 1):  # line 2
        began = time.perf_counter()
        # Line 3 is part of lines 1 and 6: a solution comes with its marginals. Line 4:
        distributions = _scored(task, solutions)
        rng = generator(seed, Stream.POLICY_FIT, k)
        policy = fit_policy(policy, distributions, settings.fit, rng)
        fitted = time.perf_counter()
        alpha = settings.alpha(k)  # line 5
        solutions = optimize_all(  # line 6
            [
                OptimizationRequest(
                    trajectory_index=i,
                    iteration=k,
                    seed=seed,
                    cost_scale=alpha,
                    max_iterations=settings.ddp_iterations,
                    initial_state=starts[i],
                    previous=solution.distribution,
                    policy=policy,
                )
                for i, solution in enumerate(solutions)
            ]
        )
        optimized = time.perf_counter()
        yield SearchIteration(
            k=k,
            alpha=alpha,
            policy=policy,
            evaluation=evaluate(task, policy, starts, settings.evaluation_rollouts, seed, k),
            policy_kl=_policy_kl(policy, distributions),
            policy_entropy=float(entropy(np.diag(policy.noise_std**2))),
            solutions=tuple(solutions),
            initial_ddp_cost=initial_ddp_cost,
            ddp_cost=_mean_cost(solutions),
            q_step_seconds=optimized - fitted,
            m_step_seconds=fitted - began,
        )


def search_settings(task: Task) -> SearchSettings:
    """Returns the settings that suit the task."""
    return with_values(SearchSettings(), task.search)


def _scored(task: Task, solutions: Sequence[OptimizationResult]) -> list[TrajectoryDistribution]:
    """Each q(ζ) over the horizon that is trained on."""
    return [s.distribution.first(task.horizon) for s in solutions]


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
