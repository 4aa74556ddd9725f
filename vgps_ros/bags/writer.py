"""Writes a genuine rosbag2 bag with MCAP storage: one `.mcap` file and `metadata.yaml`."""

from collections.abc import Sequence
from pathlib import Path

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter

from vgps_ros.bags.definitions import MessageDefinitions
from vgps_ros.core.errors import InvalidInputError


class BagWriter:
    """A bag that is being written.

    Args:
        path: folder of the bag; it must not exist.

    Raises:
        InvalidInputError: the folder exists, or cannot be made.
    """

    def __init__(self, path: Path):
        self.path = path
        self._definitions = MessageDefinitions()
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
        except WriterError as error:
            raise InvalidInputError(
                f"The bag folder '{path}' exists already; name one that does not."
            ) from error
        except OSError as error:
            raise InvalidInputError(f"The bag folder '{path}' cannot be made: {error}.") from error

    @property
    def topics(self) -> list[str]:
        """Topics that messages can be written to."""
        return list(self._connections)

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(self._writer.counts.values())

    def add_topic(self, topic: str, kind: str, type_hash: str, qos: Sequence[Qos]) -> None:
        """Adds a topic.

        Args:
            topic: its full name.
            kind: its type, such as `sensor_msgs/msg/JointState`.
            type_hash: RIHS01 hash of the type, as the graph has it.
            qos: profiles that its publishers offer.

        Raises:
            InvalidInputError: the type's definition is not installed.
        """
        self._connections[topic] = self._writer.add_connection(
            topic,
            kind,
            msgdef=self._definitions.find(kind),
            rihs01=type_hash,
            offered_qos_profiles=qos,
        )

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Writes one message.

        Args:
            topic: a topic that was added.
            stamp: time at which it was received [ns].
            data: the message as CDR.
        """
        self._writer.write(self._connections[topic], stamp, data)

    def flush(self) -> None:
        """Hands all messages so far to the operating system: a killed process loses none of them.

        The file lacks its index until it is closed, but can be read from its start.
        """
        storage = self._writer.storage
        if isinstance(storage, McapWriter) and storage.chunk.msgs:
            storage.close_chunk()
            storage.bio.flush()

    def close(self) -> None:
        """Completes the bag: its index and `metadata.yaml`."""
        self._writer.close()
