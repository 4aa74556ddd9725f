"""The adaptive variant of guided policy search, as section 6 compares with it.

    θ ← argmax Φ(θ) over rollouts of q(ζ) and π_θ,    q(ζ) ← argmin KL(q ‖ p(ζ | O, θ))

It "runs DDP at every iteration and adapts to the current policy, in the same manner as our method.
However, samples from this adapted DDP solution are then included in the policy optimization with
importance sampling". The solutions are those of line 6 of Algorithm 1, with the same α; their
rollouts join the initial ones and are kept as long as those of the policies.
"""

from vgps_ros.search.gps import GuidedUpdate, guided_search
from vgps_ros.search.workspace import Workspace


def adaptive_gps(work: Workspace, last: GuidedUpdate | None, k: int) -> GuidedUpdate:
    """Does iteration k of guided policy search with a DDP solution that adapts to the policy."""
    return guided_search(work, last, k, adapts=True)
