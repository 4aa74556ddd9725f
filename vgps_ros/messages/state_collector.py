# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Brings the messages of one state together, which come on several topics."""

from collections.abc import Callable, Mapping
from typing import Any

from vgps_ros.messages.conversions import nanoseconds

_PATIENCE = 1000  # incomplete states that are kept


class StateCollector:
    """Collects messages until those of one stamp make a state, in any order.

    A state that is sent again is complete again once all of its messages came again.

    Args:
        is_complete: returns True if messages by topic make a state.
    """

    def __init__(self, is_complete: Callable[[Mapping[str, Any]], bool]):
        self._is_complete = is_complete
        self._waiting: dict[int, dict[str, Any]] = {}  # by stamp [ns], the oldest first

    def add(self, topic: str, message: Any) -> dict[str, Any] | None:
        """Returns the messages of a state by topic, if this message completes it."""
        stamp = nanoseconds(message.header.stamp)
        messages = self._waiting.setdefault(stamp, {})
        messages[topic] = message
        if not self._is_complete(messages):
            if len(self._waiting) > _PATIENCE:
                del self._waiting[next(iter(self._waiting))]
            return None
        # Messages from before belong to states whose other messages were lost: topics keep order.
        for earlier in list(self._waiting):
            del self._waiting[earlier]
            if earlier == stamp:
                break
        return messages
