"""Variational guided policy search, Algorithm 1 of Levine and Koltun (NIPS 2013).

It alternates between two problems until the policy reproduces what the trajectory optimiser found:

    q(ζ) ← argmin KL(q ‖ p(ζ | O, θ))    DDP on α_k c − log π_θ       (line 6)
    θ    ← argmax L(q, θ)                supervised fit to q's marginals (line 4)

"Our method samples from a Gaussian distribution around the current DDP solution, ensuring that all
samples are drawn from good parts of the state space" (section 6); the policy is never rolled out.

Several initial states may be given; each has its own q, and all train one policy (section 5).
"""

from vgps_ros.search.workspace import Update, Workspace


def vgps(work: Workspace, last: Update | None, k: int) -> Update:
    """Does iteration k of Algorithm 1."""
    last = last or Update(work.random_policy(), work.initial_solutions)  # line 1
    # Line 3 is part of lines 1 and 6: a solution comes with its marginals.
    policy = work.fit(last.policy, last.solutions, k)  # line 4
    solutions = work.reoptimize(last.solutions, policy, k)  # lines 5 and 6
    return Update(policy, solutions)
