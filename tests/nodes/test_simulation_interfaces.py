# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A client of the ROS standard simulation_interfaces, which knows nothing but its types."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Twist, Vector3
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from simulation_interfaces import srv
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import SimulatorFeatures

from tests.nodes.conftest import EACH_SIGNAL
from tests.nodes.simulation_calls import FAILED, LISTS, OK, ROBOT, ROWS, SET, STATES, at, to
from vgps_ros.messages.conversions import command_to_msg, nanoseconds, state_from_msg
from vgps_ros.ros_runtime.qos import STREAM

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "simulation_interfaces.md"
OWN = "-r /clock:=clock -r /tf:=tf -r /tf_static:=tf_static"
HAS = SimulatorFeatures
FEATURES = {
    HAS.ENTITY_CATEGORIES, HAS.ENTITY_STATE_GETTING, HAS.ENTITY_INFO_GETTING,
    HAS.SIMULATION_RESET, HAS.SIMULATION_RESET_TIME, HAS.SIMULATION_RESET_STATE,
    HAS.SIMULATION_STATE_GETTING, HAS.SIMULATION_STATE_SETTING, HAS.SIMULATION_STATE_PAUSE,
    HAS.STEP_SIMULATION_SINGLE, HAS.STEP_SIMULATION_MULTIPLE, HAS.STEP_SIMULATION_ACTION,
}  # fmt: skip


class Client:
    """Calls one simulation, in a namespace of its robot's name."""

    def __init__(self, graph, robot):
        self.graph, self.robot = graph, robot
        self.clients: dict[str, Any] = {}

    def call(self, name, **fields):
        kind = getattr(srv, "".join(word.title() for word in name.split("_")))
        if name not in self.clients:
            path = f"{self.robot}/simulation/{name}".lstrip("/")
            self.clients[name] = self.graph.node.create_client(kind, path)
            self.graph.spin_until(self.clients[name].service_is_ready, what=path)
        future = self.clients[name].call_async(kind.Request(**fields))
        self.graph.spin_until(future.done, what=f"the answer of {name}")
        return future.result()

    def set(self, state):
        return self.call("set_simulation_state", **to(STATES[state])).result

    def lead_to(self, state):
        """Stops, and then plays and pauses, as far as it must."""
        for step in list(STATES)[: STATES[state] + 1]:
            self.set(step)
        assert self.call("get_simulation_state").state.state == STATES[state]

    def goal(self, steps, feedback=lambda _: None):
        """Returns the handle of an accepted goal."""
        path = f"{self.robot}/simulation/simulate_steps".lstrip("/")
        client = ActionClient(self.graph.node, SimulateSteps, path)
        self.graph.spin_until(client.server_is_ready, what=path)
        sent = client.send_goal_async(
            SimulateSteps.Goal(steps=steps), feedback_callback=lambda m: feedback(m.feedback)
        )
        self.graph.spin_until(sent.done, what="an answer to the goal")
        assert sent.result().accepted
        return sent.result()

    def outcome(self, goal):
        """Waits for the end of a goal; returns its status, and its result's code and sentence."""
        future = goal.get_result_async()
        self.graph.spin_until(future.done, what="the goal's result")
        result = future.result().result.result
        return future.result().status, result.result, result.error_message


@pytest.fixture(scope="module")
def clients(shared_graph):
    """A simulation of a robot without a free base, and one of a robot that has one."""
    for robot in ("swimmer", "quadruped"):
        names = f"-r __ns:=/{robot} {OWN} -p task:={robot} -p start_paused:=true"
        shared_graph.start("simulation", "--ros-args", *names.split())
    return {robot: Client(shared_graph, robot) for robot in ("swimmer", "quadruped")}


@pytest.fixture
def alone(graph):
    """A simulation without a controller, which soon gives up to wait for one."""
    process = graph.start("simulation", start_paused=True, wait_timeout=0.5)
    return process, Client(graph, "")


