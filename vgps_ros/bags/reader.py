"""Reads rosbag2 bags: their topics, and their messages in the order they were received."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag2.metadata import dump_qos_v9

from vgps_ros.bags.metadata import FILE_NAME
from vgps_ros.bags.reindex import missing_parts, storage_files
from vgps_ros.core.checks import one_of
from vgps_ros.core.errors import InvalidInputError

# What a graph has once for each robot.
_OF_A_ROBOT = {"joint_states", "joint_command", "policy", "robot_description"}


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

    Raises:
        InvalidInputError: the folder is not a bag, or its recorder did not close it.
    """

    def __init__(self, path: Path, namespace: str | None = None):
        self.path, self.namespace = path, namespace
        if not path.is_dir():
            raise InvalidInputError(f"'{path}' is not a bag: name the folder with {FILE_NAME}.")
        try:
            self._reader = AnyReader([path])
            self._reader.open()
        except Exception as error:
            # A damaged bag raises errors of many kinds from deep inside the libraries.
            raise InvalidInputError(
                missing_parts(path)
                or f"'{path}' is not a bag that can be read: {type(error).__name__}: "
                f"{error!s:.300}."
            ) from error
        connections = self._reader.connections
        self.topics = {c.topic: c.msgtype for c in connections}
        self.type_hashes = {c.topic: c.digest for c in connections}
        self.counts = {c.topic: c.msgcount for c in connections}
        self.start = self._reader.start_time
        # rosbags counts to 1 ns after the last message.
        self.duration = max(0, self._reader.duration - 1)
        self.damages: list[str] = []

    def __enter__(self) -> "BagReader":
        """Returns the open bag."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the bag."""
        self._reader.close()

    @property
    def qos(self) -> dict[str, list[dict[str, Any]]]:
        """The QoS profiles that the publishers of each topic offered, as in `metadata.yaml`."""
        return {
            c.topic: [dict(profile) for profile in dump_qos_v9(c.ext.offered_qos_profiles)]  # type: ignore[union-attr]
            for c in self._reader.connections
        }

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

    def attachments(self) -> dict[str, str]:
        """Returns the texts that the recorder attached to the bag, by their names."""
        found = {}
        for file in storage_files(self.path):
            with file.open("rb") as stream:
                for attachment in make_reader(stream).iter_attachments():
                    found[attachment.name] = attachment.data.decode()
        return found

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
        connections = [c for c in self._reader.connections if c.topic in wanted]
        for connection, stamp, data in self._reader.messages(connections):
            yield BagMessage(connection.topic, connection.msgtype, stamp, bytes(data))

    def decoded(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yields the time of receipt [ns] and the decoded message, for each message of a topic."""
        for message in self.messages([topic]):
            yield message.stamp, self.decode(message)

    def decode(self, message: BagMessage) -> Any:
        """Decodes a message with the definition that the bag holds.

        Returns:
            An object that has the message's fields as attributes.

        Raises:
            InvalidInputError: the message does not fit the definition.
        """
        try:
            return self._reader.deserialize(message.data, message.kind)
        except AnyReaderError as error:
            raise InvalidInputError(
                f"A message on {message.topic} at {message.stamp} ns is not a "
                f"valid {message.kind}: {error}."
            ) from error
