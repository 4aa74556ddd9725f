# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Two robots in one domain, each in a namespace, and parameter files that reach them there."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rosgraph_msgs.msg import Clock
from simulation_interfaces.srv import SetSimulationState

from tests.nodes.conftest import executed
from tests.nodes.test_training import SHORT, checked, parameters, train_in_process
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.tasks import make_task

CONFIG = Path(__file__).parents[2] / "config"
OWN_TOPICS = [
    word for topic in ("clock", "tf", "tf_static") for word in ("-r", f"/{topic}:={topic}")
]
ROBOTS = {"/robot1": 3, "/robot2": 4}  # with the seed of each one's training


def within(namespace: str, file: Path = CONFIG / "rotor.yaml") -> list[str]:
    return ["--ros-args", "-r", f"__ns:={namespace}", "--params-file", str(file)]


@pytest.fixture
def bag_says(capsys):
    """Returns a function that runs `vgps bag` and returns whether it went well, and its words."""

    def says(*arguments: str) -> tuple[bool, str]:
        capsys.readouterr()
        try:
            vgps(["bag", *arguments])
        except SystemExit as stop:
            return False, str(stop.code)
        return True, capsys.readouterr().out

    return says


def listens(name: str, graph, topic: str) -> bool:
    listeners = graph.node.get_subscriptions_info_by_topic(topic)
    return name in {info.node_name for info in listeners}


@pytest.mark.slow
def test_two_robots_in_one_domain_learn_and_move_bit_for_bit_as_alone(graph, tmp_path, bag_says):
    rotor, settings = make_task("rotor"), replace(SHORT, iterations=3)
    recorder = graph.start("recorder", output=str(tmp_path / "bag"))
    for namespace in ROBOTS:
        given = [*within(namespace), *OWN_TOPICS]
        for node in ("simulation", "trajectory_optimizer", "policy_executor"):
            graph.start(node, *given)
        graph.start("policy_learner", *given, **parameters(settings))
    # A topic of policies keeps the newest alone, so one that comes later misses the first ones.
    for namespace in ROBOTS:
        for topic in ("policy", "learning_progress"):
            graph.spin_until(lambda topic=f"{namespace}/{topic}": listens("recorder", graph, topic))
    trainings = {}
    for namespace, seed in ROBOTS.items():
        flags = ["--namespace", namespace, "--iterations=3", "--hidden-units=4", f"--seed={seed}"]
        output = f"--output={tmp_path / namespace[1:]}"
        trainings[namespace] = graph.start_program("train_through_graph", *flags, output)
    for program in trainings.values():
        assert program.wait() == 0, program.output
    executions = {
        namespace: graph.start_program(
            *("execute_policy", "--task=rotor", "--namespace", namespace),
            f"--json={tmp_path / namespace[1:]}.json",
        )
        for namespace in ROBOTS
    }
    for namespace, seed in ROBOTS.items():
        assert executions[namespace].wait() == 0, executions[namespace].output
        iterations = train_in_process(rotor, settings, seed)
        _, policy, _ = checked(tmp_path / namespace[1:], iterations)
        law = lambda _, x, policy=policy: executed(policy, rotor.observation(x)[0])[None]  # noqa: E731
        rollout = rotor.dynamics.rollout(rotor.initial_state, law, rotor.horizon)
        figures = json.loads((tmp_path / f"{namespace[1:]}.json").read_text())
        assert figures["cost"] == rotor.trajectory_cost(rollout)
    assert recorder.end() == 0

    well, text = bag_says("check", str(tmp_path / "bag"))
    assert not well
    assert "has several robots (/robot1/joint_command, /robot1/joint_states" in text
    assert "choose one with --namespace, which is one of /robot1, /robot2." in text
    for namespace in ROBOTS:
        well, text = bag_says("check", str(tmp_path / "bag"), "--namespace", namespace)
        assert well, text
        assert int(text.split()[0]) >= rotor.horizon  # a state that waits is answered again
        table = tmp_path / f"{namespace[1:]}.csv"
        flags = ("--namespace", namespace, "--output", str(table))
        assert bag_says("table", str(tmp_path / "bag"), *flags)[0]
        assert len(table.read_text().splitlines()) == rotor.horizon + 2
    tables = {(tmp_path / f"{namespace[1:]}.csv").read_text() for namespace in ROBOTS}
    assert len(tables) == 2  # each has its own policy, and so its own motion
    well, text = bag_says("check", str(tmp_path / "bag"), "--namespace", "/robot3")
    assert not well
    assert "has no messages on mjcf_description for /robot3" in text


def test_a_second_simulation_needs_a_clock_and_frames_of_its_own(graph):
    first = graph.start("simulation", *within("/robot1"))
    graph.diagnosis("robot1/simulation", DiagnosticStatus.OK)
    second = graph.start("simulation", *within("/robot2"))
    assert second.wait() == 1
    assert "/robot1/simulation publishes" in second.output
    assert re.search("publishes /(clock|tf|tf_static) already", second.output)
    assert " ".join(OWN_TOPICS) in second.output
    assert first.running
    graph.start("simulation", *within("/robot2"), *OWN_TOPICS)
    graph.diagnosis("robot2/simulation", DiagnosticStatus.OK)
    clocks = graph.messages(Clock, "/robot2/clock")
    graph.call(SetSimulationState, "/robot2/simulation/set_simulation_state")
    graph.spin_until(lambda: clocks)


# Those of `commanded` are task files.
PARAMETER_FILES = [f for f in sorted(CONFIG.rglob("*.yaml")) if f.parent.name != "commanded"]


@pytest.mark.parametrize("file", PARAMETER_FILES, ids=lambda f: f.stem)
def test_the_shipped_files_reach_every_namespace(file):
    for line in file.read_text().splitlines():
        if line[:1].strip() and not line.startswith("#"):
            assert line.startswith("/**/"), line


def test_a_shipped_file_brings_its_task_into_a_namespace(graph):
    graph.start("simulation", *within("/robot1", CONFIG / "walker.yaml"))
    request = GetParameters.Request(names=["task"])
    answer = graph.call(GetParameters, "/robot1/simulation/get_parameters", request)
    assert answer.values[0].string_value == "walker"
