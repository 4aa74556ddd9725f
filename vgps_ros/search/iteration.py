"""What is known of an iteration of a policy search as it ends."""

from dataclasses import dataclass

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.search.evaluation import Evaluation
from vgps_ros.search.metrics import IterationMetrics
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
    """

    initial_solutions: tuple[OptimizationResult, ...]
    simulator_steps: int
    history: tuple[IterationMetrics, ...]
    last: Update | None

    @property
    def k(self) -> int:
        """Number of iterations that are done."""
        return len(self.history)


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
