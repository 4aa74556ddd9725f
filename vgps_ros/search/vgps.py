"""Variational guided policy search, Algorithm 1 of Levine and Koltun (NIPS 2013).

It alternates between two problems until the policy reproduces what the trajectory optimiser found:

    q(ζ) ← argmin KL(q ‖ p(ζ | O, θ))    DDP on α_k c − log π_θ       (line 6)
    θ    ← argmax L(q, θ)                supervised fit to q's marginals (line 4)

"Our method samples from a Gaussian distribution around the current DDP solution, ensuring that all
samples are drawn from good parts of the state space" (section 6); the policy is never rolled out.

Several initial states may be given; each has its own q, and all train one policy (section 5).
"""

from collections.abc import Iterator
from itertools import count

from vgps_ros.search.workspace import Update, Workspace


def vgps(work: Workspace) -> Iterator[Update]:
    """Runs Algorithm 1, yielding at the end of each iteration."""
    solutions, policy = work.initial_solutions, work.random_policy()  # line 1
    for k in count(1):  # line 2
        # Line 3 is part of lines 1 and 6: a solution comes with its marginals.
        policy = work.fit(policy, solutions, k)  # line 4
        solutions = work.reoptimize(solutions, policy, k)  # lines 5 and 6
        yield Update(policy, solutions)
