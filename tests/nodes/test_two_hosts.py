# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Two hosts on a network: by default nothing leaves one, and one setting opens both.

The hosts are network namespaces, joined by a pair of virtual interfaces and with a shared memory of
their own; all of it vanishes with the test's processes.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROFILE = Path(__file__).parents[2] / "config" / "fastdds_loopback.xml"
TOOLS = ("unshare", "nsenter", "ip", "mount")

NODE = """
import sys, time, rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node(sys.argv[1])
end = time.monotonic() + float(sys.argv[2])
heard = []
try:
    if sys.argv[1] == "talker":
        publisher = node.create_publisher(String, "greeting", 10)
        node.create_timer(0.05, lambda: publisher.publish(String(data="hello")))
    else:
        node.create_subscription(String, "greeting", heard.append, 10)
    while time.monotonic() < end and not heard:
        rclpy.spin_once(node, timeout_sec=0.05)
except ExternalShutdownException:
    pass
if sys.argv[1] == "listener":
    print("heard" if heard else "silence", flush=True)
"""

# Prints, for a profile: what the other host heard, and the packets that left this one.
HOSTS = """
set -euo pipefail
unshare --net --mount sleep 300 &
other=$!
trap 'kill -KILL $other' EXIT
until [[ $(readlink /proc/$other/ns/net) != $(readlink /proc/$$/ns/net) ]]; do sleep 0.02; done
there() { nsenter --target $other --net --mount "$@"; }
until there mount -t tmpfs none /dev/shm 2>/dev/null; do sleep 0.02; done
# Packets that the kernel itself would send must not be counted.
echo 1 > /proc/sys/net/ipv6/conf/all/disable_ipv6
echo 1 > /proc/sys/net/ipv6/conf/default/disable_ipv6
ip link add here type veth peer name there netns $other
ip address add 10.77.0.1/24 dev here
ip link set lo up
ip link set here up
there ip address add 10.77.0.2/24 dev there
there ip link set lo up
there ip link set there up
until ip link show here | grep -q 'state UP'; do sleep 0.02; done
until there ip link show there | grep -q 'state UP'; do sleep 0.02; done
sent() { awk '$1 == "here:" { print $11 }' /proc/self/net/dev; }
before=$(sent)
"$PYTHON" -c "$NODE" talker 60 &
talker=$!
heard=$(there "$PYTHON" -c "$NODE" listener "$PATIENCE")
kill -TERM $talker
wait $talker
echo "$heard $(($(sent) - before))"
"""


def talk(profile: str, patience: float) -> tuple[str, int]:
    """Lets a node of one host talk to one of the other; returns what was heard, and the packets."""
    run = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--net", "--mount", "bash", "-c", HOSTS],
        env={
            **os.environ,
            "FASTRTPS_DEFAULT_PROFILES_FILE": profile,
            "ROS_DOMAIN_ID": "77",  # on a network of its own
            "PYTHON": sys.executable,
            "NODE": NODE,
            "PATIENCE": str(patience),
        },
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    heard, packets = run.stdout.splitlines()[-1].split()  # after what the middleware says
    return heard, int(packets)


@pytest.fixture(scope="module")
def namespaces() -> None:
    """Skips where a process may not make network namespaces."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"this machine lacks {', '.join(missing)}")
    make = ["unshare", "--user", "--map-root-user", "--net", "--mount"]
    make += ["ip", "link", "add", "here", "type", "veth", "peer", "name", "there"]
    run = subprocess.run(make, capture_output=True, text=True, check=False)
    if run.returncode != 0:
        pytest.skip(f"network namespaces are not permitted here: {run.stderr.strip()}")


def test_by_default_nothing_leaves_the_host(namespaces):
    assert talk(str(PROFILE), patience=5.0) == ("silence", 0)


def test_one_setting_opens_it_to_other_hosts(namespaces):
    heard, packets = talk("", patience=30.0)
    assert heard == "heard"
    assert packets > 0
