"""MCAP bags as rosbag2 has them."""

from vgps_ros.bags.definitions import MessageDefinitions
from vgps_ros.bags.reader import BagMessage, BagReader
from vgps_ros.bags.writer import BagWriter

__all__ = ["BagMessage", "BagReader", "BagWriter", "MessageDefinitions"]
