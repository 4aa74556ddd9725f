"""What runs a node's callbacks, where rclpy's executor of one thread is not enough."""

from rclpy.executors import Executor, SingleThreadedExecutor


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
