# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What the graph lets in and out: the addresses it binds, and the topics, services and actions."""

import os
import signal
import socket
import struct
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.expand_topic_name import expand_topic_name
from vgps_msgs.msg import LearningProgress

from vgps_ros import NODES
from vgps_ros.ros_runtime.qos import STREAM

POLICY = Path(__file__).parents[2] / "config" / "security" / "policy.xml"
SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"
INCLUDE = "{http://www.w3.org/2001/XInclude}include"
START_UP = 120.0  # of ten processes at once, on a busy machine [s]


class Use(NamedTuple):
    """What a node does with a topic, service or action, in the words of a policy."""

    how: str
    name: str


# Allowed, but not used by the graph of these tests: what a node does only with certain parameters,
# beside /clock for simulated time, or only for a moment.
SOMETIMES = {
    *(
        (node, Use(how, f"{namespace}/{topic}"))
        for node, namespace in (("policy_executor", ""), ("mpc", "/planned"))
        for how, topic in (
            ("publish", "policy"),
            ("publish", "trajectory_distribution"),
            ("subscribe", "trajectory_distribution"),
            # With a task that has commands or a clock:
            ("publish", "context"),
            ("subscribe", "cmd_vel"),
            ("subscribe", "command"),
        )
    ),
    ("policy_executor", Use("publish", "/onnx_policy")),
    ("execute_policy", Use("publish", "/cmd_vel")),
    ("execute_policy", Use("subscribe", "/context")),
    ("recorder", Use("request", "/*/get_parameters")),
    ("recorder", Use("request", "/*/list_parameters")),
    # With a robot that has a free base, balls or activations:
    *(
        (node, Use(how, f"{namespace}/{topic}"))
        for node, namespace, how in (
            ("simulation", "", "publish"),
            ("policy_executor", "", "subscribe"),
            ("mpc", "/planned", "subscribe"),
            ("live", "", "subscribe"),
            ("execute_policy", "", "subscribe"),
        )
        for topic in ("activations", "multi_dof_joint_states", "odom")
    ),
    ("simulation", Use("publish", "/imu")),
    ("policy_executor", Use("subscribe", "/imu")),
}


@pytest.fixture(scope="module")
def whole_graph(shared_graph) -> Iterator[Any]:
    """Every node and program of the project at once, in the midst of a training."""
    graph, folder = shared_graph, shared_graph.folder
    for node in ("simulation", "trajectory_optimizer", "policy_learner", "policy_executor"):
        graph.start(node, task="rotor")
    # In namespaces, since only one node of a graph may command the joints.
    graph.start("mpc", "--ros-args", "-r", "__ns:=/planned", "-p", "task:=rotor")
    graph.start("watchdog", "--ros-args", "-r", "__ns:=/watched")
    graph.start("recorder", output=folder / "bag")
    graph.start("player", bag=SAMPLE, start_paused=True)
    graph.start("visualizer", output=folder / "run.rrd")
    graph.start("live", port=18080)
    patience = ("--timeout", str(START_UP))
    training = ("--iterations", "100000", "--output", f"{folder}/out")
    programs = [
        graph.start("train_through_graph", *training, *patience),
        graph.start("execute_policy", "--task", "rotor", "--steps", "100000000", *patience),
        graph.start("drive", "--turn", "0.001", *patience),  # a circle of 6,283 s
    ]
    missing = {process.name for process in graph.processes}
    found = lambda: missing.difference_update(graph.node.get_node_names()) or not missing  # noqa: E731
    graph.spin_until(found, START_UP, f"{missing}")
    progress = graph.messages(LearningProgress, "learning_progress", STREAM)
    graph.spin_until(lambda: progress, START_UP, "an iteration of the training")
    graph.spin_for(2.0)  # until their endpoints are known too
    yield graph
    for program in programs:
        program.end(signal.SIGINT)


def test_every_socket_is_bound_to_loopback_and_only_the_page_serves_tcp(whole_graph):
    for process in whole_graph.processes:
        sockets = bound_sockets(process.pid)
        addresses = {address for kind, address in sockets if kind.startswith("udp")}
        assert addresses == {"127.0.0.1"}, (process.name, sockets)
        served = [s for s in sockets if s[0].startswith("tcp")]
        own = [("tcp", "127.0.0.1")] * 2  # the page, and what it tells of its stick
        assert served == (own if process.name == "live" else []), process.name


def test_each_node_is_allowed_what_it_uses_and_hardly_more(whole_graph):
    unused = set()
    uses = live_uses(whole_graph)
    for (namespace, name), used in uses.items():
        allowed = allowed_uses(name, namespace)
        for use in used:
            assert any(is_covered(use, rule) for rule in allowed), f"{name} may not {use}"
        unused |= {(name, r) for r in allowed if not any(is_covered(use, r) for use in used)}
    assert {name for _, name in uses} == {path.strip("/") for path in enclaves()}
    clocks = {(name, Use("subscribe", "/clock")) for _, name in uses}
    events = {(name, Use("publish", f"{ns.rstrip('/')}/*/_service_event")) for ns, name in uses}
    assert unused <= SOMETIMES | clocks | events


