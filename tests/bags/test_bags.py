# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Bags without a graph: what is written is read back, and what is no bag is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from mcap.reader import make_reader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from vgps_ros.bags import BagReader, BagWriter, MessageDefinitions
from vgps_ros.core.errors import InvalidInputError

QOS = {
    "history": "keep_last",
    "depth": 7,
    "reliability": "reliable",
    "durability": "transient_local",
    "deadline": {"sec": 0, "nsec": 5},
    "lifespan": {"sec": 9223372036, "nsec": 854775807},
    "liveliness": "automatic",
    "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
    "avoid_ros_namespace_conventions": False,
}
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
    robot = types["vgps_msgs/msg/RobotModel"](1, "", [], [])
    policy = types[POLICY](
        header, "swimmer", robot, 3, ["x1", "x2"], np.array([2, 1], np.uint32), "tanh",
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
    assert writer.message_count == 3
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


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        ("nothing", "is not a bag: name a folder"),
        ("text", "is not a bag: name a folder"),
        ("empty folder", "is not a bag: name a folder"),
        ("cut", r"was not closed, or is damaged \(File end magic is invalid\); `vgps bag reindex"),
        ("no metadata", r"\(it has no metadata\.yaml\); `vgps bag reindex"),
        ("bad metadata", r"\(Invalid bag metadata: .*\); `vgps bag reindex"),
    ],
)
def test_what_is_no_whole_bag_is_refused_with_a_sentence(bag, tmp_path, make, sentence):
    path = tmp_path / "no_bag" if make in ("nothing", "text", "empty folder") else bag
    if make == "empty folder":
        path.mkdir()
    elif make == "text":
        path.write_text("hello")
    elif make == "cut":
        file = bag / "bag_0.mcap"
        file.write_bytes(file.read_bytes()[:-200])
    elif make == "no metadata":
        (bag / "metadata.yaml").unlink()
    elif make == "bad metadata":
        (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: 3")
    with pytest.raises(InvalidInputError, match=sentence):
        BagReader(path)


@pytest.mark.parametrize(
    "path", ["../outside.mcap", "{folder}/outside.mcap", "a/../../outside.mcap"]
)
def test_files_outside_the_bags_folder_are_never_read(bag, tmp_path, path):
    outside = tmp_path / "outside.mcap"
    outside.write_bytes((bag / "bag_0.mcap").read_bytes())
    metadata = bag / "metadata.yaml"
    named = path.format(folder=tmp_path)
    metadata.write_text(metadata.read_text().replace("bag_0.mcap", named))
    with pytest.raises(InvalidInputError, match="outside"):
        BagReader(bag)
    # A file of that name beside metadata.yaml is the one that is meant.
    (bag / "bag_0.mcap").rename(bag / "outside.mcap")
    outside.unlink()
    with BagReader(bag) as reader:
        assert len(list(reader.messages())) == 3


def test_a_type_that_is_not_installed_is_refused_by_name():
    for kind in ("no_such_msgs/msg/Thing", "vgps_msgs/msg/NoSuchThing"):
        with pytest.raises(InvalidInputError, match=f"{kind} is not installed"):
            MessageDefinitions().find(kind)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_bag_in_several_files_reads_as_one(tmp_path, store, compression):
    writer = BagWriter(tmp_path / "bag", compression=compression, max_file_duration=10)
    writer.attach("parameters.yaml", "old", 1)
    writer.attach("parameters.yaml", "new", 2)
    writer.add_topic("/a", STATE, store.hash_rihs01(STATE), [QOS])
    for i in range(1, 26):
        writer.write("/a", i, bytes([i] * 60))
    writer.close()
    names = [f"bag_{i}.mcap" for i in range(3)]
    assert sorted(file.name for file in writer.path.glob("*.mcap")) == names
    information = yaml.safe_load((writer.path / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert information["relative_file_paths"] == names
    assert [file["message_count"] for file in information["files"]] == [10, 10, 5]
    with BagReader(writer.path) as reader:
        assert [(m.stamp, m.data) for m in reader.messages()] == [
            (i, bytes([i] * 60)) for i in range(1, 26)
        ]
        assert reader.counts == {"/a": 25}
        assert (reader.start, reader.duration) == (1, 24)
        assert reader.qos == {"/a": [QOS]}
        assert reader.attachments() == {"parameters.yaml": "new"}
    for file in writer.path.glob("*.mcap"):  # each is self-contained
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
            assert [index.name for index in summary.attachment_indexes][-1] == "parameters.yaml"
            kinds = {index.compression for index in summary.chunk_indexes}
            assert kinds == {"" if compression == "none" else compression}


def test_files_split_by_size(tmp_path, store):
    writer = BagWriter(tmp_path / "bag", max_file_size=1_000_000)
    writer.add_topic("/a", STATE, store.hash_rihs01(STATE), [])
    for i in range(3000):
        writer.write("/a", i, bytes(1000))
    writer.close()
    sizes = sorted(file.stat().st_size for file in writer.path.glob("*.mcap"))
    assert len(sizes) == 3
    assert 1_000_000 <= sizes[-1] < 1_500_000


def test_an_existing_folder_is_refused_and_left_alone(bag):
    before = {file: file.read_bytes() for file in bag.iterdir()}
    with pytest.raises(InvalidInputError, match="exists already"):
        BagWriter(bag)
    assert {file: file.read_bytes() for file in bag.iterdir()} == before


def test_an_unknown_compression_names_the_known_ones(tmp_path):
    with pytest.raises(InvalidInputError, match="lz4, none, zstd"):
        BagWriter(tmp_path / "bag", compression="zip")


@pytest.mark.parametrize(
    ("storage", "mode"), [("SQLITE3", "NONE"), ("SQLITE3", "MESSAGE"), ("MCAP", "FILE")]
)
def test_what_rosbag2_stores_otherwise_is_read_too(tmp_path, store, messages, storage, mode):
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin[storage])
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        policy = writer.add_connection("/policy", POLICY, typestore=store)
        states = writer.add_connection("/joint_states", STATE, typestore=store)
        for topic, stamp, data in messages:
            writer.write(policy if topic == "/policy" else states, stamp, data)
    with BagReader(tmp_path / "bag") as reader:
        found = list(reader.messages())
        assert [(m.topic, m.stamp, m.data) for m in found] == messages
        assert reader.decode(found[0]).task == "swimmer"
        assert (reader.counts, reader.duration) == ({"/policy": 1, "/joint_states": 2}, 4)
        assert reader.attachments() == {}
