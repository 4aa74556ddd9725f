# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads rosbag2 bags: their topics, and their messages in the order they were received."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vgps_ros.bags.mcap_file import McapFile, is_being_written
from vgps_ros.bags.metadata import FILE_NAME, read_metadata
from vgps_ros.core.checks import one_of, told
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.names import GAINS, MJCF, URDF, installed_hash

# What a graph has once for each robot.
_OF_A_ROBOT = {"joint_states", "joint_command", "policy", "onnx_policy", MJCF, URDF}

_OWN = "vgps_msgs/msg/"
_LONGEST = 2**18  # definition that is read [characters]
_MOST_PARTS = 1024  # of arrays of a fixed size, for each of which rosbags writes lines of code


@dataclass(frozen=True)
class BagMessage:
    """One recorded message.

    Attributes:
        topic: topic on which it was published.
        kind: message type, such as `sensor_msgs/msg/JointState`.
        stamp: time at which it was received [ns].
        data: the message, serialised as CDR.
    """

    topic: str
    kind: str
    stamp: int
    data: bytes


class BagReader:
    """An open bag; use it in a `with` statement.

    Args:
        path: folder of the bag.
        namespace: of the robot whose topics are meant, such as `/robot1`. It may be left out for a
            bag of one robot.

    Attributes:
        path: folder of the bag.
        namespace: the namespace that was given, or None.
        topics: type of each topic.
        type_hashes: type hash of each topic, in the format RIHS01.
        counts: number of messages of each topic.
        start: time at which the first message was received [ns].
        duration: time from the first message to the last one [ns].
        files: what was found in each file.
        qos: QoS profiles that the publishers of each topic offered, as in `metadata.yaml`.
        damages: a sentence on each part of the files that is damaged; all the rest is read.

    Raises:
        InvalidInputError: the folder is not a bag, or its recorder did not close it.
    """

    def __init__(self, path: Path, namespace: str | None = None):
        self.path, self.namespace = path, namespace
        if not path.is_dir():
            raise InvalidInputError(f"'{path}' is not a bag: name the folder with {FILE_NAME}.")
        self.files = [McapFile(file) for file in storage_files(path)]
        if missing := missing_parts(path, self.files):
            raise InvalidInputError(missing)
        topics = [topic for file in self.files for topic in file.topics.values()]
        self.topics = {topic.name: topic.kind for topic in topics}
        _, told = read_metadata(path) or ((), {})
        self.type_hashes = {t.name: t.type_hash or told.get(t.name, "") for t in topics}
        self.qos = {topic.name: list(topic.qos) for topic in topics}
        counts = sum((Counter(file.summary.counts) for file in self.files), Counter[str]())
        self.counts = {topic: counts[topic] for topic in self.topics}
        written = [file.summary for file in self.files if file.summary.message_count]
        self.start = min((summary.start for summary in written), default=0)
        self.duration = max((summary.end for summary in written), default=0) - self.start
        self.damages = [sentence for file in self.files for sentence in file.damages]
        self._checked: set[str] = set()  # types of vgps_msgs that are the installed ones
        self._decoder = Decoder({topic.kind: topic.definition for topic in topics})

    def __enter__(self) -> "BagReader":
        """Returns the open bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Ends the use of the bag."""

    @property
    def filled_topics(self) -> dict[str, str]:
        """The robot's topics that have messages, by the last part of their names.

        Raises:
            InvalidInputError: there are several robots, and no namespace was given.
        """
        filled = [topic for topic, n in self.counts.items() if n]
        names = [topic.rpartition("/")[2] for topic in self.of_robot(filled)]
        several = _OF_A_ROBOT & {name for name in names if names.count(name) > 1}
        if several and self.namespace is None:
            topics = sorted(topic for topic in filled if topic.rpartition("/")[2] in several)
            robots = sorted({topic.rpartition("/")[0] or "/" for topic in topics})
            raise InvalidInputError(
                f"'{self.path}' has several robots ({', '.join(topics)}); choose one with "
                f"--namespace, which is one of {', '.join(robots)}."
            )
        return dict(zip(reversed(names), reversed(self.of_robot(filled)), strict=True))

    def of_robot_nodes(self, name: str) -> list[str]:
        """Returns the topics of this name that the robot's nodes have for themselves."""
        nodes = [
            topic.removesuffix(f"/{name}") for topic in self.topics if topic.endswith(f"/{name}")
        ]
        return [f"{node}/{name}" for node in self.of_robot(nodes)]

    def of_robot(self, names: Iterable[str]) -> list[str]:
        """Returns those full names of topics or nodes that may be the robot's.

        They are those in its namespace, and then those in the namespaces above it, whose nodes may
        serve several robots. Without a namespace they are all names.
        """
        if self.namespace is None:
            return list(names)
        inside = f"{self.namespace.rstrip('/')}/"
        above = [name for name in names if inside.startswith(f"{name.rpartition('/')[0]}/")]
        return sorted(above, key=lambda name: name.count("/"), reverse=True)

    def needed_topic(self, name: str) -> str:
        """Returns the full name of a topic, given the last part of it.

        Raises:
            InvalidInputError: there is no such topic, or it has no messages.
        """
        if name not in (topics := self.filled_topics):
            raise InvalidInputError(
                f"'{self.path}' has no messages on {name}"
                f"{f' for {self.namespace}' if self.namespace else ''}; `vgps bag info "
                f"{self.path}` lists the topics that it has."
            )
        return topics[name]

    def mjcf(self) -> str:
        """Returns the robot's MJCF, with the loops that its joints close.

        Raises:
            InvalidInputError: the bag lacks it, or the gains of the loops do not fit it.
        """
        mjcf = self.recorded_mjcf()
        if GAINS not in self.filled_topics:
            return mjcf
        # Slow to import, and `vgps bag --help` needs none of it.
        from vgps_ros.messages.conversions import gains_from_msg
        from vgps_ros.simulation.controls import closed_loops, controls_of
        from vgps_ros.simulation.model import compile_model

        gains = next(self.decoded(self.filled_topics[GAINS]))[1]
        return closed_loops(mjcf, *gains_from_msg(gains, controls_of(compile_model(mjcf))))

    def recorded_mjcf(self) -> str:
        """Returns the robot's MJCF as it was published.

        Raises:
            InvalidInputError: the bag lacks it.
        """
        text: str = next(self.decoded(self.needed_topic(MJCF)))[1].data
        return text

    def attachments(self) -> dict[str, str]:
        """Returns the texts that the recorder attached to the bag, by their names."""
        return {name: data.decode(errors="replace") for name, data in self.attached().items()}

    def attached(self) -> dict[str, bytes]:
        """Returns all that is attached to the bag, which need not be text, by its names."""
        return {a.name: a.data for file in self.files for a in file.attachments}

    def messages(self, topics: Sequence[str] | None = None) -> Iterator[BagMessage]:
        """Yields messages in the order in which they were received.

        Args:
            topics: topics whose messages are read; all topics if None.

        Raises:
            InvalidInputError: a topic is not in the bag.
        """
        for topic in topics or ():
            one_of("topic", topic, self.topics)
        wanted = self.topics if topics is None else topics
        pieces = [(piece.start, i, piece) for i, f in enumerate(self.files) for piece in f.pieces]
        # Chunks overlap in time where topics do, so messages wait for those of the chunks to come.
        waiting: list[tuple[int, int, BagMessage]] = []
        order = count()
        for start, file, piece in sorted(pieces, key=lambda one: one[:2]):
            while waiting and waiting[0][0] < start:
                yield heappop(waiting)[2]
            for of, raw in self.files[file].messages([piece]):
                if of.name in wanted:
                    message = BagMessage(of.name, of.kind, raw.log_time, raw.data)
                    heappush(waiting, (raw.log_time, next(order), message))
        while waiting:
            yield heappop(waiting)[2]

    def decoded(self, *topics: str, refused: list[str] | None = None) -> Iterator[tuple[int, Any]]:
        """Yields the time of receipt [ns] and the decoded message, for each message of some topics.

        Args:
            topics: full names of the topics.
            refused: takes a sentence on each message that cannot be read; without it, one raises.

        Raises:
            InvalidInputError: a topic is not in the bag, or a message does not fit its definition.
        """
        for message in self.messages(topics):
            try:
                decoded = self.decode(message)
            except InvalidInputError as error:  # noqa: PERF203
                if refused is None:
                    raise
                refused.append(str(error))
            else:
                yield message.stamp, decoded

    def decode(self, message: BagMessage) -> Any:
        """Decodes a message with the definition that the bag holds.

        Returns:
            An object that has the message's fields as attributes.

        Raises:
            InvalidInputError: the message does not fit the definition, or that is one of vgps_msgs,
                but not the installed one.
        """
        try:
            if message.kind.startswith(_OWN):
                self._check_definition(message.kind)
            return self._decoder.decode(message.data, message.kind)
        except InvalidInputError as error:
            raise InvalidInputError(
                f"A message on {message.topic} at {message.stamp} ns is not a "
                f"valid {message.kind}: {error}."
            ) from error

    def _check_definition(self, kind: str) -> None:
        if kind not in self._checked and self._decoder.type_hash(kind) != installed_hash(kind):
            raise InvalidInputError(
                "it was recorded with another definition than the installed one; use the version "
                f"that `vgps bag info {self.path}` names"
            )
        self._checked.add(kind)


