"""Writes a genuine rosbag2 bag with MCAP storage: `.mcap` files and `metadata.yaml`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vgps_ros.bags.definitions import MessageDefinitions
from vgps_ros.bags.metadata import FILE_NAME, FileSummary, bag_information, metadata_file
from vgps_ros.bags.storage import StorageWriter, Topic
from vgps_ros.core.errors import InvalidInputError


class BagWriter:
    """A bag that is being written.

    Args:
        path: folder of the bag; it must not exist.
        compression: of the files' chunks: none, lz4 or zstd.
        max_file_size: begin a new file beyond this size [bytes]; 0: never.
        max_file_duration: begin a new file after this time [ns]; 0: never.

    Raises:
        InvalidInputError: the folder exists, or cannot be made.
    """

    def __init__(
        self,
        path: Path,
        *,
        compression: str = "none",
        max_file_size: int = 0,
        max_file_duration: int = 0,
    ):
        self.path = path
        self._compression = compression
        self._max_file_size = max_file_size
        self._max_file_duration = max_file_duration
        self._splits = bool(max_file_size or max_file_duration)
        self._definitions = MessageDefinitions()
        self._topics: dict[str, Topic] = {}
        self._attachments: dict[str, tuple[bytes, int]] = {}
        self._finished: list[FileSummary] = []
        self._is_closed = False
        try:
            path.mkdir(parents=True)
            self._file = self._new_file()
        except FileExistsError as error:
            raise InvalidInputError(
                f"The bag folder '{path}' exists already; name one that does not."
            ) from error
        except OSError as error:
            raise InvalidInputError(f"The bag folder '{path}' cannot be made: {error}.") from error

    @property
    def topics(self) -> list[str]:
        """Topics that messages can be written to."""
        return list(self._topics)

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        unfinished = 0 if self._is_closed else sum(self._file.counts.values())
        return sum(summary.message_count for summary in self._finished) + unfinished

    def add_topic(
        self, name: str, kind: str, type_hash: str, qos: Sequence[dict[str, Any]]
    ) -> None:
        """Adds a topic; see `Topic`.

        Raises:
            InvalidInputError: the type's definition is not installed.
        """
        topic = Topic(name, kind, type_hash, qos, self._definitions.find(kind))
        self._topics[name] = topic
        self._file.add_topic(topic)

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Writes one message.

        Args:
            topic: a topic that was added.
            stamp: time at which it was received [ns].
            data: the message as CDR.
        """
        if self._splits and self._is_full(stamp):
            self._split()
        self._file.write(topic, stamp, data)

    def attach(self, name: str, text: str, stamp: int) -> None:
        """Adds a named text to this file and to those that follow; a later one replaces it."""
        self._attachments[name] = (text.encode(), stamp)
        self._file.attach(name, *self._attachments[name])

    def flush(self) -> None:
        """Hands all messages so far to the operating system: a killed process loses none of them.

        The file lacks its index until it is closed, but can be read from its start.
        """
        self._file.flush()

    def close(self) -> None:
        """Completes the bag: the last file's index and `metadata.yaml`."""
        self._finish_file()
        self._is_closed = True
        information = bag_information(self._topics.values(), self._finished)
        (self.path / FILE_NAME).write_text(metadata_file(information))

    def _is_full(self, stamp: int) -> bool:
        if self._max_file_size and self._file.size >= self._max_file_size:
            return True
        if self._max_file_duration and self._file.start:
            return stamp - self._file.start >= self._max_file_duration
        return False

    def _split(self) -> None:
        self._finish_file()
        self._file = self._new_file()
        for topic in self._topics.values():
            self._file.add_topic(topic)
        for name, attachment in self._attachments.items():
            self._file.attach(name, *attachment)

    def _new_file(self) -> StorageWriter:
        name = f"{self.path.name}_{len(self._finished)}.mcap"  # as rosbag2 counts them
        return StorageWriter(self.path / name, self._compression)

    def _finish_file(self) -> None:
        file = self._file
        summary = FileSummary(file.path.name, file.start, file.end, file.counts)
        self._finished.append(summary)
        file.close(bag_information(self._topics.values(), self._finished))