def test_the_policy_has_an_enclave_for_each_node_and_program_of_the_graph(whole_graph):
    assert {p.name for p in whole_graph.processes} == {path.strip("/") for path in enclaves()}


@pytest.mark.parametrize("name", NODES)
def test_each_node_takes_all_of_its_own_parameters_as_they_are(whole_graph, name):
    node = {"mpc": "planned/", "watchdog": "watched/"}.get(name, "") + name
    names = whole_graph.call(ListParameters, f"{node}/list_parameters").result.names
    given = GetParameters.Request(names=names)
    values = whole_graph.call(GetParameters, f"{node}/get_parameters", given).values
    for i, value in enumerate(values):
        if value.type == ParameterType.PARAMETER_DOUBLE and "e" in repr(value.double_value):
            # as `ros2 param load` sends it
            text = repr(value.double_value)
            values[i] = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)
    pairs = zip(names, values, strict=True)
    given = SetParameters.Request(parameters=[Parameter(name=n, value=v) for n, v in pairs])
    results = whole_graph.call(SetParameters, f"{node}/set_parameters", given).results
    refused = [n for n, result in zip(names, results, strict=True) if not result.successful]
    assert not refused
    assert "start_type_description_service" in names
    changed = Parameter(name="start_type_description_service", value=ParameterValue(type=1))
    given = SetParameters.Request(parameters=[changed])
    assert (
        not whole_graph.call(SetParameters, f"{node}/set_parameters", given).results[0].successful
    )


@pytest.mark.parametrize("node", ["simulation", "policy_executor", "recorder", "live"])
def test_diagnostics_name_the_computer(whole_graph, node):
    assert whole_graph.diagnosis(node, None).hardware_id == socket.gethostname()


def enclaves() -> dict[str, ElementTree.Element]:
    """The one profile of each enclave of the policy, by the enclave's path."""
    policy = ElementTree.parse(POLICY).getroot()
    assert policy.get("version") == "0.2.0"
    return {e.get("path", ""): e.find("profiles/profile") for e in policy.findall("enclaves/*")}  # type: ignore[misc]


def allowed_uses(node: str, namespace: str) -> set[Use]:
    """What the policy allows a node, were it written for this namespace."""
    profile = enclaves()[f"/{node}"]
    groups = list(profile)
    for include in profile.findall(INCLUDE):
        assert include.get("xpointer") == "xpointer(/profile/*)"
        groups += ElementTree.parse(POLICY.parent / include.get("href", "")).getroot()
    return {
        Use(how, expand_topic_name(entry.text, node, namespace))
        if "*" not in entry.text
        else Use(how, f"{namespace.rstrip('/')}/{entry.text}")
        for group in groups
        for how, rule in group.attrib.items()
        if rule == "ALLOW"
        for entry in group
    }


def is_covered(use: Use, rule: Use) -> bool:
    """Whether a rule, which may have wildcards as in the file of permissions, allows a use."""
    return use.how == rule.how and fnmatchcase(use.name, rule.name)


def live_uses(graph) -> dict[tuple[str, str], set[Use]]:
    """What each node of the graph does, as the middleware shows it, by namespace and name."""
    node = graph.node
    queries = {
        "publish": node.get_publisher_names_and_types_by_node,
        "subscribe": node.get_subscriber_names_and_types_by_node,
        "reply": node.get_service_names_and_types_by_node,
        "request": node.get_client_names_and_types_by_node,
    }
    found: dict[tuple[str, str], set[Use]] = {}
    for name, namespace in node.get_node_names_and_namespaces():
        if name == node.get_name():
            continue
        uses = {Use(how, n) for how, query in queries.items() for n, _ in query(name, namespace)}
        found[namespace, name] = {as_action(use) for use in uses}
    return found


def as_action(use: Use) -> Use:
    """The services and topics of an action are one thing in a policy."""
    action, inside, _ = use.name.partition("/_action/")
    if not inside:
        return use
    return Use("execute" if use.how in ("reply", "publish") else "call", action)


def bound_sockets(pid: int) -> list[tuple[str, str]]:
    """Kind and local address of each internet socket that a process has."""
    links = [os.readlink(file) for file in Path(f"/proc/{pid}/fd").iterdir()]
    inodes = {link[len("socket:[") : -1] for link in links if link.startswith("socket:[")}
    found = []
    for kind in ("udp", "tcp", "udp6", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{kind}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                found.append((kind, address(fields[1].split(":")[0])))
    return found


def address(hexadecimal: str) -> str:
    """An address as the kernel shows it: words of four bytes in the machine's order."""
    words = [int(hexadecimal[i : i + 8], 16) for i in range(0, len(hexadecimal), 8)]
    packed = struct.pack(f"={len(words)}I", *words)
    return socket.inet_ntop(socket.AF_INET if len(words) == 1 else socket.AF_INET6, packed)