def storage_files(path: Path) -> list[Path]:
    """Returns the `.mcap` files in a bag's folder, in the order in which they were written.

    Raises:
        InvalidInputError: the folder has no such file.
    """
    found = [file for file in path.glob("*.mcap") if file.is_file()]  # no pipe, no device
    files = sorted(found, key=lambda file: (len(file.name), file.name))
    if not files:
        raise InvalidInputError(
            f"'{path}' is not a bag: it must be a folder with .mcap files, and there is none."
        )
    return files


def missing_parts(path: Path, files: Sequence[McapFile] = ()) -> str:
    """Returns a sentence on what a bag lacks and what can be read of it; "" if it is complete.

    Raises:
        InvalidInputError: the folder has no `.mcap` file, or its description cannot be read.
    """
    files = files or [McapFile(file) for file in storage_files(path)]
    lacks = [f"the index of {file.path.name}" for file in files if not file.is_complete]
    if (described := read_metadata(path)) is None:
        lacks.insert(0, f"a whole {FILE_NAME}" if (path / FILE_NAME).exists() else FILE_NAME)
    elif absent := set(described[0]) - {file.path.name for file in files}:
        lacks.insert(0, f"the file {', '.join(sorted(absent))}")
    if not lacks:
        return ""
    if any(is_being_written(file.path) for file in files):
        return f"The bag '{path}' is still being recorded; end its recorder first."
    written = [file.summary for file in files if file.summary.message_count]
    if not written:
        return (
            f"'{path}' lacks {' and '.join(lacks)}, and no message in it can be read: it is no "
            "bag, or all of it is lost; name another one."
        )
    count = sum(summary.message_count for summary in written)
    duration = max(s.end for s in written) - min(s.start for s in written)
    return (
        f"The bag '{path}' was not closed: it lacks {' and '.join(lacks)}. {count} messages over "
        f"{duration * 1e-9:.3f} s can be read, and all others are lost; "
        f"`vgps bag reindex {path}` repairs it."
    )


