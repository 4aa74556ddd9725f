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
adapts. So the search may begin with several candidates, each a policy with trajectories of its own;
after some iterations it keeps the candidate with the best fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_fit import Targets
from vgps_ros.search.renewal import is_due, renew
from vgps_ros.search.selection import sound_step
from vgps_ros.search.workspace import Update, Workspace


@dataclass(frozen=True)
class Candidates(Update):
    """The result of one iteration: the first candidate, until the best one is chosen.

    Attributes:
        others: the other candidates; empty after one has been chosen.
        replay: samples of the latest q(ζ) that were replaced, the newest last.
    """

    others: tuple[Update, ...]
    replay: tuple[Targets, ...] = ()

    @property
    def pairs(self) -> tuple[Update, ...]:
        """All candidates, the first one first."""
        return (self, *self.others)


def vgps(work: Workspace, last: Candidates | None, k: int) -> Candidates:
    """Does iteration k of Algorithm 1."""
    pairs: Sequence[Update] = last.pairs if last else _first(work)
    replay = last.replay if last else ()
    work.new_situations, work.found_situations = 0, 0
    if last and is_due(work, k) and len(pairs) == 1:
        renewed, replaced = renew(work, last.solutions, last.policy, k)
        pairs = [Update(last.policy, renewed)]
        kept = (*replay, *replaced)
        replay = kept[max(0, len(kept) - work.settings.renew.replay) :]
    work.enter(pairs[0].solutions)
    # Lines 1 and 6 include line 3, since a solution comes with its marginals.
    pairs = [replace(p, policy=_fit_policy(work, p, k, replay)) for p in pairs]  # line 4
    if k >= min(work.settings.candidate_iterations, work.settings.iterations):
        pairs = [max(pairs, key=_likelihood)]
    # Lines 5 and 6; the first candidate is solved last, so that the latest q(ζ) are the policy's.
    *others, first = (
        Update(p.policy, work.reoptimize(p.solutions, p.policy, k)) for p in reversed(pairs)
    )
    return Candidates(first.policy, first.solutions, tuple(reversed(others)), replay)


def _fit_policy(work: Workspace, pair: Update, k: int, replay: Sequence[Targets]) -> GaussianPolicy:
    """Returns the M-step's policy, as far as it is no worse unseen."""
    fitted = work.fit(pair.policy, pair.solutions, k, replay)
    taken = sound_step(work.task, work.settings, work.seed, pair.policy, fitted, k)
    if taken is not fitted:
        share = "is not taken" if taken is pair.policy else "is taken in part"
        work.warn(
            f"The M-step of iteration {k} {share}: after all of it far fewer rollouts would "
            "obey, or stay up."
        )
    return taken


def _first(work: Workspace) -> Sequence[Update]:  # line 1
    policies = work.first_policies(work.settings.candidates)
    return [Update(policy, work.initial_solutions) for policy in policies]


def _likelihood(pair: Update) -> float:
    """Returns L(q, θ) up to a constant: with the best noise its other terms are constant."""
    return -float(np.log(pair.policy.noise_std).sum())
