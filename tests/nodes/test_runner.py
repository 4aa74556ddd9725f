# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""How a node ends whose code fails, or that has not even begun."""

import os
import signal
import subprocess
import sys

import pytest
from std_msgs.msg import String

_NODE = """
import os
from pathlib import Path
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import String
from vgps_ros.ros_runtime.runner import Runnable, run

def sockets():  # those that are bound; Fast DDS keeps some that are not
    opened = [os.path.realpath(file) for file in Path("/proc/self/fd").iterdir()]
    bound = [line.split()[9] for line in Path("/proc/self/net/udp").read_text().splitlines()[1:]]
    return sum(file.partition("socket:")[2].strip("[]") in bound for file in opened)

class Failing(LifecycleNode):
    def __init__(self):
        super().__init__("failing")
        self.create_lifecycle_publisher(String, "words", 1)
        self.create_timer(0.1, self.fail)
        print("has made some:", sockets() > 0)
        if "{place}" == "constructor":
            raise KeyError("constructor failed")

    def fail(self):
        raise KeyError("callback failed")

def close(node):
    print("closed")
    if "{place}" == "closing":
        raise OSError("closing failed")

code = run(Runnable(Failing, close=close))
print("left:", sockets(), flush=True)
raise SystemExit(code)
"""


_INTERRUPTED = """
import os, signal
from rclpy.node import Node
from vgps_ros.ros_runtime.runner import Runnable, run

def make():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt as interrupt:
        raise ImportError("initialization failed") from interrupt  # as extensions in C do
    return Node("late")

raise SystemExit(run(Runnable(make)))
"""


def test_a_signal_while_a_node_imports_its_packages_ends_it_without_a_traceback(graph):
    ended = subprocess.run(
        [sys.executable, "-c", _INTERRUPTED],
        env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain_id)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("place", ["constructor", "callback", "closing"])
def test_a_node_whose_code_fails_says_where_and_closes_its_sockets(graph, place):
    ended = subprocess.run(
        [sys.executable, "-c", _NODE.format(place=place)],
        env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain_id)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 1, ended.stdout + ended.stderr
    assert "Traceback" in ended.stderr
    assert f"{place} failed" in ended.stderr
    closed = [] if place == "constructor" else ["closed"]
    assert ended.stdout.splitlines() == ["has made some: True", *closed, "left: 0"]


_SLOW = """
import time
from rclpy.node import Node
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.ros_runtime.runner import Runnable, run

class Slow(Node):
    def __init__(self):
        super().__init__("slow")
        print("begins", flush=True)
        try:
            for _ in range(3000):  # a signal just before a sleep is noticed after it
                time.sleep(0.1)
        except Exception as error:  # as where a file is read that may be damaged
            raise InvalidInputError("It cannot be read.") from error

raise SystemExit(run(Runnable(Slow, close=lambda *_: print("closed"))))
"""


@pytest.mark.parametrize("numbers", [[signal.SIGINT], [signal.SIGTERM, signal.SIGINT]])
def test_a_signal_ends_a_node_that_takes_long_to_begin(graph, numbers):
    node = subprocess.Popen(
        [sys.executable, "-c", _SLOW],
        env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain_id)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert node.stdout.readline() == "begins\n"
    for number in numbers:
        node.send_signal(number)
    output, _ = node.communicate(timeout=60)
    assert (node.returncode, output) == (0, "")


_TALKING = """
import time
from rclpy.node import Node
from std_msgs.msg import String
from vgps_ros.ros_runtime.runner import Runnable, run, streaming_executor

class Talking(Node):
    def __init__(self):
        super().__init__("talking")
        self.words = self.create_publisher(String, "words", 10)
        self.create_timer(0.1, self.look)

    def look(self):
        print("heard" if self.words.get_subscription_count() else "alone", flush=True)

def close(node):
    node.words.publish(String(data="last"))
    time.sleep(0.5)
    print("closed", flush=True)

raise SystemExit(run(Runnable(Talking, streaming_executor, close=close)))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_may_still_say_its_last_word_also_where_a_second_signal_comes(graph, number):
    words = graph.messages(String, "words")
    node = graph.start_command("talking", [sys.executable, "-c", _TALKING])
    graph.spin_until_output(node, "heard")
    node.send(number)
    graph.spin_until(lambda: [word.data for word in words] == ["last"])
    node.send(number)
    assert node.wait() == 0
    assert node.output.splitlines()[-1] == "closed"


@pytest.mark.parametrize(
    "lacks", [("-u", "HOME", "-u", "ROS_HOME", "-u", "ROS_LOG_DIR"), ("ROS_LOG_DIR=/proc/none",)]
)
def test_a_node_that_cannot_write_a_log_file_says_so_and_runs(graph, lacks):
    node = graph.start("watchdog", prefix=("env", *lacks))
    graph.spin_until(lambda: "watchdog" in graph.node.get_node_names())
    assert node.end() == 0
    assert "ROS cannot write a log file" in node.output
    assert "Traceback" not in node.output
