"""Reads rosbag2 bags: which topics there are, and their messages in the order they came."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2.metadata import dump_qos_v9

from vgps_ros.bags.metadata import FILE_NAME
from vgps_ros.bags.reindex import missing_parts, storage_files
from vgps_ros.core.checks import one_of
from vgps_ros.core.errors import InvalidInputError


@dataclass(frozen=True)
class BagMessage:
    """One recorded message.

    Attributes:
        topic: where it was published.
        kind: its type, such as `sensor_msgs/msg/JointState`.
        stamp: time at which it was received [ns].
        data: the message as CDR.
    """

    topic: str
    kind: str
    stamp: int
    data: bytes


class BagReader:
    """An open bag; use it in a `with` statement.

    Args:
        path: folder of the bag.

    Raises:
        InvalidInputError: there is no bag, or it was not closed properly.
    """

    def __init__(self, path: Path):
        self.path = path
        if not path.is_dir():
            raise InvalidInputError(f"'{path}' is not a bag: name the folder with {FILE_NAME}.")
        try:
            self._reader = AnyReader([path])
            self._reader.open()
        except Exception as error:
            # A damaged bag fails in many ways, deep inside what reads it.
            raise InvalidInputError(
                missing_parts(path)
                or f"'{path}' is not a bag that can be read: {type(error).__name__}: "
                f"{error!s:.300}."
            ) from error

    def __enter__(self) -> "BagReader":
        """Returns the open bag."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Closes the bag."""
        self._reader.close()

    @property
    def topics(self) -> dict[str, str]:
        """The type of each topic."""
        return {c.topic: c.msgtype for c in self._reader.connections}

    @property
    def type_hashes(self) -> dict[str, str]:
        """The RIHS01 hash of each topic's type."""
        return {c.topic: c.digest for c in self._reader.connections}

    @property
    def qos(self) -> dict[str, list[dict[str, Any]]]:
        """The profiles that each topic's publishers offered, as `metadata.yaml` has them."""
        return {
            c.topic: [dict(profile) for profile in dump_qos_v9(c.ext.offered_qos_profiles)]  # type: ignore[union-attr]
            for c in self._reader.connections
        }

    @property
    def counts(self) -> dict[str, int]:
        """Messages of each topic."""
        return {c.topic: c.msgcount for c in self._reader.connections}

    @property
    def start(self) -> int:
        """Time at which the first message was received [ns]."""
        return self._reader.start_time

    @property
    def duration(self) -> int:
        """Time from the first message to the last one [ns]."""
        return max(0, self._reader.duration - 1)  # rosbags counts to just after the last one

    def attachments(self) -> dict[str, str]:
        """Returns the texts that the recorder put beside the messages, by name."""
        found = {}
        for file in storage_files(self.path):
            with file.open("rb") as stream:
                for attachment in make_reader(stream).iter_attachments():
                    found[attachment.name] = attachment.data.decode()
        return found

    def messages(self, topics: Sequence[str] | None = None) -> Iterator[BagMessage]:
        """Yields messages in the order in which they were received.

        Args:
            topics: which ones; all of them if it is None.

        Raises:
            InvalidInputError: a topic is not in the bag.
        """
        for connection, stamp, data in self._reader.messages(self._connections(topics)):
            yield BagMessage(connection.topic, connection.msgtype, stamp, bytes(data))

    def decoded(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yields when each message of a topic was received [ns], and its fields as attributes."""
        for message in self.messages([topic]):
            yield message.stamp, self.decode(message)

    def decode(self, message: BagMessage) -> Any:
        """Returns the message's fields as attributes, by the definition that the bag holds.

        Raises:
            InvalidInputError: the message does not fit the definition.
        """
        try:
            return self._reader.deserialize(message.data, message.kind)
        except AnyReaderError as error:
            raise InvalidInputError(
                f"A message on {message.topic} at {message.stamp} ns is no {message.kind}: {error}"
            ) from error

    def _connections(self, topics: Sequence[str] | None) -> list[Connection]:
        if topics is None:
            return self._reader.connections
        for topic in topics:
            one_of("topic", topic, self.topics)
        return [c for c in self._reader.connections if c.topic in topics]
