# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings of the optimisation of q(ζ) and of the M-step.

They stand apart from what uses them: a program that only names them loads no compiler, no torch.
"""

from dataclasses import dataclass, field

from vgps_ros.core.marginals import MarginalSettings
from vgps_ros.core.settings import setting


@dataclass(frozen=True)
class DdpSettings:
    """Settings by which a solve regularises.

    The state regularisation μ of B'(V + μI)B follows Tassa, Erez and Todorov (IROS 2012): it grows
    and shrinks by a factor that itself grows while the direction stays the same.
    """

    initial_regularization: float = setting(
        0.01, "state regularisation mu of the first iteration", minimum=0.0, maximum=1e10
    )
    regularization_floor: float = setting(
        1e-6, "smallest mu; a large one keeps steps small where contact is hard", minimum=0.0,
        maximum=1e10,
    )  # fmt: skip
    distribution_regularization: float = setting(
        0.0, "mu of the last backward pass, whose gains make q", minimum=0.0, maximum=1e10
    )


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
    policy_samples: int = setting(
        10,
        "samples of each step's marginal over which log pi_theta is averaged",
        minimum=1,
        maximum=10_000,
    )
    first_tolerance: float = setting(
        0.0,
        "relative cost reduction below which a solve for the cost alone ends, where it is above "
        "1e-7, at which each solve ends",
        minimum=0.0,
        maximum=1.0,
    )
    bound_tolerance: float = setting(
        0.0,
        "share of what a q-step has raised the bound by so far; a DDP iteration that raises it by "
        "less ends the q-step",
        minimum=0.0,
        maximum=1.0,
    )
    dynamics_samples: int = setting(
        0,
        "samples of each step's q(x_t, u_t), 0.3 times as wide, over which the dynamics' "
        "derivatives are averaged, from which a solve makes q; 0: derivatives at q's mean",
        minimum=0,
        maximum=1000,
    )
    demonstration_tolerance: float = setting(
        0.1,
        "largest deviation from a demonstration that counts as following it [m, rad]",
        minimum=1e-12,
        maximum=10.0,
    )


@dataclass(frozen=True)
class FitSettings:
    """Settings of the M-step."""

    optimizer: str = setting(
        "gauss_newton",
        "optimiser of the network's weights",
        choices=("gauss_newton", "lbfgs"),
    )
    samples_per_step: int = setting(
        30, "samples drawn of each step's marginal (M)", minimum=1, maximum=10_000
    )
    iterations: int = setting(
        100, "optimiser iterations; gauss_newton ends before, once it has converged", minimum=1,
        maximum=1_000_000,
    )  # fmt: skip
    retries: int = setting(
        0,
        "shorter steps that gauss_newton takes in all after steps of less gain, before it ends; "
        "for large networks, which a few samples mislead",
        minimum=0,
        maximum=1000,
    )
    replayed: float = setting(
        1.0,
        "share of the replayed samples that an iteration of gauss_newton draws anew",
        minimum=0.0,
        maximum=1.0,
    )
    late: float = setting(
        0.0,
        "share of the samples that read the state one control period too late, so that the policy "
        "bears latency",
        minimum=0.0,
        maximum=1.0,
    )
    beyond: float = setting(
        0.0,
        "distance beyond a limit, as a share of half the control's range, to which a control at "
        "the limit, or what a feedback asks for beyond it, is taught: the robot does the same, and "
        "no policy stays short of the limit",
        minimum=0.0,
        maximum=10.0,
    )
