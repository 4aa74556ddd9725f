"""A bag's topics by their last names, in whatever namespace they were recorded."""

from vgps_ros.bags import BagReader
from vgps_ros.core.errors import InvalidInputError


def filled_topics(bag: BagReader) -> dict[str, str]:
    """Returns the topics that have messages, by their last names."""
    return {topic.rpartition("/")[2]: topic for topic in bag.topics if bag.counts[topic]}


def needed_topic(bag: BagReader, name: str) -> str:
    """Returns the topic of a last name.

    Raises:
        InvalidInputError: it has no messages.
    """
    topics = filled_topics(bag)
    if name not in topics:
        raise InvalidInputError(
            f"'{bag.path}' has no messages on {name}; `ros2 run vgps_ros bag info {bag.path}` "
            "shows what it has."
        )
    return topics[name]
