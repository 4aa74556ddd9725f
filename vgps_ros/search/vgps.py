# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Variational guided policy search, Algorithm 1 of Levine and Koltun (NIPS 2013).

It alternates between two problems until the policy reproduces what the trajectory optimiser found:

    q(ζ) ← argmin KL(q ‖ p(ζ | O, θ))    DDP on α_k c − log π_θ       (line 6)
    θ    ← argmax L(q, θ)                supervised fit to q's marginals (line 4)

"Our method samples from a Gaussian distribution around the current DDP solution, ensuring that all
samples are drawn from good parts of the state space" (section 6). Beyond the paper, the fit also
takes in states that the policy itself has visited, as long as they are near q: see
`core.visited_states`. With `visited_limit` 0 the policy is never rolled out.

Several situations may be given; each has its own q, and all train one policy (section 5).

A controller learns from many short situations, each with commands of its own. Some of them are then
replaced by new ones, where the policy goes: see `renewal`.

Both steps only descend, and a small network may end in a poor optimum, to which its trajectory then
adapts; another seed begins elsewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_fit import Targets
from vgps_ros.search.renewal import is_due, renew
from vgps_ros.search.selection import sound_step
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.search.workspace import Update, Workspace


@dataclass(frozen=True)
class VgpsUpdate(Update):
    """The result of one iteration.

    Attributes:
        replay: samples of the latest q(ζ) that were replaced, the newest last.
    """

    replay: tuple[Targets, ...]


def vgps(work: Workspace, last: VgpsUpdate | None, k: int) -> VgpsUpdate:
    """Does iteration k of Algorithm 1."""
    policy = last.policy if last else work.first_policy()  # line 1, with its solutions
    solutions = last.solutions if last else work.initial_solutions
    replay = last.replay if last else ()
    work.new_situations, work.found_situations = 0, 0
    if last and is_due(work, k):
        solutions, replaced = renew(work, solutions, policy, k)
        kept = (*replay, *replaced)
        replay = kept[max(0, len(kept) - work.settings.renew.replay) :]
    work.enter(solutions)
    # Lines 1 and 6 include line 3, since a solution comes with its marginals.
    policy = _fit_policy(work, policy, solutions, k, replay)  # line 4
    return VgpsUpdate(policy, work.reoptimize(solutions, policy, k), replay)  # lines 5 and 6


def _fit_policy(
    work: Workspace,
    policy: GaussianPolicy,
    solutions: Sequence[OptimizationResult],
    k: int,
    replay: Sequence[Targets],
) -> GaussianPolicy:
    """Returns the M-step's policy, as far as it is no worse unseen."""
    fitted = work.fit(policy, solutions, k, replay)
    taken = sound_step(work.task, work.settings, work.seed, policy, fitted, k)
    if taken is not fitted:
        share = "is not taken" if taken is policy else "is taken in part"
        work.warn(
            f"The M-step of iteration {k} {share}: after all of it far fewer rollouts would "
            "obey, or stay up."
        )
    return taken
