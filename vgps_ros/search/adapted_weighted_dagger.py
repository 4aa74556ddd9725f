"""Weighted DAGGER with an oracle that adapts to the policy, as section 6 compares with it.

    θ ← argmax of weighted DAGGER's objective,    q(ζ) ← argmin KL(q ‖ p(ζ | O, θ))

"We also implemented an adapted variant, where the DDP solution is re-optimized at each iteration to
match the policy (in addition to weighting)." The solutions are those of line 6 of Algorithm 1, with
the same α; the current solution gives the actions and weights of the whole dataset.
"""

from functools import partial

from vgps_ros.search.dagger import Imitation, imitate
from vgps_ros.search.weighted_dagger import marginal_log_weights
from vgps_ros.search.workspace import Workspace


def adapted_weighted_dagger(work: Workspace, last: Imitation | None, k: int) -> Imitation:
    """Does iteration k of DAGGER on a weighted dataset, with solutions that adapt to the policy."""
    weigh = partial(marginal_log_weights, observed=work.task.observed)
    return imitate(work, last, k, weigh, adapts=True)
