"""Settings of the DDP solver, in one record."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DdpSettings:
    """How a solve regularises, searches along a line, and stops.

    The state regularisation μ of B'(V + μI)B follows Tassa, Erez and Todorov (IROS 2012): it grows
    and shrinks by a factor that itself grows while the direction stays the same.

    Attributes:
        initial_regularization: μ of the first iteration.
        regularization_floor: smallest μ; lets contact-rich problems keep small steps.
        regularization_limit: μ above which the solve gives up with the status no_descent.
        regularization_factor: growth of the factor by which μ changes, above 1.
        distribution_regularization: μ of the last backward pass, whose gains make q(ζ).
        line_search_shrink: ratio of consecutive step sizes, in (0, 1).
        line_search_steps: step sizes tried before μ grows, at least 1.
        acceptance_ratio: least share of the expected reduction that a step must bring.
        cost_tolerance: relative cost reduction below which the solve has converged.
    """

    initial_regularization: float = 0.01
    regularization_floor: float = 1e-6
    regularization_limit: float = 1e10
    regularization_factor: float = 1.6
    distribution_regularization: float = 0.0
    line_search_shrink: float = 0.5
    line_search_steps: int = 8
    acceptance_ratio: float = 0.1
    cost_tolerance: float = 1e-7
