# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The workspace of a policy search method: its problem, and the steps that methods share."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.core.dynamics import ControlLaw
from vgps_ros.core.errors import DivergenceError, InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_fit import Targets, fit_policy, fit_to_targets, initial_policy, resample
from vgps_ros.core.policy_network import Standardization
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.core.settings import differences, values_of
from vgps_ros.core.visited_states import visited_targets
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.rollouts import Executions, Rollouts, roll_out
from vgps_ros.search.settings import SearchSettings, architecture
from vgps_ros.search.situations import Situation, situations
from vgps_ros.search.trajectory_optimization import OptimizationResult, Outcome
from vgps_ros.tasks import Task

OptimizeAll = Callable[[Sequence[OptimizationRequest]], Sequence[Outcome]]
"""Solves independent requests, in order; in this process or through optimizer nodes."""


@dataclass(frozen=True)
class Update:
    """The result of one iteration of a method, with all that the next iteration needs of it.

    A method that remembers more adds fields. It remembers no generator's state, since every random
    draw has a generator of its own, named by seed, purpose and place.

    Attributes:
        policy: π_θ.
        solutions: q(ζ) of each situation.
    """

    policy: GaussianPolicy
    solutions: tuple[OptimizationResult, ...]


class Workspace:
    """One run of a method. All methods begin with the same initial DDP solutions, line 1.

    Args:
        task: the control problem.
        settings: settings of the search.
        seed: seed of all random draws, at least 0.
        optimize_all: solves the trajectory optimisations.
        initial_solutions: initial solutions of this run, if they are known already.
        begin: makes them otherwise.
        first_policy: the policy that the first fit begins with; else it is drawn at random.

    Attributes:
        tasks: the task in each situation from which the policy learns.
        initial_solutions: solutions for the cost alone, one for each of the first situations.
        executions: rollouts of policies, of which the last ones are kept.
        optimization_seconds: wall time of trajectory optimisation so far [s].
        simulator_steps: simulator steps of learning so far; evaluations do not count.
        new_situations: how many situations were drawn anew before the last M-step.
        found_situations: for how many of these a solution was found and kept.

    Raises:
        InvalidInputError: a situation cannot be drawn, or optimizers have different settings.
        DivergenceError: the first rollout diverges.
    """

    def __init__(
        self,
        task: Task,
        settings: SearchSettings,
        seed: int,
        optimize_all: OptimizeAll,
        initial_solutions: tuple[OptimizationResult, ...] = (),
        begin: "Callable[[Workspace], tuple[OptimizationResult, ...]] | None" = None,
        first_policy: GaussianPolicy | None = None,
    ):
        self.task = task
        self.settings = settings
        self.seed = seed
        self._given_policy = first_policy
        self.optimization_seconds = 0.0
        self.simulator_steps = 0
        self.new_situations, self.found_situations = 0, 0
        self.executions = Executions(seed)
        self._optimize_all = optimize_all
        self._entered: list[tuple[Situation, Task]] = []
        self._warnings: list[str] = []
        self.initial_solutions: tuple[OptimizationResult, ...] = ()
        self.initial_solutions = initial_solutions or (begin or Workspace.solve_cost_alone)(self)
        self.enter(self.initial_solutions)

    def enter(self, solutions: Sequence[OptimizationResult]) -> None:
        """Goes on in the situations of these solutions; the task of one that stays is kept."""
        wanted, known = [each.situation for each in solutions], self._entered
        self._entered = [
            (one, known[i][1] if i < len(known) and known[i][0].is_same(one) else one.of(self.task))
            for i, one in enumerate(wanted)
        ]
        self.tasks = [task for _, task in self._entered]

    def solve_cost_alone(self) -> tuple[OptimizationResult, ...]:
        """Solves line 1; of several situations, those that diverge are left out, but the first."""
        requests = [
            replace(
                self.request(i, situation, k=0),
                guess=motion.controls if motion else None,
                guess_states=motion.states if motion else None,
                max_iterations=self.settings.initial_ddp_iterations,
            )
            for i, (situation, motion) in enumerate(situations(self.task, self.settings, self.seed))
        ]
        first, *others = self.optimize(requests)
        if isinstance(first, DivergenceError):
            raise first
        found = [first]
        for i, outcome in enumerate(others, 1):
            if isinstance(outcome, DivergenceError):
                self.warn(f"Situation {i} is left out: {outcome}")
            else:
                found.append(outcome)
        means = (each.distribution.mean.first(self.task.horizon) for each in found)
        if all(self.task.fallen(mean.states).any() for mean in means):
            self._warnings.append(
                "In each first solution the robot falls, so that little can be learned; raise "
                "initial_ddp_iterations, or change how the task begins or what it asks for."
            )
        return tuple(found)

    def request(self, i: int, situation: Situation, k: int) -> OptimizationRequest:
        """Returns the solve of situation i in iteration k, with no motion to start from yet."""
        return OptimizationRequest(
            trajectory_index=i,
            iteration=k,
            seed=self.seed,
            cost_scale=self.settings.alpha(k),
            max_iterations=self.settings.ddp_iterations,
            situation=situation,
        )

    def first_policy(self) -> GaussianPolicy:
        """Returns the policy for the first fit: the one that is given, or a network at random."""
        if self._given_policy:
            return self._given_policy
        rng = generator(self.seed, Stream.POLICY_PARAMETERS)
        return initial_policy(self.standardization(), rng)

    def supervised_policy(
        self, distributions: Sequence[TrajectoryDistribution] | None = None
    ) -> GaussianPolicy:
        """Returns a policy fitted to the initial DDP solutions, or to the given distributions."""
        fit = replace(self.settings.fit, iterations=self.settings.supervised_iterations)
        return fit_policy(
            self.first_policy(),
            self.task.observation,
            self.taught(self.initial_solutions) if distributions is None else distributions,
            fit,
            generator(self.seed, Stream.POLICY_FIT, 1),
        )

    def fit(
        self,
        policy: GaussianPolicy,
        solutions: Sequence[OptimizationResult],
        k: int,
        replay: Sequence[Targets] = (),
        drawn: Sequence[Rollouts] | None = None,
    ) -> GaussianPolicy:
        """Returns the policy that maximises L(q, θ), started from `policy` (line 4).

        It learns from q(ζ) of each situation, from samples of those that were renewed, and in the
        states of rollouts: those that were drawn already, or new ones of the policy.
        """
        rng = generator(self.seed, Stream.POLICY_FIT, k)
        observation, scored = self.task.observation, self.taught(solutions)
        visited, settings = self._visited(policy, scored, k, drawn), self.settings.fit
        augmentation = self.task.augmentation
        taught = self._taught_limits() if settings.beyond else None
        fitted = fit_policy(
            policy, observation, scored, settings, rng, visited, augmentation, replay, taught
        )
        stays = np.array_equal(fitted.parameters, policy.parameters)
        # Gauss-Newton ends at its start where the fit has converged, which is no trouble.
        if stays and self.settings.fit.optimizer != "gauss_newton":
            self._warnings.append(
                f"The M-step of iteration {k} found nothing better, so the network stays: raise "
                "fit.iterations or fit.samples_per_step if that goes on."
            )
        return fitted

    def _visited(
        self,
        policy: GaussianPolicy,
        scored: Sequence[TrajectoryDistribution],
        k: int,
        drawn: Sequence[Rollouts] | None,
    ) -> list[Targets]:
        """Returns what q(ζ) would do in states that a policy visits, for each situation."""
        limit = self.settings.visited_limit
        if k == 1 or not limit:  # a random network visits nothing that would teach it
            return []
        draws = drawn or self.sample_policy(policy, self.settings.policy_rollouts, k)
        return [
            visited_targets(q, here.observation, rollouts.states, limit, rollouts.controls)
            for q, here, rollouts in zip(scored, self.tasks, draws, strict=True)
            if len(rollouts.states)
        ]

    def fit_samples(
        self, policy: GaussianPolicy, targets: Targets, probabilities: Array | None, k: int
    ) -> GaussianPolicy:
        """Fits the policy to as many draws of a sample set as `fit` takes from the marginals."""
        settings = self.settings.fit
        count = settings.samples_per_step * self.task.horizon * len(self.tasks)
        rng = generator(self.seed, Stream.POLICY_FIT, k)
        samples = resample(targets, probabilities, count, rng)
        return fit_to_targets(policy, samples, self.standardization(), settings)

    def reoptimize(
        self, solutions: Sequence[OptimizationResult], policy: GaussianPolicy, k: int
    ) -> tuple[OptimizationResult, ...]:
        """Adapts q(ζ) to the policy (lines 5 and 6); a q(ζ) whose solve diverges stays."""
        requests = [
            replace(
                self.request(i, solution.situation, k),
                previous=solution.distribution,
                policy=policy,
            )
            for i, solution in enumerate(solutions)
        ]
        adapted = []
        for i, outcome in enumerate(self.optimize(requests)):
            if isinstance(outcome, DivergenceError):
                self.warn(f"Solution {i} of iteration {k} stays as it was: {outcome}")
            adapted.append(solutions[i] if isinstance(outcome, DivergenceError) else outcome)
        return tuple(adapted)

    def warn(self, sentence: str) -> None:
        """Notes a failure that the search survives."""
        self._warnings.append(sentence)

    def take_warnings(self) -> tuple[str, ...]:
        """Returns a sentence for each failure since the last call that the search has survived."""
        taken, self._warnings = tuple(dict.fromkeys(self._warnings)), []
        return taken

    def sample_policy(self, policy: GaussianPolicy, count: int, k: int) -> list[Rollouts]:
        """Draws rollouts of the policy, with its noise, in each situation."""
        draws = []
        for i, here in enumerate(self.tasks):
            executed = self.executions.of(here, policy, count, k, i)
            self.simulator_steps += executed.steps
            draws.append(executed.scored())
        return draws

    def roll_out(
        self, situation: int, count: int, rng: np.random.Generator, law: ControlLaw
    ) -> Rollouts:
        """Executes a control law in a situation, from draws around its start, until it is scored.

        A robot's motion after its fall is not scored: each step then costs as much as lying still.
        """
        rollouts, steps = roll_out(self.tasks[situation], count, rng, law)
        self.simulator_steps += steps
        return rollouts

    def scored(self, solutions: Sequence[OptimizationResult]) -> list[TrajectoryDistribution]:
        """Returns each q(ζ) over the horizon that the policy is trained on."""
        return [s.distribution.first(self.task.horizon) for s in solutions]

    def taught(self, solutions: Sequence[OptimizationResult]) -> list[TrajectoryDistribution]:
        """Returns each q(ζ) as the policy is to learn it; see `fit.beyond`."""
        scored = self.scored(solutions)
        return list(map(self._beyond_limits, scored)) if self.settings.fit.beyond else scored

    def _beyond_limits(self, q: TrajectoryDistribution) -> TrajectoryDistribution:
        """Returns q(ζ) with controls beyond a limit where they are at it."""
        (lowest, highest), controls = self.task.dynamics.control_limits, q.mean.controls
        least, most = self._taught_limits()
        beyond = np.where(controls >= highest, most, np.where(controls <= lowest, least, controls))
        return replace(q, mean=replace(q.mean, controls=beyond))

    def _taught_limits(self) -> tuple[Array, Array]:
        """Returns the lowest and highest controls that are taught, (n_u,) each; `fit.beyond`."""
        lowest, highest = self.task.dynamics.control_limits
        ranges = np.where(np.isfinite(highest - lowest), highest - lowest, 0.0)
        further = 0.5 * self.settings.fit.beyond * ranges
        return lowest - further, highest + further

    def standardization(self) -> Standardization:
        """Returns units that suit the initial solutions."""
        distributions = self.taught(self.initial_solutions)
        shape = architecture(self.task, self.settings)
        return Standardization.of(shape, self.task.observation, distributions)

    def optimize(self, requests: Sequence[OptimizationRequest]) -> list[Outcome]:
        """Solves several requests, in order."""
        began = time.perf_counter()
        outcomes = list(self._optimize_all(requests)) if requests else []
        results = [each for each in outcomes if isinstance(each, OptimizationResult)]
        _check_one_optimizer([*self.initial_solutions, *results])
        self.optimization_seconds += time.perf_counter() - began
        self.simulator_steps += sum(result.simulator_steps for result in results)
        return outcomes


def _check_one_optimizer(results: Sequence[OptimizationResult]) -> None:
    """Checks that all solves of a training, the first one first, were made by the same settings.

    In a graph the optimizers have settings of their own, which may change between two solves.
    """
    all_settings = [result.settings for result in results]
    for settings in all_settings[1:]:
        begun = all_settings[0]
        if settings != begun:
            theirs, ours = differences(values_of(settings), values_of(begun))
            raise InvalidInputError(
                f"A trajectory optimizer solves with {theirs}, but the training was begun with "
                f"{ours}: start it with these values, or name another folder for the checkpoints "
                "to begin anew."
            )
