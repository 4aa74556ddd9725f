# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What the recorder stands: states of 12 joints at 3,000 messages/s, from another process.

    python tests/benchmarks/recorder_throughput.py [--seconds 60] [--rate 3000]

Prints messages sent and found in the bag, the recorder's memory over time, its share of a core, and
the rate at which its writer and rosbags' write the same messages, in turns and by processor time,
since other work on the machine must not decide which is faster.
"""

import argparse
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from array import array
from pathlib import Path

import rclpy
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

from vgps_ros.bags import BagWriter, MessageDefinitions
from vgps_ros.ros_runtime.qos import STREAM

KIND = "sensor_msgs/msg/JointState"
RECORDER = Path(__file__).parents[2] / "install" / "vgps_ros" / "lib" / "vgps_ros" / "recorder"


def joint_state(i: int) -> JointState:
    values = array("d", [1e-3 * i] * 12)
    names = [f"joint_{j}" for j in range(12)]
    message = JointState(name=names, position=values, velocity=values, effort=values)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(i, 10**9)
    return message


def publish(rate: float, seconds: float) -> None:
    """Publishes at a steady rate, by the clock, so that a late message does not shift the rest."""
    rclpy.init()
    node = rclpy.create_node("source")
    publisher = node.create_publisher(JointState, "joint_states", STREAM)
    while not publisher.get_subscription_count():
        time.sleep(0.05)
    time.sleep(1.0)
    message, start = joint_state(0), time.monotonic()
    for i in range(round(rate * seconds)):
        if (early := start + i / rate - time.monotonic()) > 0:
            time.sleep(early)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(i, 10**9)
        publisher.publish(message)
    elapsed = time.monotonic() - start
    print(f"{round(rate * seconds)} {elapsed}", flush=True)
    time.sleep(1.0)  # until the last ones have been taken
    rclpy.shutdown()


def status(pid: int) -> tuple[float, float]:
    """Returns resident memory [MB] and processor time [s] of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6, ticks / os.sysconf("SC_CLK_TCK")


def record(folder: Path, rate: float, seconds: float) -> bool:
    recorder = subprocess.Popen([RECORDER, "--ros-args", "-p", f"output:={folder / 'bag'}"])
    time.sleep(2.0)
    source = subprocess.Popen(
        [sys.executable, __file__, "--publish", "--rate", f"{rate}", "--seconds", f"{seconds}"],
        stdout=subprocess.PIPE,
        text=True,
    )
    memory, began = [], time.monotonic()
    _, used_before = status(recorder.pid)
    while source.poll() is None:
        memory.append(status(recorder.pid)[0])
        time.sleep(1.0)
    used = (status(recorder.pid)[1] - used_before) / (time.monotonic() - began)
    recorder.send_signal(signal.SIGINT)
    recorder.wait()
    sent, elapsed = source.stdout.read().split()
    stamps = []
    with AnyReader([folder / "bag"]) as reader:
        states = [c for c in reader.connections if c.topic == "/joint_states"]
        for connection, _, data in reader.messages(states):
            stamp = reader.deserialize(data, connection.msgtype).header.stamp
            stamps.append(stamp.sec * 10**9 + stamp.nanosec)
    quarter = len(memory) // 4
    early, late = memory[quarter : 2 * quarter], memory[-quarter:]
    print(
        f"sent {sent} in {float(elapsed):.1f} s ({int(sent) / float(elapsed):.0f}/s), "
        f"recorded {len(stamps)}, in order and each once: {stamps == list(range(int(sent)))}\n"
        f"memory {statistics.median(early):.1f} MB in the second quarter, "
        f"{statistics.median(late):.1f} MB in the last; {100 * used:.0f} % of a core"
    )
    return stamps == list(range(int(sent)))


def writing_rates(folder: Path, count: int, rounds: int) -> None:
    """Prints how fast our writer and rosbags' write the same serialized messages."""
    messages = [serialize_message(joint_state(i)) for i in range(count)]
    definition = MessageDefinitions().find(KIND)
    type_hash = get_typestore(Stores.ROS2_JAZZY).hash_rihs01(KIND)

    def ours(path: Path) -> None:
        writer = BagWriter(path)
        writer.add_topic("/joint_states", KIND, type_hash, [])
        for i, data in enumerate(messages):
            writer.write("/joint_states", i + 1, data)
        writer.close()

    def rosbags(path: Path) -> None:
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(
                "/joint_states", KIND, msgdef=definition, rihs01=type_hash
            )
            for i, data in enumerate(messages):
                writer.write(connection, i + 1, data)

    rates: dict[str, list[float]] = {"ours": [], "rosbags": []}
    for i in range(rounds):
        writers = [("ours", ours), ("rosbags", rosbags)]
        for name, write in writers[:: (-1) ** i]:  # neither always first
            path = folder / f"{name}_{i}"
            start = time.process_time()
            write(path)
            rates[name].append(count / (time.process_time() - start))
            shutil.rmtree(path)
    medians = {name: statistics.median(values) for name, values in rates.items()}
    ratios = sorted(a / b for a, b in zip(rates["ours"], rates["rosbags"], strict=True))
    print(
        f"writing: ours {medians['ours']:.0f}/s, rosbags {medians['rosbags']:.0f}/s, "
        f"ratio {statistics.median(ratios):.2f} ({ratios[0]:.2f} to {ratios[-1]:.2f})"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=3000.0)
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    parsed = parser.parse_args()
    if parsed.publish:
        publish(parsed.rate, parsed.seconds)
        return
    with tempfile.TemporaryDirectory() as folder:
        whole = record(Path(folder), parsed.rate, parsed.seconds)
        writing_rates(Path(folder), count=round(parsed.rate * parsed.seconds), rounds=7)
    sys.exit(0 if whole else 1)


if __name__ == "__main__":
    main()
