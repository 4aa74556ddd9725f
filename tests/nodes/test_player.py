# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The player: what was recorded comes back, byte for byte, in order and in time."""

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rosbag2_interfaces.srv import (
    Burst,
    GetRate,
    IsPaused,
    Pause,
    Play,
    PlayNext,
    Resume,
    Seek,
    SetRate,
    Stop,
    TogglePaused,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from vgps_msgs.msg import GaussianPolicy

from tests.nodes.conftest import EACH_SIGNAL, values_of
from vgps_ros.bags import BagMessage, BagReader, BagWriter
from vgps_ros.messages.conversions import pack, stamp_of
from vgps_ros.nodes.recorder import profile_in_bag
from vgps_ros.ros_runtime.qos import LATCHED, STREAM

START = 10**18
KINDS = {
    "/joint_states": ("sensor_msgs/msg/JointState", JointState, STREAM),
    "/clock": ("rosgraph_msgs/msg/Clock", Clock, STREAM),
    "/policy": ("vgps_msgs/msg/GaussianPolicy", GaussianPolicy, LATCHED),
    "/weak": (
        "std_msgs/msg/String",
        String,
        QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT),
    ),
}
WEAK = bytes((0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0))  # an empty string; padded, as DDS does
DEEP = QoSProfile(depth=20000)  # loses nothing while the test's own process is busy


def joint_state(i: int, joints: int = 12) -> bytes:
    values = pack(np.sin(np.arange(joints) + i))
    names = [f"joint_{j}" for j in range(joints)]
    message = JointState(name=names, position=values, velocity=values, effort=values)
    message.header.stamp.sec = i
    return serialize_message(message)


def policy() -> bytes:
    numbers = pack(np.array([np.pi, 1e-300]))
    return serialize_message(GaussianPolicy(task="swimmer", parameters=numbers))


Make = Callable[..., Path]


@pytest.fixture
def make_bag(tmp_path: Path) -> Make:
    """Returns a function that writes a bag from (time [s], topic, CDR)."""

    def make(rows: list[tuple[float, str, bytes]]) -> Path:
        writer = BagWriter(tmp_path / "bag")
        for topic in {topic for _, topic, _ in rows}:
            kind, _, qos = KINDS[topic]
            writer.add_topic(topic, kind, "", [profile_in_bag(qos)])
        for t, topic, data in rows:
            writer.write(topic, START + round(t * 1e9), data)
        writer.close()
        return tmp_path / "bag"

    return make


def states(*times: float) -> list[tuple[float, str, bytes]]:
    return [(t, "/joint_states", joint_state(i)) for i, t in enumerate(times)]


def listen(graph, *topics: str) -> list[tuple[str, bytes, float]]:
    """Topic, bytes and time of what is received from now on; grows while the test spins."""
    received: list[tuple[str, bytes, float]] = []
    for topic in topics:
        _, kind, offered = KINDS[topic]
        qos = QoSProfile(
            depth=DEEP.depth, reliability=offered.reliability, durability=offered.durability
        )

        def take(data: bytes, topic: str = topic) -> None:
            received.append((topic, bytes(data), time.monotonic()))

        graph.node.create_subscription(kind, topic, take, qos, raw=True)
    return received


def seconds(received: list[tuple[str, bytes, float]]) -> list[int]:
    """The stamps of the joint states: which ones they are."""
    return [
        deserialize_message(data, JointState).header.stamp.sec
        for topic, data, _ in received
        if topic == "/joint_states"
    ]


def play_to_end(graph, bag: Path, received: list, count: int, **parameters: object):
    """Returns a player that has ended by itself, once so many messages have come."""
    player = graph.start("player", bag=bag, **parameters)
    graph.ends(player)
    graph.spin_until(lambda: len(received) >= count, what=f"{count} messages")
    graph.spin_for(0.3)  # for what should not come
    return player


