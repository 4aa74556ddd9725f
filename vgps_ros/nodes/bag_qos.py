"""Quality of service between the graph and a bag's metadata."""

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

_DEPTH = 10_000  # messages of a topic that may wait to be written, or to be taken


def to_bag(profile: QoSProfile) -> dict[str, Any]:
    """Returns a profile as `metadata.yaml` has it, in version 9."""
    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": _time(profile.deadline),
        "lifespan": _time(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": _time(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def strongest(offered: Sequence[dict[str, Any]]) -> QoSProfile:
    """Returns the strongest profile that all publishers of a topic offer, and a deep queue."""
    latched = all(profile["durability"] == "transient_local" for profile in offered)
    reliable = all(profile["reliability"] == "reliable" for profile in offered)
    return QoSProfile(
        depth=_DEPTH,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


def _time(duration: Duration) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}
