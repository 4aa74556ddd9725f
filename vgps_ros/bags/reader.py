# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads rosbag2 bags: their topics, and their messages in the order they were received."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from typing import Any

from vgps_ros.bags.decoder import Decoder
from vgps_ros.bags.metadata import FILE_NAME, type_hashes
from vgps_ros.bags.reindex import missing_of, storage_files
from vgps_ros.bags.storage import StorageScan
from vgps_ros.core.checks import one_of
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.names import MJCF, URDF, is_mjcf

# What a graph has once for each robot.
_OF_A_ROBOT = {"joint_states", "joint_command", "policy", "onnx_policy", MJCF, URDF}


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
        self.files = [StorageScan(file) for file in storage_files(path)]
        if missing := missing_of(path, self.files):
            raise InvalidInputError(missing)
        topics = [topic for file in self.files for topic in file.topics.values()]
        self.topics = {topic.name: topic.kind for topic in topics}
        told = type_hashes(path)
        self.type_hashes = {t.name: t.type_hash or told.get(t.name, "") for t in topics}
        self.qos = {topic.name: list(topic.qos) for topic in topics}
        counts = sum((Counter(file.summary.counts) for file in self.files), Counter[str]())
        self.counts = {topic: counts[topic] for topic in self.topics}
        written = [file.summary for file in self.files if file.summary.message_count]
        self.start = min((summary.start for summary in written), default=0)
        self.duration = max((summary.end for summary in written), default=0) - self.start
        self.damages = [sentence for file in self.files for sentence in file.damages]
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
            raise self._lack_of(name)
        return topics[name]

    def _lack_of(self, name: str) -> InvalidInputError:
        return InvalidInputError(
            f"'{self.path}' has no messages on {name}"
            f"{f' for {self.namespace}' if self.namespace else ''}; `vgps bag info "
            f"{self.path}` lists the topics that it has."
        )

    def mjcf(self) -> str:
        """Returns the robot's MJCF, also of a bag of an old version.

        Raises:
            InvalidInputError: the bag lacks it.
        """
        for name in (MJCF, URDF):
            if name in self.filled_topics:
                text: str = next(self.decoded(self.filled_topics[name]))[1].data
                if is_mjcf(name, text):
                    return text
        raise self._lack_of(MJCF)

    def attachments(self) -> dict[str, str]:
        """Returns the texts that the recorder attached to the bag, by their names."""
        return {name: data.decode(errors="replace") for name, data in self.attached().items()}

    def attached(self) -> dict[str, bytes]:
        """Returns all that is attached to the bag, which need not be text, by its names."""
        return {a.name: a.data for file in self.files for a in file.content.attachments}

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
        places = [
            (place.start, i, place) for i, f in enumerate(self.files) for place in f.content.places
        ]
        # Chunks overlap in time where topics do, so messages wait for those of the chunks to come.
        waiting: list[tuple[int, int, BagMessage]] = []
        order = count()
        for start, file, place in sorted(places, key=lambda one: one[:2]):
            while waiting and waiting[0][0] < start:
                yield heappop(waiting)[2]
            for of, raw in self.files[file].messages(place):
                if of.name in wanted:
                    message = BagMessage(of.name, of.kind, raw.stamp, raw.data)
                    heappush(waiting, (raw.stamp, next(order), message))
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
            InvalidInputError: the message does not fit the definition.
        """
        try:
            return self._decoder.decode(message.data, message.kind)
        except InvalidInputError as error:
            raise InvalidInputError(
                f"A message on {message.topic} at {message.stamp} ns is not a "
                f"valid {message.kind}: {error}."
            ) from error

    @property
    def types_read(self) -> set[str]:
        """The types of the messages that were decoded so far, and of their fields."""
        return self._decoder.types

    def definition_hash(self, kind: str) -> str:
        """Returns the RIHS01 hash of the definition that the bag holds of a type.

        Raises:
            InvalidInputError: it is not a definition.
        """
        try:
            return self._decoder.hash(kind)
        except InvalidInputError as error:
            raise InvalidInputError(
                f"The definition of {kind} in '{self.path}' cannot be read: {error}."
            ) from error
