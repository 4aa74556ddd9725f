"""Settings that suit each built-in task, apart from the tasks: to show them takes no MuJoCo."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from vgps_ros.core.marginals import MarginalSettings
from vgps_ros.core.optimizer_settings import DdpSettings, OptimizerSettings
from vgps_ros.core.settings import Setting


@dataclass(frozen=True)
class TaskSettings:
    """Settings that were measured to suit a task.

    Attributes:
        optimizer: of the trajectory optimisation.
        search: of a policy search, by dotted name; the others keep their defaults.
    """

    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    search: Mapping[str, Any] = field(default_factory=dict)


TASKS: dict[str, TaskSettings] = {
    "rotor": TaskSettings(),
    "swimmer": TaskSettings(OptimizerSettings(marginals=MarginalSettings(std_limit_annealing=0.5))),
    "walker": TaskSettings(
        OptimizerSettings(
            # A floor under μ keeps steps small where contact is hard; q's gains keep away from it.
            ddp=DdpSettings(
                initial_regularization=0.1,
                regularization_floor=0.1,
                distribution_regularization=0.1,
            ),
            marginals=MarginalSettings(std_limit_annealing=0.5),
        ),
        search={"initial_ddp_iterations": 45, "ddp_iterations": 1},
    ),
}

TASK = Setting("task", "swimmer", "control problem", choices=tuple(sorted(TASKS)))
DEMONSTRATION = Setting(
    "demonstration",
    "",
    "table of a recorded motion to start from, the same for optimizer and learner; empty: the "
    "task's own start",
)
