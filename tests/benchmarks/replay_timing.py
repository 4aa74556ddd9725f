# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""How well the player keeps time, and whether it loses anything: prints measured figures.

    source env.bash; python tests/benchmarks/replay_timing.py

Writes a bag of 12-joint JointStates at 500 Hz over 20 s, replays it with the real node, receives
it raw in this process. At rate 1 the timing error is the time of receipt less the time at which the
message was due, counted from the first message ("first"), and from the offset that makes the median
error zero ("median"): one late first message would shift all others. At rate 10 the messages are
counted. Nothing else should run on the machine meanwhile: how late a bare sleep wakes up on it is
printed first, and the player can do no better. Exits with 1 if a message was lost.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from array import array
from pathlib import Path

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from vgps_ros.bags import BagWriter

PLAYER = Path(__file__).parents[2] / "install" / "vgps_ros" / "lib" / "vgps_ros" / "player"
TOPIC, KIND = "/joint_states", "sensor_msgs/msg/JointState"
JOINTS = 12


def write_bag(path: Path, frequency: float, duration: float) -> np.ndarray:
    """Writes the bag; returns the times of receipt [ns]."""
    names = [f"joint_{i}" for i in range(JOINTS)]
    stamps = (10**18 + np.arange(frequency * duration) / frequency * 1e9).astype(np.int64)
    writer = BagWriter(path, compression="zstd")
    writer.add_topic(TOPIC, KIND, "", [])
    for i, stamp in enumerate(stamps):
        values = array("d", np.sin(np.arange(JOINTS) + i / frequency).tobytes())
        message = JointState(name=names, position=values, velocity=values, effort=values)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp), 10**9)
        writer.write(TOPIC, int(stamp), serialize_message(message))
    writer.close()
    return stamps


def replay(bag: Path, rate: float) -> tuple[np.ndarray, list[str]]:
    """Replays the bag; returns the times at which messages came [ns] and what the player said."""
    came: list[int] = []
    node = rclpy.create_node("replay_timing")
    node.create_subscription(
        JointState,
        TOPIC,
        lambda _: came.append(time.monotonic_ns()),
        QoSProfile(depth=20000),
        raw=True,
    )
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    arguments = ["--ros-args", "-p", f"bag:={bag}", "-p", f"rate:={rate}"]
    player = subprocess.Popen([PLAYER, *arguments], stdout=subprocess.PIPE, text=True)
    try:
        while player.poll() is None:
            executor.spin_once(timeout_sec=0.2)
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.2)
    finally:
        player.terminate()
        output = player.communicate()[0]
        executor.shutdown()
        node.destroy_node()
    return np.array(came), output.splitlines()


def sleep_errors(period: float, duration: float) -> np.ndarray:
    """Returns how late bare sleeps wake up [ms]."""
    due = time.monotonic() + period * np.arange(1, duration / period)
    late = []
    for t in due:
        time.sleep(max(0.0, t - time.monotonic()))
        late.append(1e3 * (time.monotonic() - t))
    return np.array(late)


def report(name: str, errors: np.ndarray) -> None:
    """Prints percentiles of the timing error. Shape (n,), [ms]."""
    p50, p99, largest = np.percentile(np.abs(errors), [50, 99, 100])
    print(f"  from the {name}: p50 {p50:.2f} ms, p99 {p99:.2f} ms, max {largest:.2f} ms")


def main() -> int:
    """Runs both measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frequency", type=float, default=500.0, help="of the states [Hz]")
    parser.add_argument("--duration", type=float, default=20.0, help="of the bag [s]")
    options = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", "99")
    lost = 0
    rclpy.init()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, "bag")
        stamps = write_bag(bag, options.frequency, options.duration)
        print(f"{len(stamps)} messages, {JOINTS} joints, {options.frequency:g} Hz")
        report("due time of a bare sleep", sleep_errors(1 / options.frequency, 10.0))
        for rate in (1.0, 10.0):
            came, said = replay(bag, rate)
            lost += len(stamps) - len(came)
            span = (came[-1] - came[0]) * 1e-9 if len(came) else 0.0
            print(f"rate {rate:g}: received {len(came)} of {len(stamps)} in {span:.3f} s")
            if len(came) == len(stamps):
                late = ((came - came[0]) - (stamps - stamps[0]) / rate) * 1e-6
                report("first message", late)
                report("median message", late - np.median(late))
            print(f"  {said[-1] if said else 'the player said nothing'}")
    rclpy.try_shutdown()
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
