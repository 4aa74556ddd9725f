# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Several nodes in one process: `vgps node NAME NAME`."""

import signal
from dataclasses import replace

import pytest
from lifecycle_msgs.msg import Transition
from sensor_msgs.msg import JointState

from tests.nodes.test_namespaces import OWN_TOPICS, within
from tests.nodes.test_training import SHORT, checked, parameters, train_in_process
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

ROBOT = ("simulation", "policy_executor")
STEPS = 20


def test_all_nodes_of_a_training_in_one_process_learn_the_same_bits(graph, tmp_path):
    settings = replace(SHORT, iterations=3)
    names = ("policy_learner", "trajectory_optimizer", *ROBOT)
    given = [*within("/robot1"), *OWN_TOPICS]
    nodes = graph.start("node", *names, *given, **parameters(settings))
    flags = ["--namespace=/robot1", "--iterations=3", "--hidden-units=4", "--seed=3"]
    training = graph.start_program("train_through_graph", *flags, f"--output={tmp_path / 'run'}")
    graph.ends(training)
    flags = ("--task=rotor", "--namespace=/robot1", f"--json={tmp_path / 'driven.json'}")
    execution = graph.start_program("execute_policy", *flags)
    graph.ends(execution)
    iterations = train_in_process(make_task("rotor"), settings, 3)
    checked(tmp_path / "run", iterations)
    assert nodes.end(signal.SIGTERM) == 0, nodes.output


def test_a_robot_moves_in_one_process_bit_for_bit_as_in_two(graph, random_policy, tmp_path):
    file = tmp_path / "policy.json"
    save_policy(random_policy(0), "swimmer", file)
    states = graph.messages(JointState, "joint_states")
    commands = graph.messages(JointState, "joint_command")
    runs = []
    for executables in (ROBOT, ("node",)):
        ros = ["--ros-args", "-p", "simulation:start_paused:=true"]
        ros += ["-p", f"policy_executor:policy_file:={file}"]
        names = ROBOT if executables == ("node",) else ()
        processes = [graph.start(executable, *names, *ros) for executable in executables]
        states.clear()
        assert not graph.step(STEPS).error_message
        graph.spin_until(lambda at=states: len({s.header.stamp.nanosec for s in at}) > STEPS)
        by_stamp = {(s.header.stamp.sec, s.header.stamp.nanosec): s for s in states}
        runs.append({stamp: (s.position, s.velocity) for stamp, s in by_stamp.items()})
        commands.clear()
        assert graph.change(Transition.TRANSITION_DEACTIVATE)
        # One of the last step may still be on its way.
        graph.spin_until(lambda: commands and not any(commands[-1].effort))
        assert [process.end() for process in processes] == [0] * len(processes)
    assert len(runs[0]) == STEPS + 1
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("bogus:=1", "None of recorder, simulation has a parameter 'bogus'."),
        ("simulation:bogus:=1", "simulation has no parameter 'bogus'."),
        ("task:=bogus", "There is no task 'bogus'"),
    ],
)
def test_a_node_that_cannot_start_ends_all_with_its_sentence(graph, tmp_path, given, sentence):
    bag = f"recorder:output:={tmp_path / 'bag'}"
    nodes = graph.start("node", "recorder", "simulation", "--ros-args", "-p", bag, "-p", given)
    assert nodes.wait() == 1
    assert sentence in nodes.output
    assert "Traceback" not in nodes.output
    assert (tmp_path / "bag" / "metadata.yaml").exists()  # the recorder was closed


def test_a_node_with_another_executor_ends_all_too(graph, tmp_path):
    first = graph.start("simulation")
    graph.spin_until_output(first, "Waiting for joint_command")  # it has looked for others
    nodes = graph.start(
        "node", "recorder", "simulation", "--ros-args", "-p", f"recorder:output:={tmp_path / 'bag'}"
    )
    assert nodes.wait() == 1
    assert "publishes /joint_states already" in nodes.output
    assert (tmp_path / "bag" / "metadata.yaml").exists()
    assert first.running


def test_the_help_of_several_nodes_has_the_parameters_of_each(graph):
    helped = graph.start("node", *ROBOT, "--help")
    assert helped.wait() == 0
    assert "usage: ros2 run vgps_ros node simulation policy_executor" in helped.output
    assert "real_time_factor" in helped.output
    assert "safe_action" in helped.output
