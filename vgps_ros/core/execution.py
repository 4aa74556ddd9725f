"""The control that a policy gives when it is executed; from it, a recording can be checked."""

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator


def executed_control(
    policy: GaussianPolicy, state: Array, stamp: int, seed: int | None = None
) -> Array:
    """Returns μ_θ(x), and with a seed noise that depends on it and on the time only.

    Args:
        policy: π_θ.
        state: x, shape (n_x,).
        stamp: time of the state, at least 0 [ns].
        seed: seed of the noise; None: no noise.

    Returns:
        u, shape (n_u,), [N·m].
    """
    mean = policy.mean(state)
    if seed is None:
        return mean
    rng = generator(seed, Stream.EXECUTION, stamp)
    return mean + policy.noise_std * rng.standard_normal(len(mean))
