"""Bags without a graph: what is written is read back, and what is no bag is refused."""

import json
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from vgps_ros.bags import BagReader, BagWriter, MessageDefinitions
from vgps_ros.core.errors import InvalidInputError

POLICY, STATE = "vgps_msgs/msg/GaussianPolicy", "sensor_msgs/msg/JointState"


@pytest.fixture
def store() -> Typestore:
    """Both types, from the definitions that go into the bag."""
    store = get_typestore(Stores.EMPTY)
    for kind in (POLICY, STATE):
        store.register(get_types_from_msg(MessageDefinitions().find(kind), kind))
    return store


@pytest.fixture
def messages(store) -> list[tuple[str, int, bytes]]:
    types = store.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
    none, ones = np.zeros(0), np.ones(2)
    policy = types[POLICY](
        header, "swimmer", 3, np.array([1, 2], np.uint32), np.array([2, 1], np.uint32), "tanh",
        False, True, ones, ones[:1],
    )  # fmt: skip
    state = types[STATE](header, ["a"], ones[:1], none, none)
    data = {
        kind: bytes(store.serialize_cdr(m, kind)) for kind, m in ((POLICY, policy), (STATE, state))
    }
    return [
        ("/policy", 5, data[POLICY]),
        ("/joint_states", 7, data[STATE]),
        ("/joint_states", 9, data[STATE]),
    ]


def rosidl_hash(kind: str) -> str:
    """The hash that rosidl gave the type when it generated its code."""
    package, _, name = kind.split("/")
    share = get_package_share_directory(package)
    hashes = json.loads(Path(share, "msg", f"{name}.json").read_text())["type_hashes"]
    return next(h["hash_string"] for h in hashes if h["type_name"] == kind)


@pytest.fixture
def bag(tmp_path, store, messages) -> Path:
    writer = BagWriter(tmp_path / "bag")
    for topic, kind in (("/policy", POLICY), ("/joint_states", STATE)):
        writer.add_topic(topic, kind, store.hash_rihs01(kind), [])
    for message in messages:
        writer.write(*message)
        writer.flush()
        writer.flush()  # nothing new: no empty chunk
    assert writer.message_count == 3
    writer.close()
    return tmp_path / "bag"


def test_bytes_times_and_types_are_read_back(bag, messages):
    with BagReader(bag) as reader:
        assert reader.topics == {"/policy": POLICY, "/joint_states": STATE}
        found = list(reader.messages())
        assert [(m.topic, m.stamp, m.data) for m in found] == messages
        assert reader.decode(found[0]).task == "swimmer"
        assert [m.stamp for m in reader.messages(["/joint_states"])] == [7, 9]
        assert reader.type_hashes["/policy"] == rosidl_hash(POLICY)


def test_an_unknown_topic_is_refused_with_the_known_ones(bag):
    with BagReader(bag) as reader, pytest.raises(InvalidInputError, match="/joint_states, /policy"):
        list(reader.messages(["/jiont_states"]))


@pytest.mark.parametrize("make", ["nothing", "empty folder", "text", "cut"])
def test_what_is_no_bag_is_refused_with_a_sentence(bag, tmp_path, make):
    path = tmp_path / "no_bag"
    if make == "empty folder":
        path.mkdir()
    elif make == "text":
        path.write_text("hello")
    elif make == "cut":
        path = bag
        [file] = bag.glob("*.mcap")
        file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(InvalidInputError, match="is not a bag that can be read"):
        BagReader(path)


def test_a_type_that_is_not_installed_is_refused_by_name():
    for kind in ("no_such_msgs/msg/Thing", "vgps_msgs/msg/NoSuchThing"):
        with pytest.raises(InvalidInputError, match=f"{kind} is not installed"):
            MessageDefinitions().find(kind)


def test_a_killed_writer_leaves_what_it_had_flushed(tmp_path):
    program = f"""
import os, signal
from pathlib import Path
from vgps_ros.bags import BagWriter
writer = BagWriter(Path({str(tmp_path / "bag")!r}))
writer.add_topic("/joint_states", {STATE!r}, "RIHS01_", [])
for i in range(10):
    writer.write("/joint_states", i, bytes(60))
writer.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""
    killed = subprocess.run([sys.executable, "-c", program], check=False)
    assert killed.returncode == -signal.SIGKILL
    [file] = (tmp_path / "bag").glob("*.mcap")
    stamps = []
    with file.open("rb") as stream, suppress(EndOfFile):
        reader = NonSeekingReader(stream, record_size_limit=None)
        stamps += (m.log_time for _, _, m in reader.iter_messages(log_time_order=False))
    assert stamps == list(range(10))
