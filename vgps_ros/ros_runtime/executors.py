"""What runs a node's callbacks, where rclpy's executor of one thread is not enough."""

from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor


class ThreadedExecutor(MultiThreadedExecutor):
    """Waits for its callbacks, and ends its threads, which rclpy leaves to the end of Python."""

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Ends the executor; returns whether its callbacks have ended."""
        ended = super().shutdown(timeout_sec)
        self._executor.shutdown()
        return ended


def streaming_executor() -> Executor:
    """Returns what costs least for each message: rclpy's events executor, where there is one.

    It knows from the middleware what has come, where the others ask for all of a node's services,
    timers and topics anew for each message. It has one thread, and takes no guard conditions and no
    callbacks with a message's info.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:  # Jazzy as it was at first
        return SingleThreadedExecutor()
    return EventsExecutor()
