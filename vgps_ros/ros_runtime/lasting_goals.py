# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""An action server whose goals last until they are told to end, with no callback that waits.

rclpy's way is a callback that returns at the end of its goal. In a node of one thread it would have
to be a coroutine, and while one waits the events executor resumes it over and over, which takes a
whole core. `notify_execute`, in which rclpy hands a goal to its callback, is public, but nothing
describes it: tests/nodes/test_private_names.py tells when a release of rclpy works in another way.
"""

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle

Goal = ServerGoalHandle


class LastingGoals(ActionServer):
    """Accepts goals, begins each of them, and ends it with its result.

    Args:
        begin: begins a goal; `end` is called with it later.
        options: those of rclpy's action server, beside the callback.
    """

    def __init__(
        self, node: Any, kind: Any, name: str, begin: Callable[[Goal], None], **options: Any
    ):
        self._begin = begin
        super().__init__(node, kind, name, lambda _: None, **options)

    def notify_execute(
        self, goal_handle: Goal, execute_callback: Callable[[Goal], Any] | None
    ) -> None:
        """Begins a goal that rclpy would execute now."""
        self._begin(goal_handle)

    def end(self, goal: Goal, result: Any, *, is_good: bool) -> None:
        """Ends a goal as soon as the executor turns to it, also one that was to be cancelled."""

        def told(_: Goal) -> Any:
            if is_good:  # the wish to cancel it may have come too late
                goal.succeed()
            elif goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
            return result

        super().notify_execute(goal, told)
