# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The node `policy_executor`, alone and with the real simulation."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.msg import RobotModel

from tests.messages.test_robot_state import measured
from tests.nodes.conftest import EACH_SIGNAL, PATIENCE, Hardware, executed
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.messages.conversions import (
    command_from_msg,
    nanoseconds,
    policy_to_msg,
    stamp_of,
    state_from_msg,
    state_to_msg,
)
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.ros_runtime.qos import LATCHED
from vgps_ros.simulation.frames import state_layout
from vgps_ros.storage.run_folder import save_policy

PERIOD = 20_000_000  # of the swimmer's control [ns]
ONES = np.ones(10)
READ = np.ones(9)  # what the policy reads of them


class Controller(Hardware):
    """The executor as a robot sees it."""

    def __init__(self, graph, task):
        super().__init__(graph, task)
        self.policies = graph.publisher(GaussianPolicyMsg, "policy", LATCHED)
        graph.spin_until(self.states.get_subscription_count)

    def follow(self, policy):
        """Publishes a policy and waits until it drives."""
        self.policies.publish(policy_to_msg(policy, self.task.name, 1, Time()))
        self.graph.spin_until(lambda: np.array_equal(self.answer(ONES), executed(policy, READ)))


@pytest.fixture(scope="module")
def process(shared_graph):
    return shared_graph.start("policy_executor")


@pytest.fixture(scope="module")
def shared_controller(shared_graph, process, swimmer):
    controller = Controller(shared_graph, swimmer)
    shared_graph.diagnosis("policy_executor", DiagnosticStatus.OK, "Waiting for joint_states")
    return controller


@pytest.fixture
def controller(shared_controller, process, random_policy):
    """The same process for all tests, with the policy of seed 0."""
    shared_controller.follow(random_policy(0))
    yield shared_controller
    assert process.running


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"task": "walker"}, "the policy's task is 'walker', but it must be one of swimmer"),
        ({"parameters": [1.0, 2.0]}, "policy.parameters has 2 values"),
        ({"robot": RobotModel(digest="0" * 64)}, "it is for another model: its digest is '000000"),
        ({"robot": RobotModel(controls=["hip"])}, "its controls[0] is 'hip', but here it is 'fro"),
        ({"robot": RobotModel(format=9)}, "it has the format 9, but this version reads formats"),
        ({"noise_std": [1.0, float("nan")]}, "policy.noise_std is nan"),
        ({"activation": "sine"}, "activation is 'sine'"),
        ({"observed": list("abcdefghi")}, "but the task's policies read root_y/position, "),
        ({"observed": ["a"] * 9}, "but it may read each only once"),
        ({"layer_sizes": [9, 5, 3]}, "policy.parameters has"),
        ({"layer_sizes": []}, "layer_sizes"),
    ],
)
def test_an_invalid_policy_is_refused_and_the_old_one_stays(
    controller, random_policy, change, sentence
):
    message = policy_to_msg(random_policy(1), "swimmer", 1, Time())
    for name, wrong in change.items():
        setattr(message, name, wrong)
    controller.policies.publish(message)
    controller.graph.diagnosis("policy_executor", DiagnosticStatus.ERROR, sentence)
    np.testing.assert_array_equal(controller.answer(ONES), executed(random_policy(0), READ))


def test_noise_depends_on_the_seed_and_the_time_only(controller, random_policy):
    graph, policy = controller.graph, random_policy(0)
    assert graph.set_parameter("policy_executor", "stochastic", True).successful
    assert graph.set_parameter("policy_executor", "seed", 3).successful
    for step in (5, 0, 5):
        noise = generator(3, Stream.EXECUTION, step * PERIOD).standard_normal(2)
        np.testing.assert_array_equal(
            controller.answer(ONES, step * PERIOD),
            executed(policy, READ) + policy.noise_std * noise,
        )
    refused = graph.set_parameter("policy_executor", "seed", -1)
    assert not refused.successful
    assert "seed" in refused.reason
    assert graph.set_parameter("policy_executor", "stochastic", False).successful


