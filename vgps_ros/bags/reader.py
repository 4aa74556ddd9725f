"""Reads rosbag2 bags: which topics there are, and their messages in the order they came."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection

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
        InvalidInputError: there is no complete bag.
    """

    def __init__(self, path: Path):
        try:
            self._reader = AnyReader([path])
            self._reader.open()
        except (AnyReaderError, OSError) as error:
            raise InvalidInputError(
                f"'{path}' is not a bag that can be read; name the folder that has metadata.yaml: "
                f"{error}"
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

    def messages(self, topics: Sequence[str] | None = None) -> Iterator[BagMessage]:
        """Yields messages in the order in which they were received.

        Args:
            topics: which ones; all of them if it is None.

        Raises:
            InvalidInputError: a topic is not in the bag.
        """
        for connection, stamp, data in self._reader.messages(self._connections(topics)):
            yield BagMessage(connection.topic, connection.msgtype, stamp, bytes(data))

    def decode(self, message: BagMessage) -> Any:
        """Returns the message's fields as attributes, by the definition that the bag holds."""
        return self._reader.deserialize(message.data, message.kind)

    def _connections(self, topics: Sequence[str] | None) -> list[Connection]:
        if topics is None:
            return self._reader.connections
        for topic in topics:
            one_of("topic", topic, self.topics)
        return [c for c in self._reader.connections if c.topic in topics]