class Decoder:
    """Decodes messages with the definitions of types by name, which an untrusted bag holds."""

    def __init__(self, definitions: Mapping[str, str]):
        self._definitions = definitions
        self._store = get_typestore(Stores.EMPTY)
        self._parts = 0

    def decode(self, data: bytes, kind: str) -> Any:
        """Returns an object that has the fields of a message, which is CDR, as attributes.

        Raises:
            InvalidInputError: the message does not fit the definition; the error ends with the
                cause.
        """
        return self._by_store(kind, lambda: self._store.deserialize_cdr(data, kind))

    def type_hash(self, kind: str) -> str:
        """Returns the RIHS01 hash of a definition.

        Raises:
            InvalidInputError: it is no definition that is read.
        """
        return str(self._by_store(kind, lambda: self._store.hash_rihs01(kind)))

    def _by_store(self, kind: str, found: Callable[[], Any]) -> Any:
        try:
            if kind not in self._store.fielddefs:
                self._store.register(self._types(kind))
            return found()
        except Exception as error:  # of many kinds, raised deep inside rosbags
            raise InvalidInputError(told(error)) from error

    def _types(self, kind: str) -> Typesdict:
        """Reads a definition.

        Raises:
            ValueError: its code, or reading it, would take too much memory.
            Exception: it is no definition.
        """
        definition = self._definitions[kind]
        if len(definition) > _LONGEST:
            raise ValueError(
                f"its definition has {len(definition)} characters, and at most {_LONGEST} are read"
            )
        types = get_types_from_msg(definition, kind)
        self._parts += sum(_parts(field) for _, fields in types.values() for _, field in fields)
        if self._parts > _MOST_PARTS:
            raise ValueError(
                f"with its definition there are {self._parts} texts and messages in arrays of a "
                f"fixed size, and at most {_MOST_PARTS} are read"
            )
        return types


def _parts(field: FieldDesc) -> int:
    """Returns how many parts a field has that are decoded one by one, as numbers are not."""
    if field[0] != Nodetype.ARRAY:
        return 0
    (kind, name), size = field[1]
    return 0 if kind == Nodetype.BASE and name[0] not in ("string", "wstring") else int(size)