def test_deactivated_it_gives_no_torques_and_keeps_taking_policies(controller, random_policy):
    assert controller.graph.change(Transition.TRANSITION_DEACTIVATE)
    controller.commands.clear()
    controller.send(ONES)
    controller.graph.spin_for(0.5)
    assert not controller.commands
    controller.policies.publish(policy_to_msg(random_policy(1), "swimmer", 2, Time()))
    controller.graph.spin_for(0.3)
    assert controller.graph.change(Transition.TRANSITION_ACTIVATE)
    np.testing.assert_array_equal(controller.answer(ONES), executed(random_policy(1), READ))


def test_a_driver_of_best_effort_is_named_with_what_to_set(graph, swimmer, random_policy):
    graph.start("policy_executor")
    graph.node.create_publisher(JointState, "joint_states", qos_profile_sensor_data)
    graph.publish_policy(random_policy(0))
    graph.diagnosis(
        *("policy_executor", DiagnosticStatus.ERROR),
        "/test sends /joint_states by best effort, but this node takes it reliably only, so that "
        "nothing arrives; start it with state_qos:=sensor_data.",
    )


def test_torques_go_to_ros2_control_as_a_plain_array(graph, swimmer, random_policy):
    graph.start("policy_executor", command_type="float64_multi_array")
    robot, policy = Hardware(graph, swimmer), random_policy(0)
    robot.commands = graph.messages(Float64MultiArray, "commands")
    graph.publish_policy(policy)
    graph.spin_until(lambda: robot.send(ONES) or graph.spin_for(0.05) or robot.commands)
    np.testing.assert_array_equal(robot.commands[-1].data, executed(policy, READ))


@pytest.mark.parametrize(
    ("parameters", "sentences"),
    [({"task": "crawler"}, ["crawler", "swimmer"]), ({"seed": 1.5}, ["seed"])],
)
def test_a_wrong_parameter_ends_the_start_with_a_sentence(graph, parameters, sentences):
    process = graph.start("policy_executor", **parameters)
    assert process.wait() == 1
    assert all(sentence in process.output for sentence in sentences)
    assert "Traceback" not in process.output