def ask(graph, kind: Any, **request: Any) -> Any:
    """Calls the player's service of this type, whose name rosbag2 makes of the type's."""
    name = re.sub("(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
    return graph.call(kind, f"player/{name}", kind.Request(**request))


def at(t: float) -> Time:
    """Returns the stamp of a time after the bag's start [s]."""
    return stamp_of(START + round(t * 1e9))


def test_all_topics_come_back_byte_for_byte_in_order_and_in_time(graph, make_bag):
    rows = [(0.0, "/policy", policy()), *states(0.1, 0.3, 0.6, 1.0)]
    rows += [(0.7, "/clock", serialize_message(Clock())), (0.8, "/weak", WEAK)]
    rows.sort(key=lambda row: row[0])
    received, began = listen(graph, *KINDS), time.monotonic()
    player = play_to_end(graph, make_bag(rows), received, len(rows))
    assert [(topic, data) for topic, data, _ in received] == [row[1:] for row in rows]
    assert "Played 7 messages of 4 topics" in player.output
    # None comes before its time, after a second in which the test finds the topics. How late one
    # is depends on the machine.
    assert all(came - began >= 1.0 + t for (*_, came), (t, *_) in zip(received, rows, strict=True))


def test_publishers_offer_the_recorded_reliability_and_durability(graph, make_bag):
    rows = [(0.0, "/policy", policy()), (0.0, "/weak", WEAK), *states(0.0)]
    player = graph.start("player", bag=make_bag(rows), start_paused=True)
    graph.spin_until_output(player, "Plays 3 topics")
    offers = {}
    for topic in ("/policy", "/weak", "/joint_states"):
        found = graph.spin_until(lambda t=topic: graph.node.get_publishers_info_by_topic(t))
        offers[topic] = (found[0].qos_profile.reliability, found[0].qos_profile.durability)
    reliable, latched = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
    assert offers["/policy"] == (reliable, latched)
    assert offers["/weak"] == (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
    assert offers["/joint_states"] == (reliable, DurabilityPolicy.VOLATILE)


def test_nothing_is_lost_however_slowly_it_is_taken(graph, make_bag):
    """The player is a hundred times as fast as the recording, and the test reads afterwards."""
    bag, everything = make_bag(states(*np.arange(4000) / 500)), list(range(4000))
    received = listen(graph, "/joint_states")
    player = graph.start("player", bag=bag, start_paused=True, rate=100.0)
    graph.spin_until(lambda: ask(graph, PlayNext).success and received, what="a message")
    assert ask(graph, Seek, time=at(0.0)).success
    ask(graph, Resume)
    assert player.wait() == 0, player.output
    graph.spin_until(lambda: seconds(received[-1:]) == everything[-1:], what="the last message")
    assert seconds(received)[-4000:] == everything


def test_topics_are_chosen_by_pattern_and_those_left_out_are_named(graph, make_bag):
    rows = [*states(0.0, 0.1), (0.0, "/policy", policy()), (0.1, "/weak", WEAK)]
    received = listen(graph, "/joint_states", "/policy", "/weak")
    patterns = {"include": "[joint, weak]", "exclude": "['^/we']"}
    player = play_to_end(graph, make_bag(rows), received, 2, **patterns)
    assert [topic for topic, *_ in received] == ["/joint_states"] * 2
    assert "Leaves out /policy, /weak, by the patterns" in player.output


def test_services_pause_step_and_resume(graph, make_bag):
    bag = make_bag(states(0.0, 30.0, 30.2, 60.0))
    received = listen(graph, "/joint_states")
    player = graph.start("player", bag=bag, start_paused=True)
    assert ask(graph, PlayNext).success
    assert ask(graph, PlayNext).success
    assert ask(graph, IsPaused).paused
    graph.spin_for(0.5)
    assert seconds(received) == [0, 1]
    ask(graph, Pause)  # already
    ask(graph, TogglePaused)
    assert not ask(graph, IsPaused).paused
    ask(graph, Resume)  # already
    assert not ask(graph, PlayNext).success
    assert not ask(graph, Burst).actually_burst
    graph.spin_until(lambda: len(received) == 3, what="the third message")
    ask(graph, Pause)
    status = graph.diagnosis("player", DiagnosticStatus.OK)
    values = values_of(status)
    assert values["paused"] == "True"
    assert values["messages"] == "3"
    assert ask(graph, PlayNext).success
    graph.ends(player)
    assert seconds(received) == [0, 1, 2, 3]


def test_it_seeks_and_changes_its_rate_and_the_clock_follows(graph, make_bag):
    bag = make_bag(states(*range(101)))
    received = listen(graph, "/joint_states")
    clocks = graph.messages(Clock, "/clock", DEEP)
    player = graph.start("player", bag=bag, start_paused=True, clock_rate=50.0)
    assert not ask(graph, SetRate, rate=0.0).success
    assert not ask(graph, SetRate, rate=float("nan")).success
    assert ask(graph, GetRate).rate == 1.0
    assert ask(graph, SetRate, rate=20.0).success
    assert ask(graph, GetRate).rate == 20.0
    assert not ask(graph, Seek, time=at(101.0)).success
    clocks.clear()
    assert ask(graph, Seek, time=at(50.0)).success
    graph.spin_until(lambda: clocks, what="the clock")
    assert clocks[-1].clock == at(50.0)
    assert not seconds(received)  # while it is paused
    assert ask(graph, Burst, num_messages=3).actually_burst == 3
    assert ask(graph, Seek, time=at(0.0)).success
    assert ask(graph, PlayNext).success
    assert ask(graph, Seek, time=at(90.0)).success
    graph.spin_for(0.3)
    clocks.clear()
    ask(graph, Resume)
    graph.ends(player)
    graph.spin_until(lambda: len(received) >= 15, what="15 messages")
    graph.spin_for(0.3)
    assert seconds(received) == [50, 51, 52, 0, *range(90, 101)]
    ticks = [tick.clock.sec + 1e-9 * tick.clock.nanosec - START * 1e-9 for tick in clocks]
    assert np.diff(ticks) == pytest.approx(20.0 / 50.0, abs=1e-6)
    assert ticks[0] == pytest.approx(90.0, abs=0.41)


def test_stop_ends_it_and_one_that_stays_plays_a_part_again(graph, make_bag):
    bag = make_bag(states(0.0, 0.1, 0.2, 0.3, 100.0))
    stopped = graph.start("player", bag=bag, start_paused=True)
    assert not ask(graph, Play).success  # it plays
    ask(graph, Stop)
    assert stopped.wait() == 0, stopped.output
    received = listen(graph, "/joint_states")
    player = graph.start("player", bag=bag, stay=True)
    graph.spin_until(lambda: len(received) == 4, what="four messages")
    ask(graph, Stop)
    graph.spin_until_output(player, "~/play plays again")
    tenths = {"start_offset": Time(nanosec=10**8), "playback_duration": Duration(nanosec=10**8)}
    graph.spin_until(lambda: ask(graph, Play, **tenths).success, what="the end of its thread")
    graph.spin_until(lambda: player.output.count("~/play plays again") == 2, what="its end")
    assert player.running
    assert seconds(received) == [0, 1, 2, 3, 1, 2]


def test_the_clock_ticks_at_its_rate_in_place_of_the_recorded_one(graph, make_bag):
    rows = [*states(0.0, 1.0), (0.5, "/clock", serialize_message(Clock()))]
    received = listen(graph, "/clock", "/joint_states")
    play_to_end(graph, make_bag(sorted(rows)), received, 13, clock_rate=20.0, rate=2.0)
    ticks = [deserialize_message(d, Clock).clock for t, d, _ in received if t == "/clock"]
    found = [t.sec * 10**9 + t.nanosec - START for t in ticks]
    # A tick each 0.05 s of the wall clock: each 0.1 s of the bag.
    assert found == [i * 10**8 for i in range(11)]
    assert seconds(received) == [0, 1]


def test_a_type_that_is_not_installed_or_has_changed_is_named_and_the_rest_played(graph, tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    for kind in ("no_such_msgs/msg/Thing", "vgps_msgs/msg/GaussianPolicy"):
        store.register(get_types_from_msg("float64 x", kind))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, kind in {
            "/thing": "no_such_msgs/msg/Thing",
            "/policy": "vgps_msgs/msg/GaussianPolicy",
            "/joint_states": "sensor_msgs/msg/JointState",
        }.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            writer.write(connection, START, joint_state(5))
    received = listen(graph, "/joint_states", "/policy")
    player = play_to_end(graph, tmp_path / "bag", received, 1)
    assert "Does not play /thing: the type no_such_msgs/msg/Thing is not ins" in player.output
    assert "Does not play /policy: the type vgps_msgs/msg/GaussianPolicy was" in player.output
    assert [topic for topic, *_ in received] == ["/joint_states"]
    assert seconds(received) == [5]


@EACH_SIGNAL
@pytest.mark.parametrize("doing", ["playing", "paused", "in the delay"])
def test_signals_end_it_whatever_it_is_doing(graph, make_bag, number, doing):
    bag = make_bag(states(*np.arange(3000) / 10))
    received = listen(graph, "/joint_states")
    player = graph.start(
        "player", bag=bag, start_paused=doing == "paused", delay=60.0 if "delay" in doing else 0.0
    )
    graph.spin_until_output(player, "Plays 1 topics")
    if doing == "playing":
        graph.spin_until(lambda: received, what="a message")
    player.send(number)
    player.send(number)
    assert player.wait() == 0, player.output
    assert "Traceback" not in player.output
    assert "of /" in player.output.splitlines()[-1]


def bad_bag(make_bag: Make, tmp_path: Path, what: str) -> Path:
    if what == "a bag":
        return make_bag(states(0.0, 0.5))
    path = tmp_path / "bad"
    if what != "nothing":
        path.mkdir()
    if what == "no messages":
        path.rmdir()
        writer = BagWriter(path)
        writer.add_topic("/joint_states", "sensor_msgs/msg/JointState", "", [])
        writer.close()
    return path


@pytest.mark.parametrize(
    ("what", "parameters", "sentence"),
    [
        ("nothing", {}, "is not a bag"),
        ("no messages", {}, "has no messages to play"),
        ("a bag", {"include": "[policy]"}, "is left to play; it has /joint_states"),
        ("a bag", {"include": "['(']"}, "must be a regular expression"),
        ("a bag", {"start_offset": 7.0, "delay": 0.0}, "start_offset is 7 s, but the bag is only"),
    ],
)
def test_bad_input_is_refused_with_a_sentence(
    graph, make_bag, tmp_path, what, parameters, sentence
):
    player = graph.start("player", bag=bad_bag(make_bag, tmp_path, what), **parameters)
    assert player.wait() == 1, player.output
    assert sentence in player.output
    assert "Traceback" not in player.output


def test_without_a_bag_it_asks_for_one(graph):
    player = graph.start("player")
    assert player.wait() == 1
    assert "must name the folder of a bag" in player.output


def test_a_bag_damaged_in_the_middle_is_played_up_to_there(graph, make_bag):
    bag = make_bag(states(*np.arange(8000) / 8000))
    with BagReader(bag) as reader:
        data: BagMessage = list(reader.messages())[-100]
    [file] = bag.glob("*.mcap")
    content = bytearray(file.read_bytes())
    at = content.find(data.data)
    content[at + 40] ^= 0xFF  # the chunk's checksum no longer fits
    file.write_bytes(content)
    received = listen(graph, "/joint_states")
    player = graph.start("player", bag=bag)
    graph.ends(player, 1)
    assert f"is damaged (Chunk checksum mismatch); `vgps bag reindex {bag}`" in player.output
    assert "Traceback" not in player.output
    assert 1000 < len(received) < 8000
