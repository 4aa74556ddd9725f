# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Quality of service between the graph and a bag's metadata."""

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

_TAKEN_DEPTH = 10_000  # messages of a topic that may wait to be written
_SENT_DEPTH = 1000  # messages of a topic that may wait to be acknowledged
_LATCHED_DEPTH = 10  # messages of a latched topic that those who come later get


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


def recording(offered: Sequence[dict[str, Any]]) -> QoSProfile:
    """Returns the strongest profile that all publishers of a topic offer, for a subscription."""
    latched = all(profile["durability"] == "transient_local" for profile in offered)
    reliable = all(profile["reliability"] == "reliable" for profile in offered)
    return _profile(_TAKEN_DEPTH, latched, reliable)


def replaying(offered: Sequence[dict[str, Any]]) -> QoSProfile:
    """Returns a profile that matches whom any of the recorded publishers matched."""
    reliable = not offered or any(p["reliability"] != "best_effort" for p in offered)
    latched = any(p["durability"] == "transient_local" for p in offered)
    return _profile(_LATCHED_DEPTH if latched else _SENT_DEPTH, latched, reliable)


def _profile(depth: int, latched: bool, reliable: bool) -> QoSProfile:
    return QoSProfile(
        depth=depth,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


def _time(duration: Duration) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration.nanoseconds, 10**9)
    return {"sec": seconds, "nsec": nanoseconds}
