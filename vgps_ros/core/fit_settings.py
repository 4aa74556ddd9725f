"""Settings of the M-step, in a module of their own, since they can be used without torch."""

from dataclasses import dataclass

from vgps_ros.core.settings import setting


@dataclass(frozen=True)
class FitSettings:
    """Settings of the M-step."""

    form: str = setting(
        "analytic",
        "analytic: integrate over actions; sampled: draw them (Eq. 3)",
        choices=("analytic", "sampled"),
    )
    optimizer: str = setting(
        "lbfgs", "optimiser of the network's weights", choices=("lbfgs", "adam", "sgd")
    )
    samples_per_step: int = setting(
        10, "samples drawn of each step's marginal (M)", minimum=1, maximum=10_000
    )
    iterations: int = setting(100, "optimiser iterations in all", minimum=1, maximum=1_000_000)
    resample_every: int = setting(
        25,
        "LBFGS iterations between new samples, 20 to 50 in the paper; sgd and adam draw anew every "
        "iteration",
        minimum=1,
        maximum=1_000_000,
    )
    learning_rate: float = setting(
        0.01, "step of sgd and adam, in standardised units", minimum=1e-9, maximum=10.0
    )
