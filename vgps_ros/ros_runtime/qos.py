# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The quality-of-service profiles of the graph, by name: reliable, if not said otherwise."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# Data that flows: states, commands, progress. Deep, so that a listener on a loaded machine may fall
# behind for a moment and still gets every message.
STREAM = QoSProfile(depth=1000)

# The other end of a stream of states, for a controller: it acts on the newest, never on a backlog.
NEWEST = QoSProfile(depth=1)

# The same for the sensors of a real robot, to which REP 2003 has nodes listen with best effort.
NEWEST_OF_SENSORS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

# The requests and responses of services and actions. As many calls may wait at once; of more the
# middleware drops the oldest, without a word to who waits for their answer.
CALLS = QoSProfile(depth=100)

# Diagnostics, by which nodes notice each other. A reliable reader would hold back the messages that
# follow a lost one for seconds: a working node would seem silent, and a hanging one alive.
SIGNS_OF_LIFE = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)

# The last values matter, also to nodes that start later: the distributions of several trajectories.
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

# The publisher's end of a latched topic of which only the newest value matters: policy, robot.
LATEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