@pytest.mark.parametrize("row", ROWS, ids=lambda r: f"{r.service}, {r.when}: {r.call}")
def test_a_call_is_answered_as_the_table_says(clients, row):
    client = clients[row.robot]
    client.lead_to(row.when)
    response = client.call(row.service, **row.request)
    assert response.result.result == row.code, response
    assert bool(response.result.error_message) == (row.code != OK)
    if row.service in LISTS and row.code == OK:
        assert response.entities == ([row.sentence] if row.sentence else [])
        assert row.service == "get_entities" or len(response.states) == len(response.entities)
    else:
        assert row.sentence in response.result.error_message
    if row.service == "set_simulation_state":
        wanted = row.request["state"].state if row.code == OK else STATES[row.when]
        assert client.call("get_simulation_state").state.state == wanted


def test_the_page_has_these_rows():
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    rows = [f"| `{r.service}` | {r.when} | {r.call} | {r.answer} |" for r in ROWS]
    assert [line for line in lines if line.count("|") == 5] == rows


def test_the_features_are_the_truth(clients):
    """What is not among them is not served, or refused by a row of the table."""
    found = {r: set(c.call("get_simulator_features").features.features) for r, c in clients.items()}
    assert found == {"swimmer": FEATURES, "quadruped": FEATURES | {HAS.ENTITY_STATE_SETTING}}
    services = dict(clients["swimmer"].graph.node.get_service_names_and_types_by_node(
        "simulation", "/swimmer"))  # fmt: skip
    served = {kinds[0] for kinds in services.values()}
    ours = {t for t in served if t.startswith("simulation_interfaces/srv")}
    assert ours == {f"simulation_interfaces/srv/{name}" for name in (
        "GetEntities", "GetEntitiesStates", "GetEntityInfo", "GetEntityState",
        "GetSimulationState", "GetSimulatorFeatures", "ResetSimulation", "SetEntityState",
        "SetSimulationState", "StepSimulation")}  # fmt: skip


def test_the_robots_state_is_told_as_it_was_set(clients):
    client = clients["quadruped"]
    client.lead_to("paused")
    twist = Twist(linear=Vector3(x=0.3, z=-0.1), angular=Vector3(y=0.5, z=2.0))
    wanted = at(twist=twist)
    assert client.call("set_entity_state", **wanted).result.result == OK
    found = client.call("get_entity_state", entity="quadruped").state
    assert found.header.frame_id == "world"

    def numbers(state):
        at, rotation = state.pose.position, state.pose.orientation
        vectors = at, state.twist.linear, state.twist.angular
        values = [(v.x, v.y, v.z) for v in vectors]
        return np.array([*np.ravel(values), rotation.w, rotation.x, rotation.y, rotation.z])

    np.testing.assert_allclose(numbers(found), numbers(wanted["state"]), atol=1e-12)
    (listed,) = client.call("get_entities_states").states
    assert listed == found
    # Nothing touches it, so that it falls; its torques are zero, but its joints are springs.
    assert found.acceleration.linear.z == pytest.approx(-9.81, abs=5.0)
    info = client.call("get_entity_info", entity="quadruped").info
    assert info.category.category == ROBOT
    assert "trunk" in info.description


def test_a_goal_tells_of_each_step_and_ends_after_the_last(graph, swimmer):
    graph.start("simulation", start_paused=True)
    client, told = Client(graph, ""), []
    states = graph.messages(JointState, "joint_states")
    commands = graph.publisher(JointState, "joint_command")
    goal = client.goal(3, lambda f: told.append((f.completed_steps, f.remaining_steps)))
    graph.spin_until(lambda: goal.status == GoalStatus.STATUS_ACCEPTED)
    assert client.call("get_simulation_state").state.state == STATES["playing"]
    assert client.call("step_simulation").result.error_message.startswith(
        "The simulation is stepping already"
    )

    def answer(message):
        controls = swimmer.controls
        commands.publish(command_to_msg(np.ones(2), controls, message.header.stamp))

    graph.node.create_subscription(JointState, "joint_states", answer, STREAM)
    # Before the result is asked for, after which rclpy hands on no feedback.
    graph.spin_until(lambda: len(told) == 3, what="the feedback")
    assert client.outcome(goal) == (GoalStatus.STATUS_SUCCEEDED, OK, "")
    assert told == [(1, 2), (2, 1), (3, 0)]
    assert client.call("get_simulation_state").state.state == STATES["paused"]
    expected = swimmer.initial_state
    for _ in range(3):
        expected = swimmer.dynamics.step(expected, np.ones(2))
    last = next(s for s in states if nanoseconds(s.header.stamp) == 60_000_000)
    np.testing.assert_array_equal(state_from_msg(last, swimmer.joint_names), expected)


