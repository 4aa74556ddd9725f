# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a bag: what is in it, and how far the robot's joint states are from q(ζ)'s mean.

python examples/06_read_a_bag.py recordings/sample
"""

import sys
from pathlib import Path

import numpy as np

from vgps_ros.bags import BagReader
from vgps_ros.messages.conversions import distribution_from_msg

path = Path(sys.argv[1] if len(sys.argv) > 1 else "recordings/sample")
with BagReader(path) as bag:
    for topic, kind in sorted(bag.topics.items()):
        print(f"{bag.counts[topic]:6d}  {topic}  [{kind}]")
    states = [bag.decode(message) for message in bag.messages(["/joint_states"])]
    solutions = [bag.decode(message) for message in bag.messages(["/trajectory_distribution"])]

q = distribution_from_msg(solutions[-1])
positions = {}  # by their stamps: a state that stands is sent again
for state in states:
    stamp = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
    positions[round(stamp / solutions[-1].time_step)] = np.array(state.position)
print(f"{len(positions)} states of {', '.join(states[0].name)}")
for step in list(positions)[:: max(1, len(positions) // 10)]:
    if step < len(q.mean.states):
        away = np.abs(positions[step] - q.mean.states[step, : len(positions[step])]).max()
        print(f"{step * solutions[-1].time_step:6.2f} s: {away:.3f} away from q's mean")
