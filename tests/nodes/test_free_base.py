# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot with a free base, a ball, activations and any actuators, driven through the graph."""

import json
import signal

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rerun.chunk import RrdReader
from sensor_msgs.msg import JointState
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg

from tests.nodes.conftest import executed
from tests.simulation.robots import EVERYTHING
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.bags.episode import episodes, recorded_states
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Trajectory
from vgps_ros.messages.conversions import command_from_msg, nanoseconds, policy_to_msg, stamp_of
from vgps_ros.messages.robot_state import JOINTS, StateMessages
from vgps_ros.ros_runtime.qos import LATCHED
from vgps_ros.simulation.frames import state_layout
from vgps_ros.tasks import make_task

STEPS = 60
TASK = """
model: everything.xml
control_period: 0.01
horizon: 0.4
start: {keyframe: stand, std: {position: 0.01, velocity: 0.01}}
cost:
  - {sensor: base/z, target: 0.3}
  - {sensor: velocity, index: x, target: 0.2}
  - {control: all, weight: 0.01}
observe: [{sensor: base/z}, {sensor: up}, {sensor: gyro, index: x}, {joint: hip, as: sin_cos}]
"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("everything")
    (folder / "everything.xml").write_text(EVERYTHING)
    (folder / "task.yaml").write_text(TASK)
    return make_task(str(folder / "task.yaml"))


@pytest.fixture(scope="module")
def states(robot):
    return StateMessages(state_layout(robot.dynamics.model))


@pytest.fixture
def policy(robot, rng) -> GaussianPolicy:
    shape = Architecture(robot.observation.names, (5,), robot.dynamics.control_dim)
    parameters = 0.5 * rng.standard_normal(shape.num_parameters)
    return GaussianPolicy(shape, parameters, np.ones(4))


def test_it_is_driven_in_lock_step_recorded_checked_and_drawn(
    graph, robot, states, policy, tmp_path
):
    bag_path, drawn, figures = tmp_path / "bag", tmp_path / "run.rrd", tmp_path / "figures.json"
    recorder = graph.start("recorder", output=bag_path)
    visualizer = graph.start("visualizer", output=drawn)
    graph.spin_until_output(recorder, "Recording to")
    graph.spin_until_output(visualizer, "Recording what is seen")
    graph.publish_policy(policy, robot.name)
    graph.start("simulation", task=robot.name, start_paused=True)
    graph.start("policy_executor", task=robot.name, state_timeout=60.0)
    for topic in (*states.topics, "joint_command", "policy"):
        count = graph.node.count_subscribers
        graph.spin_until(lambda t=topic, n=count: n(t) == 3, what=f"listeners of {topic}")
    graph.spin_until(lambda: graph.node.count_subscribers("mjcf_description") == 2)
    words = ["--task", robot.name, "--steps", str(STEPS), "--json", str(figures)]
    program = graph.start_program("execute_policy", *words)
    graph.ends(program)
    assert recorder.end(signal.SIGINT) == 0, recorder.output
    assert visualizer.end(signal.SIGINT) == 0, visualizer.output

    with BagReader(bag_path) as bag:
        episode = episodes(bag, robot.dynamics.model)[-1]
        efforts = {
            nanoseconds(m[JOINTS].header.stamp): m[JOINTS].effort
            for _, m in recorded_states(bag, states)
        }
    found = check_bag(bag_path)
    assert found.wrong == found.missing == []
    assert found.counts["mean"] >= STEPS
    assert set(found.counts) <= {"mean", "safe"}
    assert found.counts.get("safe", 0) == 0
    period = round(robot.dynamics.time_step * 1e9)

    motion, controls = episode.states[: STEPS + 1], episode.controls[1 : STEPS + 1]
    assert len(motion) == STEPS + 1
    for t in range(STEPS):  # bit for bit what the simulation makes of what its messages said
        after = robot.dynamics.step(motion[t], controls[t])
        assert states.join(states.split(after, Time())).tobytes() == motion[t + 1].tobytes()
        # The slow knee's force follows its control through a filter; the tendon pulls both.
        assert not np.allclose(efforts[(t + 1) * period], controls[t][:2])
    assert np.ptp(motion[:, 0]) > 1e-3
    cost = json.loads(figures.read_text())["cost"]
    assert cost == robot.trajectory_cost(Trajectory(motion, controls))

    at = []
    for chunk in RrdReader(drawn).stream():
        if str(chunk.entity_path) == "/odom/position" and not chunk.is_static:
            table = chunk.to_record_batch()
            [name] = [n for n in table.schema.names if n.endswith("scalars")]
            at += [row for row in table.column(name).to_pylist() if row]
    assert {tuple(x[:3]) for x in motion} <= {tuple(row) for row in at}


def test_a_state_is_answered_once_whatever_the_order_of_its_messages(graph, robot, states, policy):
    commands = graph.messages(JointState, "joint_command")
    policies = graph.node.create_publisher(GaussianPolicyMsg, "policy", LATCHED)
    executor = graph.start("policy_executor", task=robot.name, state_timeout=60.0)
    publishers = {t: graph.publisher(kind, t) for t, kind in states.topics.items()}
    waited_for = "odom and multi_dof_joint_states and activations and joint_states"
    graph.diagnosis("policy_executor", DiagnosticStatus.OK, f"Waiting for {waited_for}")
    policies.publish(policy_to_msg(policy, robot.name, 1, Time()))

    period = round(1e9 * robot.dynamics.time_step)

    def send(step, topics):
        messages = states.split(robot.initial_state, stamp_of(step * period))
        for topic in topics:
            publishers[topic].publish(messages[topic])

    topics = list(states.topics)
    graph.spin_until(lambda: send(0, topics) or graph.spin_for(0.2) or commands, what="an answer")
    graph.spin_for(0.5)
    commands.clear()
    for stamp, order in enumerate((topics, topics[::-1], topics[2:] + topics[:2]), start=1):
        send(stamp, order)
        graph.spin_until(lambda n=stamp: len(commands) >= n, what="an answer")
    send(9, topics[1:])  # no odometry
    graph.spin_for(0.5)
    assert [nanoseconds(m.header.stamp) for m in commands] == [period, 2 * period, 3 * period]
    wanted = executed(
        policy, robot.observation(states.join(states.split(robot.initial_state, Time())))
    )
    for message in commands:
        given = command_from_msg(message, robot.controls)
        np.testing.assert_array_equal(given, wanted)

    messages = states.split(robot.initial_state, stamp_of(10 * period))
    messages["odom"] = Odometry(header=messages["odom"].header, child_frame_id="base_link")
    for topic in topics:
        publishers[topic].publish(messages[topic])
    graph.diagnosis("policy_executor", DiagnosticStatus.ERROR, "odom.child_frame_id is 'base_link'")
    assert executor.running


def test_a_start_that_is_no_rotation_is_refused(graph, robot):
    start = robot.initial_state.tolist()
    start[3] = 0.5
    simulation = graph.start("simulation", task=robot.name, initial_state=start)
    assert simulation.wait() == 1
    assert "orientation of base has the length 0.5" in simulation.output
    assert "Traceback" not in simulation.output
