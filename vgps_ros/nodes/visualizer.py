# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Node `visualizer`: a headless Rerun recording of the graph, live.

`ros2 run vgps_ros bag rerun BAG` makes the same recording from a bag.
"""

from functools import partial
from pathlib import Path

from rclpy.node import Node

from vgps_ros.core.settings import Setting
from vgps_ros.messages.names import GAINS, MJCF, message_type
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare
from vgps_ros.ros_runtime.qos import LATCHED, STREAM
from vgps_ros.ros_runtime.runner import Runnable
from vgps_ros.ros_runtime.services import steady_timer
from vgps_ros.views.graph_scene import DRAWN, GraphScene, is_drawn
from vgps_ros.views.recording import UnfinishedRecordingError

OUTPUT = Setting("output", "run.rrd", "recording to write, which must not exist")

_STATES, _SOLVES = "joint_states", "iterations"
_AWAITED = f"{_STATES} from simulation"
_LATCHED = {GAINS, MJCF, "policy", "trajectory_distribution"}
_DISCOVERY_PERIOD = 0.5  # between two looks for new optimizers [s]


class Visualizer(Node):
    """Draws what passes between the nodes; a message that does not fit is left out."""

    def __init__(self) -> None:
        super().__init__("visualizer")
        path = Path(declare(self, OUTPUT))
        self._health = Health(self)
        self._scene = GraphScene(path, self._report)
        self._health.wait_for(_AWAITED)
        self._shown: set[str] = set()
        for topic, kind in DRAWN.items():
            if topic != _SOLVES:
                self._listen(topic, kind)
        steady_timer(self, _DISCOVERY_PERIOD, self._look)
        self.get_logger().info(f"Recording what is seen to {path}.")

    def close(self) -> None:
        """Completes the recording, as far as the disk takes it."""
        try:
            self._scene.close()
        except UnfinishedRecordingError as error:
            self.get_logger().error(str(error))

    def _listen(self, topic: str, kind: str) -> None:
        qos = LATCHED if topic in _LATCHED else STREAM
        self.create_subscription(message_type(kind), topic, partial(self._scene.show, topic), qos)

    def _report(self, topic: str, sentence: str | None) -> None:
        self._health.report(topic, error=sentence or "")
        if topic == _STATES and not sentence:
            self._health.arrived(_AWAITED)

    def _look(self) -> None:
        self._scene.recording.send_due()
        # Every optimizer of this namespace is listened to, whatever its name.
        for topic, kinds in self.get_topic_names_and_types():
            is_near = topic.startswith(f"{self.get_namespace().rstrip('/')}/")
            is_new = is_near and topic.endswith(_SOLVES) and topic not in self._shown
            if is_new and is_drawn(topic, kinds[0]):
                self._shown.add(topic)
                self._listen(topic, kinds[0])


NODE = Runnable(Visualizer, close=Visualizer.close)
