# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads, writes, checks and replays MCAP bags in the format of rosbag2."""

from vgps_ros.bags.reader import BagMessage, BagReader
from vgps_ros.bags.writer import BagWriter, MessageDefinitions

__all__ = ["BagMessage", "BagReader", "BagWriter", "MessageDefinitions"]
