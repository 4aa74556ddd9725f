# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The state and the outcome of a policy search as an iteration ends, and the time that is left."""

import time
from dataclasses import dataclass

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.search.evaluation import Evaluation
from vgps_ros.search.metrics import IterationMetrics
from vgps_ros.search.selection import Performance
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.search.workspace import Update


@dataclass(frozen=True)
class SearchState:
    """All that a run needs in order to go on after iteration k, or after line 1 where k is 0.

    Attributes:
        initial_solutions: of line 1, one for each initial state.
        simulator_steps: that learning has taken so far.
        history: metrics of the iterations so far.
        last: what the last one ended with; None at k = 0.
        best: the best policy of those that were tried; None where none was.
    """

    initial_solutions: tuple[OptimizationResult, ...]
    simulator_steps: int
    history: tuple[IterationMetrics, ...]
    last: Update | None
    best: Performance | None = None

    @property
    def k(self) -> int:
        """Number of iterations that are done."""
        return len(self.history)

    @property
    def digest(self) -> str:
        """The digest of the last policy, which vouches for all policies before it."""
        return self.history[-1].policy_digest if self.history else ""


@dataclass(frozen=True)
class SearchIteration(IterationMetrics):
    """Outcome of iteration k.

    Attributes:
        policy: π_θ after the k-th update.
        evaluation: its costs.
        initial_solutions: q(ζ) of each initial state before the first iteration.
        solutions: q(ζ) of each at the end of the iteration.
        history: metrics of all iterations so far, this one's last; complete also where the run
            went on from a checkpoint.
        warnings: sentences on trouble in the iteration that did not end the run.
    """

    policy: GaussianPolicy
    evaluation: Evaluation
    initial_solutions: tuple[OptimizationResult, ...]
    solutions: tuple[OptimizationResult, ...]
    history: tuple[IterationMetrics, ...]
    warnings: tuple[str, ...]

    @classmethod
    def of(
        cls, state: SearchState, evaluation: Evaluation, warnings: tuple[str, ...] = ()
    ) -> "SearchIteration":
        """Returns the outcome of the iteration that has led to a state."""
        assert state.last
        return cls(
            **vars(state.history[-1]),
            policy=state.last.policy,
            evaluation=evaluation,
            initial_solutions=state.initial_solutions,
            solutions=state.last.solutions,
            history=state.history,
            warnings=warnings,
        )


class RemainingTime:
    """Estimates the time left from the pace so far; the initial solve does not count."""

    def __init__(self, iterations: int):
        self._iterations = iterations
        self._first: tuple[int, float] | None = None  # k and time of the first call

    def after(self, iteration: IterationMetrics) -> float:
        """Returns the time left [s]; call it once as each iteration ends."""
        now = time.monotonic()
        left = self._iterations - iteration.k
        if self._first is None:
            self._first = (iteration.k, now)
            return left * (iteration.q_step_seconds + iteration.m_step_seconds)
        k, began = self._first
        return left * (now - began) / (iteration.k - k)
