"""The control that an executed policy gives; recorded torques are checked against it."""

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator


def executed_control(
    policy: GaussianPolicy, state: Array, stamp: int, seed: int | None = None
) -> Array:
    """Returns μ_θ(x), plus noise that depends only on the seed and the time if a seed is given.

    Args:
        policy: π_θ.
        state: x, shape (n_x,).
        stamp: time of the state, at least 0 [ns].
        seed: seed of the noise; None for no noise.

    Returns:
        u, shape (n_u,), [N·m].
    """
    mean = policy.mean(state)
    if seed is None:
        return mean
    rng = generator(seed, Stream.EXECUTION, stamp)
    return mean + policy.noise_std * rng.standard_normal(len(mean))