def test_lock_step_through_two_processes_equals_a_rollout_in_process(graph, swimmer, random_policy):
    horizon, policy = 60, random_policy(4)
    start = np.linspace(-0.3, 0.3, 10)
    graph.start(
        "simulation", initial_state=start.tolist(), start_paused=True, wait_timeout=PATIENCE
    )
    graph.start("policy_executor", stochastic=True, seed=2)
    received = graph.messages(JointState, "joint_states")
    graph.publish_policy(policy)

    def states():
        return {nanoseconds(s.header.stamp) // PERIOD: s for s in received}

    graph.spin_until(states)
    # A few at a time: this process must keep up, or messages are lost.
    for step in range(0, horizon, 5):
        graph.step(5)
        graph.spin_until(lambda step=step: step + 5 in states())

    def law(t, x):
        noise = generator(2, Stream.EXECUTION, t * PERIOD).standard_normal(2)
        mean = executed(policy, swimmer.observation(x)[0])
        return mean[None] + policy.noise_std * noise

    in_process = swimmer.dynamics.rollout(start, law, horizon)
    assert len(states()) == horizon + 1
    for t, message in states().items():
        state = state_from_msg(message, swimmer.joint_names)
        np.testing.assert_array_equal(state, in_process.states[t])


@EACH_SIGNAL
def test_signals_end_a_running_graph_with_code_0(graph, random_policy, number):
    simulation, executor = graph.start("simulation"), graph.start("policy_executor")
    states = graph.messages(JointState, "joint_states")
    graph.publish_policy(random_policy(0))
    graph.spin_until(lambda: len(states) > 100)
    for process in (simulation, executor):
        process.send(number)
        assert process.end(number) == 0, process.output


def test_a_policy_from_a_file_drives_and_is_published(graph, swimmer, random_policy, tmp_path):
    save_policy(random_policy(3), "swimmer", tmp_path / "policy.json")
    graph.start("policy_executor", policy_file=tmp_path / "policy.json")
    published = graph.messages(GaussianPolicyMsg, "policy", LATCHED)
    controller = Controller(graph, swimmer)
    graph.diagnosis("policy_executor", DiagnosticStatus.OK, "Waiting for joint_states")
    graph.spin_until(lambda: published, what="the policy of the file")
    np.testing.assert_array_equal(controller.answer(ONES), executed(random_policy(3), READ))


def test_a_file_that_is_no_policy_of_the_task_ends_the_start_with_a_sentence(
    graph, random_policy, tmp_path
):
    (tmp_path / "text.json").write_text("{}")
    save_policy(random_policy(0), "runner", tmp_path / "runner.json")
    for name, sentence in (
        ("absent.json", "is not a readable policy file"),
        ("text.json", "is not a policy of vgps_ros"),
        ("runner.json", "the policy's task is 'runner', but it must be one of swimmer"),
    ):
        executor = graph.start("policy_executor", policy_file=tmp_path / name)
        assert executor.wait() == 1
        assert sentence in executor.output


def test_the_base_of_a_real_robot_comes_from_its_odometry(graph, swimmer, random_policy, rng):
    graph.start("policy_executor", state_qos="sensor_data")
    controller, policy = Controller(graph, swimmer), random_policy(0)
    odometry = graph.publisher(Odometry, "odom", qos_profile_sensor_data)
    controller.policies.publish(policy_to_msg(policy, "swimmer", 1, Time()))
    model = swimmer.dynamics.model
    states, x = StateMessages(state_layout(model)), 0.5 * rng.standard_normal(10)
    robot = measured(model, states, x)
    assert len(robot["joint_states"].name) == 2

    def answered(stamp):
        for message in robot.values():
            message.header.stamp = stamp_of(stamp)
        controller.states.publish(robot["joint_states"])
        odometry.publish(robot["odom"])
        graph.spin_for(0.05)
        return list(controller.commands)

    [command, *_] = graph.spin_until(lambda: answered(PERIOD), what="torques from odometry")
    torques = command_from_msg(command, swimmer.controls)
    taken = states.join(robot)
    np.testing.assert_allclose(taken, x, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(torques, executed(policy, swimmer.observation(taken)))


def test_a_robot_whose_driver_publishes_best_effort_is_driven_but_not_without_stamps(
    graph, swimmer, random_policy
):
    graph.start("policy_executor", state_qos="sensor_data")
    controller, policy = Controller(graph, swimmer), random_policy(0)
    graph.node.destroy_publisher(controller.states)
    controller.states = graph.publisher(JointState, "joint_states", qos_profile_sensor_data)
    controller.policies.publish(policy_to_msg(policy, "swimmer", 1, Time()))
    driver = state_to_msg(2.0 * np.ones(10), swimmer.joint_names, stamp_of(0))

    def stamped(stamp):
        driver.header.stamp = stamp_of(stamp)
        controller.states.publish(driver)
        graph.spin_for(0.05)
        return bool(controller.commands)

    # Another joint comes first and has no value; the rest comes the other way around.
    driver.name = ["gripper", *reversed(driver.name)]
    driver.position, driver.velocity = (
        [np.nan, *reversed(values)] for values in (driver.position, driver.velocity)
    )
    driver.effort = []
    graph.spin_until(lambda: stamped(PERIOD), what="torques from a best-effort state")
    torques = command_from_msg(controller.commands[-1], swimmer.controls)
    np.testing.assert_array_equal(torques, executed(policy, 2.0 * READ))
    stamped(0)
    sentence = "the state's stamp is 0, but it must be the time of the measurement"
    graph.diagnosis("policy_executor", DiagnosticStatus.ERROR, sentence)


def test_an_executor_with_a_policy_file_waits_for_states_alone(graph, random_policy, tmp_path):
    save_policy(random_policy(0), "swimmer", tmp_path / "policy.json")
    executor = graph.start("policy_executor", policy_file=tmp_path / "policy.json")
    graph.diagnosis("policy_executor", DiagnosticStatus.OK, "Waiting for joint_states")
    assert "Waiting for policy" not in executor.output
