"""The visualizer: what flows through the graph ends up in a whole recording."""

import math
import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rerun.chunk import RrdReader
from sensor_msgs.msg import JointState
from vgps_msgs.msg import LearningProgress

from vgps_ros.nodes.conversions import stamp_of, state_to_msg
from vgps_ros.nodes.qos import STREAM


def rows(path, entity: str) -> int:
    chunks = (c for c in RrdReader(path).stream() if not c.is_static)
    return sum(chunk.num_rows for chunk in chunks if str(chunk.entity_path) == entity)


def start(graph, path):
    visualizer = graph.start("visualizer", output=path, task="swimmer")
    graph.spin_until_output(visualizer, "Recording what is seen")
    return visualizer


def test_states_and_progress_are_recorded_and_bad_states_left_out(graph, swimmer, tmp_path):
    visualizer = start(graph, tmp_path / "run.rrd")
    states = graph.publisher(JointState, "joint_states", STREAM)
    progress = graph.publisher(LearningProgress, "learning_progress", STREAM)
    good = [
        state_to_msg(np.full(10, 0.1 * i), swimmer.joint_names, stamp_of(i * 20_000_000))
        for i in range(5)
    ]
    for message in [good[0], good[0], *good[1:]]:  # a repeated state counts once
        states.publish(message)
    bad = JointState(name=swimmer.joint_names, position=[math.nan] * 5, velocity=[0.0] * 5)
    states.publish(bad)
    graph.diagnosis("visualizer", DiagnosticStatus.ERROR, "joint_states.position is nan")
    states.publish(JointState(name=["knee"], position=[0.0], velocity=[0.0]))
    graph.diagnosis("visualizer", DiagnosticStatus.ERROR, "knee")
    progress.publish(LearningProgress(iteration=1, alpha=0.5, ddp_cost=math.inf))
    graph.spin_for(0.5)
    assert visualizer.end(signal.SIGINT) == 0, visualizer.output
    assert rows(tmp_path / "run.rrd", "/joint_states/position") == 5
    assert rows(tmp_path / "run.rrd", "/learning/alpha") == 1
    assert rows(tmp_path / "run.rrd", "/learning/ddp_cost") == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_two_signals_at_once_end_it_with_a_whole_file(graph, tmp_path, number):
    visualizer = start(graph, tmp_path / "run.rrd")
    visualizer.send(number)
    visualizer.send(number)
    assert visualizer.wait() == 0, visualizer.output
    assert RrdReader(tmp_path / "run.rrd").recordings()


def test_an_existing_file_is_refused_and_left_alone(graph, tmp_path):
    (tmp_path / "run.rrd").write_text("mine")
    visualizer = graph.start("visualizer", output=tmp_path / "run.rrd")
    assert visualizer.wait() == 1
    assert "exists already; name another file" in visualizer.output
    assert (tmp_path / "run.rrd").read_text() == "mine"
