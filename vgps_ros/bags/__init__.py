"""MCAP bags as rosbag2 has them."""

from vgps_ros.bags.definitions import MessageDefinitions
from vgps_ros.bags.writer import BagWriter

__all__ = ["BagWriter", "MessageDefinitions"]
