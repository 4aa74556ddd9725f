# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A full disk under the recorder and the visualizer, and signals while a bag is written."""

import os
import resource
import signal
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

from vgps_ros.bags.repair import repair
from vgps_ros.messages.conversions import pack, stamp_of, state_to_msg
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.tasks import make_task

BLOB = UInt8MultiArray(data=bytes(20_000))


def limit(process, size: float) -> None:
    """Forbids a running process to write files beyond a size [bytes]: as a full disk."""
    resource.prlimit(process._process.pid, resource.RLIMIT_FSIZE, (int(size), -1))


def stamps(path: Path) -> list[int]:
    with AnyReader([path]) as reader:
        states = [c for c in reader.connections if c.topic == "/joint_states"]
        return [
            deserialize_message(bytes(data), JointState).header.stamp.sec
            for _, _, data in reader.messages(states)
        ]


class Source:
    """Publishes numbered states and large messages."""

    def __init__(self, graph):
        self.count = 0
        self._states = graph.publisher(JointState, "joint_states", STREAM)
        self._blobs = graph.publisher(UInt8MultiArray, "blobs", STREAM)

    def publish(self, count: int) -> None:
        for _ in range(count):
            message = JointState(name=["a"], position=[0.0])
            message.header.stamp.sec = self.count
            self.count += 1
            self._states.publish(message)
            self._blobs.publish(BLOB)
            time.sleep(0.002)

    @contextmanager
    def running(self):
        """Publishes in a thread, so that there is always something on its way."""
        is_over = threading.Event()

        def publish() -> None:
            while not is_over.is_set():
                self.publish(1)

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            yield
        finally:
            is_over.set()
            thread.join()


def start(graph, path: Path, **parameters):
    recorder = graph.start("recorder", output=path, **parameters)
    graph.spin_until_output(recorder, "Recording to")
    return recorder


def value(status: DiagnosticStatus, key: str) -> int:
    return int(next(v.value for v in status.values if v.key == key))


@pytest.mark.parametrize("room", [0, 100_000])
def test_a_full_disk_is_said_others_notice_nothing_and_what_came_before_is_kept(
    graph, tmp_path, room
):
    path = tmp_path / "bag"
    recorder = start(graph, path, cache_size=1.0)
    source = Source(graph)
    executor = graph.start("policy_executor", autostart=False)  # it listens to the states, too
    source.publish(50)
    graph.spin_for(1.0)
    limit(recorder, sum(f.stat().st_size for f in path.iterdir()) + room)
    source.publish(300)  # 6 MB
    full = graph.diagnosis("recorder", DiagnosticStatus.ERROR, "Cannot write to")
    for part in (str(path / "bag_0.mcap"), "make room on the disk"):
        assert part in full.message
    lost = value(full, "messages_lost")
    assert lost > 0
    assert graph.diagnosis("policy_executor", DiagnosticStatus.OK)
    assert executor.running
    assert recorder.end(signal.SIGTERM) == 0, recorder.output
    assert "Traceback" not in recorder.output
    assert "messages are lost" in recorder.output
    if repair(path):
        assert "could not be completed" in recorder.output
    recorded = stamps(path)
    assert recorded == list(range(len(recorded)))
    assert len(recorded) >= 50


@pytest.mark.slow
def test_signals_at_any_time_leave_a_whole_bag(graph, tmp_path):
    seed = int.from_bytes(os.urandom(4), "little")
    print(f"seed {seed}")
    random = np.random.default_rng(seed)
    for i in range(4):
        path = tmp_path / f"bag_{i}"
        recorder = start(graph, path, max_file_size=random.choice([0.0, 1.0]))
        source = Source(graph)
        with source.running():
            graph.spin_for(random.uniform(0.2, 1.5))
            recorder.send(signal.SIGTERM)
            if random.random() < 0.75:  # a second one, most likely while the bag is closed
                time.sleep(random.uniform(0.0, 0.1))
                recorder.send(random.choice([signal.SIGINT, signal.SIGTERM]))
            assert recorder.wait() == 0, recorder.output
        assert repair(path) == {}
        recorded = stamps(path)
        assert recorded == list(range(recorded[0], recorded[0] + len(recorded)))


@pytest.mark.slow
def test_on_a_full_disk_the_visualizer_ends_with_a_sentence(graph, swimmer, tmp_path):
    path = tmp_path / "run.rrd"
    visualizer = graph.start("visualizer", output=path)
    graph.spin_until_output(visualizer, "Recording what is seen")
    graph.describe(make_task("swimmer"))
    states = graph.publisher(JointState, "joint_states", STREAM)
    limit(visualizer, 20_000)
    for i in range(200):
        state = state_to_msg(np.full(10, 1e-3 * i), swimmer.joint_names, stamp_of(i * 10**7))
        state.effort = pack(np.zeros(5))
        states.publish(state)
        graph.spin_for(0.002)
    assert visualizer.end(signal.SIGTERM) == 0, visualizer.output
    assert "lacks its end" in visualizer.output
    assert "Traceback" not in visualizer.output
