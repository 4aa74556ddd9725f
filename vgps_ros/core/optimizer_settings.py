"""Settings of the optimisation of q(ζ), which a task names and a user may change."""

from dataclasses import dataclass, field

from vgps_ros.core.ddp import DdpSettings
from vgps_ros.core.marginals import MarginalSettings
from vgps_ros.core.settings import setting


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
    demonstration_tolerance: float = setting(
        0.1,
        "largest deviation from a demonstration that counts as following it [m, rad]",
        minimum=1e-12,
        maximum=10.0,
    )
