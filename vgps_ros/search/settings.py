# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings of a policy search, which all methods share."""

from bisect import bisect
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.optimizer_settings import FitSettings
from vgps_ros.core.policy import Architecture
from vgps_ros.core.settings import Range, Setting, settings_of, with_values
from vgps_ros.robot.signals import CommandSettings
from vgps_ros.tasks.disturbance import DisturbanceSettings

if TYPE_CHECKING:
    from vgps_ros.tasks import Task

# The methods that the paper compares, in section 6.
OF_PAPER = (
    *("vgps", "gps", "adaptive_gps", "dagger", "weighted_dagger", "adapted_weighted_dagger"),
    *("cost_weighted", "cost_weighted_1000"),
)
METHOD = Setting("method", "vgps", "policy search method", kind=Literal[(*OF_PAPER, "mdgps")])

# What each preset sets, by dotted name. That of the paper is Algorithm 1 as written: the policy is
# fitted to q's marginals alone, by LBFGS, and α falls from 1 to 0.1 by the 50th iteration.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "ours": {},
    "paper": {
        "alphas": (1.0, 0.1),
        "alpha_iterations": (0, 50),
        "visited_limit": 0.0,
        "fit.optimizer": "lbfgs",
    },
}


@dataclass(frozen=True)
class GpsSettings:
    """Settings of guided policy search and its adaptive variant."""

    redraw: Annotated[
        bool,
        "whether the best policy is rolled out anew in each iteration, from the same starts and "
        "with the same noise as the latest one, so that it is not judged by its luck",
    ] = False
    guiding_noise: Annotated[
        float,
        Range(1e-6, 1.0),
        "factor on the standard deviation of pi_G's noise that guiding rollouts are drawn with",
    ] = 0.1


@dataclass(frozen=True)
class MirrorSettings:
    """Settings of mirror descent guided policy search."""

    dynamics: Annotated[
        Literal["model", "fitted"],
        "model: the simulator's derivatives; fitted: linear dynamics fitted to the rollouts, and "
        "no DDP",
    ] = "model"
    objective: Annotated[
        Literal["average", "likelihood"],
        "average: E_q[c], near pi_theta, from rollouts of it; likelihood: alpha E_q[c] + "
        "KL(q, pi_theta) as in vgps, near the q before, from rollouts of that",
    ] = "average"
    kl_bound: Annotated[
        float,
        Range(1e-6, 1e3),
        "largest KL divergence of q from what it must stay near, per control step [nat]",
    ] = 0.1
    exploration: Annotated[
        tuple[float, ...],
        Range(1e-9, 1e6),
        "standard deviation of the noise on the first motion where dynamics are fitted, one for "
        "all controls or one for each [unit of the control]",
    ] = (1.0,)
    first_steps: Annotated[
        int,
        Range(0, 100_000),
        "steps for the cost alone before the first policy, where dynamics are fitted",
    ] = 20


@dataclass(frozen=True)
class RenewalSettings:
    """Settings of the situations that vgps replaces by new ones, where its policy goes."""

    share: Annotated[
        float,
        Range(0.0, 1.0),
        "share of the situations, but the first, that are replaced in an iteration; 0: none",
    ] = 0.0
    begin: Annotated[int, Range(1, 100_000), "first iteration in which situations are replaced"] = 4
    end: Annotated[int, Range(0, 100_000), "iterations at the end in which none are replaced"] = 4
    seconds: Annotated[
        float,
        Range(1e-3, 1e4),
        "length of the policy's motion on which a new situation begins, in which the commands "
        "change once [s]",
    ] = 8.0
    fall_lead: Annotated[
        float,
        Range(0.0, 1e3),
        "time before a fall after which no situation begins; shortly before it is up to three "
        "times as long. A taller robot falls more slowly [s]",
    ] = 0.3
    push: Annotated[
        float,
        Range(0.0, 1e6),
        "largest impulse of a push in that motion; the situation begins up to 0.5 s after it [N*s]",
    ] = 0.0
    pushed: Annotated[float, Range(0.0, 1.0), "share of these motions with a push"] = 0.6
    ddp_iterations: Annotated[
        int, Range(1, 100_000), "DDP iterations of a new situation's first solve"
    ] = 20
    worst: Annotated[
        float,
        Range(0.0, 1e6),
        "cost at its end, as a multiple of the first solutions' median, beyond which a new "
        "solution is dropped",
    ] = 1.5
    replay: Annotated[
        int,
        Range(0, 100_000),
        "situations that were replaced from whose samples the policy still learns",
    ] = 200


@dataclass(frozen=True)
class KeepSettings:
    """Settings of the rollouts by which a search that renews situations keeps its best policy."""

    rollouts: Annotated[
        int,
        Range(0, 10_000),
        "rollouts in which each policy of the second half is tried; 0: the last one is kept",
    ] = 40
    seconds: Annotated[float, Range(1.0, 1e3), "length of such a rollout [s]"] = 10.0


