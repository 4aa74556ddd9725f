# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The visualizer: what flows through the graph ends up in a whole recording."""

import math
import signal
import subprocess
import time

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from rerun.chunk import RrdReader
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import ResetSimulation
from vgps_msgs.msg import LearningProgress, OptimizerIteration, TrajectoryDistribution

from tests.nodes.conftest import EACH_SIGNAL, PATIENCE
from vgps_ros.messages.conversions import (
    distribution_to_msg,
    nanoseconds,
    pack,
    stamp_of,
    state_to_msg,
)
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.ros_runtime.qos import LATCHED, STREAM
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task


def rows(path, entity: str) -> int:
    chunks = (c for c in RrdReader(path).stream() if not c.is_static)
    return sum(chunk.num_rows for chunk in chunks if str(chunk.entity_path) == entity)


def start(graph, path):
    visualizer = graph.start("visualizer", output=path)
    graph.spin_until_output(visualizer, "Recording what is seen")
    graph.describe(make_task("swimmer"))
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
    graph.diagnosis("visualizer", DiagnosticStatus.ERROR, "joint_states.position of ")
    # Joints of another robot on the same topic, as a gripper's, are left out.
    states.publish(JointState(name=["knee"], position=[0.0], velocity=[0.0]))
    progress.publish(LearningProgress(iteration=1, alpha=0.5, ddp_cost=math.inf))
    graph.spin_for(0.5)
    assert visualizer.end(signal.SIGINT) == 0, visualizer.output
    assert rows(tmp_path / "run.rrd", "/joint_states/position") == 5
    assert rows(tmp_path / "run.rrd", "/learning/alpha") == 1
    assert rows(tmp_path / "run.rrd", "/learning/ddp_cost") == 0


@EACH_SIGNAL
def test_two_signals_at_once_end_it_with_a_whole_file(graph, tmp_path, number):
    visualizer = start(graph, tmp_path / "run.rrd")
    visualizer.send(number)
    visualizer.send(number)
    assert visualizer.wait() == 0, visualizer.output
    assert RrdReader(tmp_path / "run.rrd").recordings()


def test_what_optimizers_and_the_learner_say_is_recorded(
    graph, swimmer, random_policy, random_distribution, tmp_path
):
    visualizer = start(graph, tmp_path / "run.rrd")
    # Two optimizers that appear later, under names of their own.
    for name in ("first", "second"):
        solver = graph.publisher(OptimizerIteration, f"{name}/iterations", STREAM)
        for i in range(3):
            solver.publish(OptimizerIteration(iteration=i, cost=100.0 / (i + 1)))
    graph.publish_policy(random_policy(0))
    solutions = graph.publisher(TrajectoryDistribution, "trajectory_distribution", LATCHED)
    q = random_distribution(horizon=4, n_x=10, n_u=2)
    wrong = distribution_to_msg(q, swimmer.deployment, 0, 1, Time())
    wrong.state_covariances = pack(np.zeros(3))
    solutions.publish(wrong)
    graph.diagnosis("visualizer", DiagnosticStatus.ERROR, "state_covariances has 3 values")
    solutions.publish(distribution_to_msg(q, swimmer.deployment, 0, 0, Time()))
    graph.diagnosis("visualizer", DiagnosticStatus.OK)  # it has come
    assert visualizer.end(signal.SIGINT) == 0, visualizer.output
    path = tmp_path / "run.rrd"
    assert rows(path, "/solves/first") == rows(path, "/solves/second") == 3
    assert rows(path, "/policy/noise_std") == 1
    assert rows(path, "/trajectory_distribution/front_joint/0") == 5
    assert rows(path, "/trajectory_distribution/root_x/0") == 0  # metres beside radians


@pytest.mark.slow
def test_a_burst_of_states_is_recorded_whole(graph, swimmer, tmp_path):
    visualizer = start(graph, tmp_path / "run.rrd")
    # A shorter history would lose some before they are sent, where the machine is busy.
    states = graph.publisher(JointState, "joint_states", QoSProfile(depth=1000))
    for i in range(500):
        message = state_to_msg(np.full(10, 1e-3 * i), swimmer.joint_names, stamp_of(i * 10**7))
        message.effort = pack(np.zeros(5))
        states.publish(message)
        time.sleep(0.0005)  # 2 kHz: more than it can draw
    states.publish(JointState(name=["last"]))
    graph.diagnosis("visualizer", DiagnosticStatus.ERROR, "last")
    assert visualizer.end(signal.SIGTERM) == 0, visualizer.output
    for entity in ("/joint_states/position", "/joint_states/effort", "/world/robot/front"):
        assert rows(tmp_path / "run.rrd", entity) == 500


def all_rows(path) -> dict[tuple[str, bool], int]:
    found: dict[tuple[str, bool], int] = {}
    for chunk in RrdReader(path).stream():
        key = str(chunk.entity_path), chunk.is_static
        found[key] = found.get(key, 0) + chunk.num_rows
    return found


def test_live_and_from_the_bag_the_recording_is_the_same(graph, random_policy, tmp_path):
    save_policy(random_policy(0), "swimmer", tmp_path / "policy.json")
    visualizer = graph.start("visualizer", output=tmp_path / "live.rrd")
    recorder = graph.start("recorder", output=tmp_path / "bag")
    graph.spin_until_output(visualizer, "Recording what is seen")
    graph.spin_until_output(recorder, "Recording to")
    graph.start("trajectory_optimizer")
    simulation = graph.start("simulation", start_paused=True, wait_timeout=PATIENCE)
    graph.spin_until(lambda: "/joint_states" in dict(graph.node.get_topic_names_and_types()))
    graph.spin_for(1.0)  # until the recorder has found what there is
    executor = graph.start("policy_executor", policy_file=tmp_path / "policy.json")

    def listeners():
        return {i.node_name for i in graph.node.get_subscriptions_info_by_topic("joint_command")}

    graph.spin_until(lambda: {"recorder", "visualizer"} <= listeners())
    graph.spin_for(1.0)  # until the executor knows of them as well
    states = graph.messages(JointState, "joint_states")
    graph.step(100)
    graph.spin_until(lambda: nanoseconds(states[-1].header.stamp) == 100 * 20_000_000)
    graph.call(ResetSimulation, "simulation/reset_simulation")
    graph.step(100)
    # The one would repeat its torques, the other its state, while the two end.
    assert executor.end() == simulation.end() == 0
    graph.spin_for(0.5)
    assert visualizer.end(signal.SIGINT) == recorder.end(signal.SIGINT) == 0
    vgps(["bag", "rerun", str(tmp_path / "bag"), "--output", str(tmp_path / "offline.rrd")])
    live, offline = all_rows(tmp_path / "live.rrd"), all_rows(tmp_path / "offline.rrd")
    assert live == offline
    assert live["/joint_states/effort", False] >= 201
    verified = subprocess.run(
        ["rerun", "rrd", "verify", tmp_path / "live.rrd", tmp_path / "offline.rrd"], check=False
    )
    assert verified.returncode == 0
