# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings of the optimisation of q(ζ) and of the M-step.

They stand apart from what uses them: a program that only names them loads no compiler, no torch.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from vgps_ros.core.marginals import MarginalSettings
from vgps_ros.core.settings import Range


@dataclass(frozen=True)
class DdpSettings:
    """Settings by which a solve regularises.

    The state regularisation μ of B'(V + μI)B follows Tassa, Erez and Todorov (IROS 2012): it grows
    and shrinks by a factor that itself grows while the direction stays the same.
    """

    initial_regularization: Annotated[
        float, Range(0.0, 1e10), "state regularisation mu of the first iteration"
    ] = 0.01
    regularization_floor: Annotated[
        float, Range(0.0, 1e10), "smallest mu; a large one keeps steps small where contact is hard"
    ] = 1e-6
    distribution_regularization: Annotated[
        float, Range(0.0, 1e10), "mu of the last backward pass, whose gains make q"
    ] = 0.0


@dataclass(frozen=True)
class OptimizerSettings:
    """Settings of the optimisation of q(ζ).

    Attributes:
        ddp: settings of the solver; its regularisations are multiplied by α, as the cost is, so
            that their relative weight stays.
        marginals: settings of the marginals' width.
    """

    ddp: DdpSettings = field(default_factory=DdpSettings)
    marginals: MarginalSettings = field(default_factory=MarginalSettings)
    policy_samples: Annotated[
        int, Range(1, 10_000), "samples of each step's marginal over which log pi_theta is averaged"
    ] = 10
    first_tolerance: Annotated[
        float,
        Range(0.0, 1.0),
        "relative cost reduction below which a solve for the cost alone ends, where it is above "
        "1e-7, at which each solve ends",
    ] = 0.0
    bound_tolerance: Annotated[
        float,
        Range(0.0, 1.0),
        "share of what a q-step has raised the bound by so far; a DDP iteration that raises it by "
        "less ends the q-step",
    ] = 0.0
    dynamics_samples: Annotated[
        int,
        Range(0, 1000),
        "samples of each step's q(x_t, u_t), 0.3 times as wide, over which the dynamics' "
        "derivatives are averaged, from which a solve makes q; 0: derivatives at q's mean",
    ] = 0
    demonstration_tolerance: Annotated[
        float,
        Range(1e-12, 10.0),
        "largest deviation from a demonstration that counts as following it [m, rad]",
    ] = 0.1


@dataclass(frozen=True)
class FitSettings:
    """Settings of the M-step."""

    optimizer: Annotated[Literal["gauss_newton", "lbfgs"], "optimiser of the network's weights"] = (
        "gauss_newton"
    )
    samples_per_step: Annotated[
        int, Range(1, 10_000), "samples drawn of each step's marginal (M)"
    ] = 30
    iterations: Annotated[
        int,
        Range(1, 1_000_000),
        "optimiser iterations; gauss_newton ends before, once it has converged",
    ] = 100
    retries: Annotated[
        int,
        Range(0, 1000),
        "shorter steps that gauss_newton takes in all after steps of less gain, before it ends; "
        "for large networks, which a few samples mislead",
    ] = 0
    replayed: Annotated[
        float,
        Range(0.0, 1.0),
        "share of the replayed samples that an iteration of gauss_newton draws anew",
    ] = 1.0
    late: Annotated[
        float,
        Range(0.0, 1.0),
        "share of the samples that read the state one control period too late, so that the policy "
        "bears latency",
    ] = 0.0
    beyond: Annotated[
        float,
        Range(0.0, 10.0),
        "distance beyond a limit, as a share of half the control's range, to which a control at "
        "the limit, or what a feedback asks for beyond it, is taught: the robot does the same, and "
        "no policy stays short of the limit",
    ] = 0.0