@dataclass(frozen=True)
class SearchSettings:
    """Settings of a policy search."""

    iterations: Annotated[int, Range(1, 100_000), "iterations K, each with one policy update"] = 50
    hidden_units: Annotated[
        tuple[int, ...], Range(1, 10_000), "width of each hidden layer of the policy"
    ] = (5,)
    preset: Annotated[
        Literal["ours", "paper"],
        "paper: Algorithm 1 as written, with alpha from 1 to 0.1 by the 50th iteration, no "
        "visited states, and LBFGS; ours: all as the other settings say",
    ] = "ours"
    alphas: Annotated[
        tuple[float, ...],
        Range(1e-9, 1e9),
        "values of alpha, the cost's scale; exponential between them, then constant",
    ] = (0.3, 20.0)
    alpha_iterations: Annotated[
        tuple[int, ...],
        Range(0, 100_000),
        "iteration at which each of them is reached; 0 alone spreads them evenly over the run",
    ] = (0,)
    initial_ddp_iterations: Annotated[
        int, Range(1, 100_000), "DDP iterations of the initial solve (line 1)"
    ] = 80
    ddp_iterations: Annotated[
        int, Range(1, 100_000), "DDP iterations of each later solve (line 6)"
    ] = 3
    situations: Annotated[
        int,
        Range(1, 1000),
        "situations, each with a start, a disturbance and a q of its own, that train one policy; "
        "several have several starts",
    ] = 1
    evaluation_rollouts: Annotated[
        int,
        Range(1, 100_000),
        "stochastic rollouts per situation that judge the policy of an iteration; the next one may "
        "learn from the same, so up to policy_rollouts of them cost nothing more",
    ] = 10
    policy_rollouts: Annotated[
        int,
        Range(1, 1_000_000),
        "rollouts of the policy per situation and iteration, for methods that learn from them",
    ] = 10
    visited_limit: Annotated[
        float,
        Range(0.0, 100.0),
        "largest distance from q, in standard deviations of its marginals, at which states of "
        "such rollouts join the samples of vgps's M-step; 0: the marginals alone, as in the paper",
    ] = 2.0
    supervised_iterations: Annotated[
        int,
        Range(1, 1_000_000),
        "optimiser iterations of the first fit where a method begins as a copy of the DDP solution",
    ] = 2000
    disturb: DisturbanceSettings = field(default_factory=DisturbanceSettings)
    commands: CommandSettings = field(default_factory=CommandSettings)
    renew: RenewalSettings = field(default_factory=RenewalSettings)
    keep: KeepSettings = field(default_factory=KeepSettings)
    fit: FitSettings = field(default_factory=FitSettings)
    gps: GpsSettings = field(default_factory=GpsSettings)
    mirror: MirrorSettings = field(default_factory=MirrorSettings)

    def __post_init__(self) -> None:
        """Checks alpha's schedule, for which ranges of single values are not enough."""
        count, reached = len(self.alphas), self.alpha_iterations
        if reached == (0,):
            return
        if count != len(reached):
            raise InvalidInputError(
                f"alphas has {count} values, but alpha_iterations has {len(reached)}: name for "
                "each alpha the iteration at which it is reached, or 0 alone."
            )
        if reached[0] != 0 or any(a >= b for a, b in pairwise(reached)):
            raise InvalidInputError(
                f"alpha_iterations is {list(reached)}, but it must begin with 0 and increase."
            )

    def alpha(self, k: int) -> float:
        """Returns α_k: exponential between the values of the schedule, then constant.

        By default α rises. A q-step adds α times the cost's curvature H to the precision of the
        policy's noise, and the M-step adds the square of its fit's residual r to the variance:

            1/Σ_q = 1/σ² + α H,    σ² ← Σ_q + r².

        So at a constant α the noise falls, ever more slowly, to σ² → r/√(α H), and α σ² H is the
        weight of the cost against the policy. Where α falls, as in the paper (section 6), that
        weight falls much faster than the noise, q yields to what the network likes, and costs rise
        again. Where α rises, the noise goes on falling, and q stays near the optimum of the cost.

        A small network also needs α to begin low: q then bends to the network, r becomes small, and
        stays so. Where q keeps to the optimum of the cost from the first iteration on, some seeds
        end at a policy that never fits it (docs/evidence/policies.md).
        """
        alphas, reached = self.alphas, self.alpha_iterations
        pieces = len(alphas) - 1
        if not pieces:
            return alphas[0]
        points: tuple[float, ...] = reached
        if len(points) <= 1:
            points = tuple(self.iterations * i / pieces for i in range(pieces + 1))
        i = min(bisect(points, k), pieces)
        begin, end = points[i - 1 : i + 1]
        done = min((k - begin) / (end - begin), 1.0)
        log_alphas = np.log(alphas[i - 1 : i + 1])
        return float(np.exp((1 - done) * log_alphas[0] + done * log_alphas[1]))


def architecture(task: "Task", settings: SearchSettings) -> Architecture:
    """Returns the shape of the task's policy."""
    return Architecture(task.observation.names, settings.hidden_units, task.dynamics.control_dim)


def search_settings(task: "Task") -> SearchSettings:
    """Returns the settings that suit the task."""
    return with_values(SearchSettings(), task.search)


def with_preset(settings: SearchSettings, task: "Task") -> SearchSettings:
    """Returns the settings with what their preset sets in place of the task's defaults.

    Raises:
        InvalidInputError: something else was chosen for one of them.
    """
    chosen = PRESETS[settings.preset]
    given, *usual = (
        {s.name: s.default for s in settings_of(record)}
        for record in (settings, search_settings(task), SearchSettings())
    )
    for name, value in chosen.items():
        check_preset(settings.preset, name, given[name], value, *(each[name] for each in usual))
    return with_values(settings, chosen)


def check_preset(preset: str, name: str, given: Any, *allowed: Any) -> None:
    """Checks that a value is one of those allowed beside a preset, the first of which it sets.

    Raises:
        InvalidInputError: it is not.
    """
    if given not in allowed:
        raise InvalidInputError(
            f"{name} is {given}, but the preset {preset} sets it to {allowed[0]}: leave out the "
            "one or the other."
        )
