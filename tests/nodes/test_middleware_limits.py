# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What others take of the machine: shared memory, and the ports of a domain."""

import socket
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from tests.nodes.conftest import SMALL_MEMORY, may_mount

ALL = 120  # processes that a domain has ports for


@contextmanager
def strangers(domain_id, count):
    """Takes the ports of the first processes of a domain, as so many other programs do."""
    with ExitStack() as stack:
        for place in range(count):
            taken = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            try:
                taken.bind(("127.0.0.1", 7410 + 250 * domain_id + 2 * place))
            except OSError:  # the test's own node has it
                continue
        yield


WITHOUT_PROFILE = ("unshare", "--net", "env", "-u", "FASTRTPS_DEFAULT_PROFILES_FILE")


@pytest.mark.parametrize("prefix", [(), WITHOUT_PROFILE])
def test_a_node_takes_none_of_the_middlewares_shared_memory(graph, prefix):
    if prefix and not may_mount():
        pytest.skip("needs the right to make a network namespace")
    node = graph.start("simulation", prefix=prefix, start_paused=True)
    graph.spin_until_output(node, "Simulating")
    maps = Path(f"/proc/{node.pid}/maps").read_text()
    assert "libfastrtps" in maps
    assert "/dev/shm/fastrtps" not in maps


@pytest.mark.skipif(not may_mount(), reason="needs the right to mount a file system")
def test_a_node_works_where_shared_memory_is_nearly_full(graph):
    simulation = graph.start("simulation", prefix=[*SMALL_MEMORY, "1M", "960K"], start_paused=True)
    optimizer = graph.start("trajectory_optimizer")
    for name in ("simulation", "trajectory_optimizer"):
        graph.diagnosis(name, DiagnosticStatus.OK)
    graph.spin_for(1.5)
    optimizer.kill()  # which only one that has heard it before misses
    graph.diagnosis("simulation", DiagnosticStatus.WARN, "/trajectory_optimizer has been silent")
    assert simulation.end() == 0


@pytest.mark.skipif(not may_mount(), reason="needs the right to mount a file system")
def test_a_node_ends_with_a_sentence_where_there_is_no_shared_memory_at_all(graph):
    node = graph.start("simulation", prefix=[*SMALL_MEMORY, "1M", "1M"])
    assert node.wait() == 1
    assert "/dev/shm has 0 bytes free" in node.output
    assert "Traceback" not in node.output


def test_nodes_find_each_other_beside_thirty_processes_of_others(graph, tmp_path):
    with strangers(graph.domain_id, 30):
        graph.start("recorder", output=tmp_path / "bag")
        graph.start("simulation", start_paused=True)

        def records_the_simulation():
            status = graph.diagnosis("recorder", DiagnosticStatus.OK)
            values = {value.key: value.value for value in status.values}
            return int(values.get("topics", 0)) > 4  # those that every node has, and more

        graph.spin_until(records_the_simulation)


def test_a_node_for_which_the_domain_has_no_port_left_says_so(graph):
    with strangers(graph.domain_id, ALL + 1):
        node = graph.start("simulation", start_paused=True)
        graph.spin_until_output(node, f"none of the {ALL} places of domain {graph.domain_id}")


@pytest.mark.parametrize("domain_id", ["232", "300", "-1", "mine"])
def test_a_domain_without_the_ports_that_nodes_need_is_refused(graph, domain_id):
    node = graph.start("simulation", prefix=["env", f"ROS_DOMAIN_ID={domain_id}"])
    assert node.wait() == 1
    wanted = f"ROS_DOMAIN_ID is '{domain_id}', but it must be 0 to 231"
    assert wanted in node.output
    assert "Traceback" not in node.output
