# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads rosbag2 bags: their topics, and their messages in the order they were received."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.records import Attachment
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vgps_ros.bags.metadata import FILE_NAME, is_being_written, storage_files
from vgps_ros.core.checks import error_text, one_of
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.names import GAINS, MJCF, URDF, installed_hash

# What a graph has once for each robot.
_OF_A_ROBOT = {"joint_states", "joint_command", "policy", "onnx_policy", MJCF, URDF}

_OWN = "vgps_msgs/msg/"


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
        qos: QoS profiles that the publishers of each topic offered, as in `metadata.yaml`.

    Raises:
        InvalidInputError: the folder is not a bag, its recorder did not close it, or it is damaged.
    """

    def __init__(self, path: Path, namespace: str | None = None):
        self.path, self.namespace = path, namespace
        if not (path / FILE_NAME).exists():
            raise self._unreadable(FileNotFoundError(f"it has no {FILE_NAME}"))
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:  # of many kinds, raised deep inside rosbags
            raise self._unreadable(error) from error
        connections: list[Any] = self._reader.connections
        self.topics = {of.topic: of.msgtype for of in connections}
        self.type_hashes = {of.topic: of.digest for of in connections}
        self.qos: dict[str, Any] = {
            of.topic: dump_qos_v9(of.ext.offered_qos_profiles) for of in connections
        }
        self.counts = Counter[str]()
        for of in connections:
            self.counts[of.topic] += of.msgcount
        is_filled = bool(self._reader.message_count)
        self.start = self._reader.start_time * is_filled
        self.duration = self._reader.duration - is_filled
        self._definitions = {of.msgtype: of.msgdef.data for of in connections}
        self._store = get_typestore(Stores.EMPTY)
        self._checked: set[str] = set()  # types of vgps_msgs that are the installed ones

    def __enter__(self) -> "BagReader":
        """Returns the open bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the bag."""
        self.close()

    def close(self) -> None:
        """Closes the bag."""
        self._reader.close()

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
        """Returns all that is attached to the bag, which need not be text, by its names.

        Raises:
            InvalidInputError: the bag is damaged.
        """
        try:
            return {a.name: a.data for file in storage_files(self.path) for a in _attachments(file)}
        except Exception as error:  # of many kinds, raised deep inside mcap
            raise self._unreadable(error) from error

    def messages(self, topics: Sequence[str] | None = None) -> Iterator[BagMessage]:
        """Yields the messages of each file in the order in which they were received.

        Args:
            topics: topics whose messages are read; all topics if None.

        Raises:
            InvalidInputError: a topic is not in the bag, or the bag is damaged.
        """
        for topic in topics or ():
            one_of("topic", topic, self.topics)
        wanted = [of for of in self._reader.connections if topics is None or of.topic in topics]
        found = not sum(self.counts[of.topic] for of in wanted)
        try:
            for of, stamp, data in self._reader.messages(wanted) if wanted else ():
                found = True
                yield BagMessage(of.topic, of.msgtype, stamp, data)
        except Exception as error:  # of many kinds, raised deep inside rosbags
            raise self._unreadable(error) from error
        if not found:
            raise self._unreadable(ValueError("the messages that it tells of are not there"))

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
            return self._by_store(
                message.kind, lambda: self._store.deserialize_cdr(message.data, message.kind)
            )
        except InvalidInputError as error:
            raise InvalidInputError(
                f"A message on {message.topic} at {message.stamp} ns is not a "
                f"valid {message.kind}: {error}."
            ) from error

    def _check_definition(self, kind: str) -> None:
        if kind not in self._checked:
            recorded = self._by_store(kind, lambda: self._store.hash_rihs01(kind))
            if recorded != installed_hash(kind):
                raise InvalidInputError(
                    "it was recorded with another definition than the installed one; use the "
                    f"version that `vgps bag info {self.path}` names"
                )
            self._checked.add(kind)

    def _by_store(self, kind: str, found: Callable[[], Any]) -> Any:
        try:
            if kind not in self._store.fielddefs:
                self._store.register(get_types_from_msg(self._definitions[kind], kind))
            return found()
        except Exception as error:  # of many kinds, raised deep inside rosbags
            raise InvalidInputError(error_text(error)) from error

    def _unreadable(self, cause: Exception) -> InvalidInputError:
        """Returns the error of a bag that is not whole."""
        path, files = self.path, storage_files(self.path)
        if not (files or (path / FILE_NAME).is_file()):
            sentence = f"'{path}' is not a bag: name a folder with {FILE_NAME} and .mcap files."
        elif any(is_being_written(file) for file in files):
            sentence = f"The bag '{path}' is still being recorded; end its recorder first."
        else:
            sentence = (
                f"The bag '{path}' was not closed, or is damaged ({error_text(cause)}); "
                f"`vgps bag reindex {path}` keeps what can be read."
            )
        return InvalidInputError(sentence)


def _attachments(path: Path) -> Iterator[Attachment]:
    with path.open("rb") as file:
        yield from make_reader(file).iter_attachments()