def test_a_goal_can_be_cancelled_and_another_one_follows(clients):
    client = clients["swimmer"]
    client.lead_to("paused")
    for _ in range(2):
        goal = client.goal(2**64 - 1)
        cancelled = goal.cancel_goal_async()
        client.graph.spin_until(cancelled.done)
        assert len(cancelled.result().goals_canceling) == 1
        status, code, sentence = client.outcome(goal)
        assert (status, code) == (GoalStatus.STATUS_CANCELED, FAILED)
        assert "cancelled" in sentence
        assert client.call("get_simulation_state").state.state == STATES["paused"]


@pytest.mark.parametrize(
    ("state", "steps", "words"),
    [("playing", 1, "is playing; it must be paused"), ("paused", 0, "steps is 0")],
)
def test_a_goal_that_cannot_be_is_aborted_with_a_sentence(clients, state, steps, words):
    client = clients["swimmer"]
    client.lead_to(state)
    status, code, sentence = client.outcome(client.goal(steps))
    assert (status, code) == (GoalStatus.STATUS_ABORTED, FAILED)
    assert words in sentence


def test_steps_that_no_controller_answers_end_with_a_sentence(alone):
    _, client = alone
    answer = client.call("step_simulation", steps=2).result
    assert answer.result == FAILED
    assert "No joint_command answers the state of 0 s" in answer.error_message
    assert "mode:=real_time" in answer.error_message
    status, code, sentence = client.outcome(client.goal(2))
    assert (status, code) == (GoalStatus.STATUS_ABORTED, FAILED)
    assert sentence == answer.error_message
    assert client.call("get_simulation_state").state.state == STATES["paused"]


def test_in_real_time_steps_are_done_without_a_controller(graph):
    graph.start("simulation", start_paused=True, mode="real_time")
    client = Client(graph, "")
    assert client.call("step_simulation", steps=3).result.result == OK
    state = client.call("get_entity_state", entity="swimmer").state
    assert state.header.stamp.nanosec == 60_000_000


def test_what_diverged_plays_again_only_after_a_reset(graph, swimmer):
    graph.start("simulation", start_paused=True)
    client = Client(graph, "")
    states = graph.messages(JointState, "joint_states")
    commands = graph.publisher(JointState, "joint_command")
    goal = client.goal(5)
    graph.spin_until(lambda: states)
    torques = np.array([1e9, 0.0])
    stamp = states[0].header.stamp
    commands.publish(command_to_msg(torques, swimmer.controls, stamp))
    status, code, sentence = client.outcome(goal)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, FAILED)
    assert "The state diverged at 0 s" in sentence
    refused = client.set("playing")
    assert (refused.result, refused.error_message) == (SET.STATE_TRANSITION_ERROR, sentence)
    assert client.call("step_simulation").result.error_message == sentence
    assert client.call("reset_simulation", scope=1).result.result == OK  # the time alone
    assert client.set("playing").result == SET.STATE_TRANSITION_ERROR
    assert client.call("reset_simulation").result.result == OK
    assert client.set("playing").result == OK


def test_to_quit_ends_the_node_well_and_its_goal_too(alone):
    process, client = alone
    goal = client.goal(5)
    assert client.set("quitting").result == OK
    again = client.call("set_simulation_state", **to(STATES["playing"])).result
    assert (again.result, "quitting" in again.error_message) == (SET.INCORRECT_TRANSITION, True)
    status, code, sentence = client.outcome(goal)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, FAILED)
    assert "set to quitting" in sentence
    assert process.wait() == 0
    assert "Traceback" not in process.output


@EACH_SIGNAL
def test_a_signal_ends_it_with_code_0_while_a_goal_is_at_work(graph, number):
    process = graph.start("simulation", start_paused=True)
    Client(graph, "").goal(5)
    assert process.end(number) == 0, process.output
    assert "Traceback" not in process.output
