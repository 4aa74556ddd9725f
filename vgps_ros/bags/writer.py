# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a genuine rosbag2 bag with MCAP storage: `.mcap` files and `metadata.yaml`."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from vgps_ros.bags.definitions import MessageDefinitions
from vgps_ros.bags.manifest import FILE_NAME as MANIFEST
from vgps_ros.bags.manifest import PackedDigest, write_manifest
from vgps_ros.bags.metadata import FILE_NAME as METADATA
from vgps_ros.bags.metadata import bag_information, write_metadata
from vgps_ros.bags.storage import FileSummary, Topic
from vgps_ros.bags.storage_writer import StorageWriter
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.storage.disk import Disk, DiskFile

_PATIENCE = 0.8  # with a disk that does not move, at the end [s]


class UnfinishedBagError(VgpsError):
    """A bag lacks its index or `metadata.yaml`, since the disk did not take them."""


class BagWriter:
    """A bag that is being written.

    Messages wait in memory for a disk that is slow or full, up to a limit; those beyond it are
    counted as lost.

    Args:
        path: folder of the bag; it must not exist.
        compression: of the files' chunks: none, lz4 or zstd.
        max_file_size: begin a new file beyond this size [bytes]; 0: never.
        max_file_duration: begin a new file after this time [ns]; 0: never.
        max_backlog: what may wait for the disk [bytes].
        min_space: what is left free on the disk until the bag is closed [bytes].

    Attributes:
        path: the folder.
        topics: topics that messages can be written to, by their names.
        lost: number of messages that could not be written; the manifest states it, so who knows of
            others that never came here may add to it.
        disk: the disk, which says what waits for it and why nothing can be written now.

    Raises:
        InvalidInputError: the folder exists, cannot be made or cannot be written to.
    """

    def __init__(
        self,
        path: Path,
        *,
        compression: str = "none",
        max_file_size: int = 0,
        max_file_duration: int = 0,
        max_backlog: float = math.inf,
        min_space: int = 0,
    ):
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.lost = 0
        self._compression = compression
        self._max_file_size = max_file_size
        self._max_file_duration = max_file_duration
        self._max_backlog = max_backlog
        self._definitions = MessageDefinitions()
        self._attachments: dict[str, tuple[bytes, int]] = {}
        self._digests: dict[str, PackedDigest] = {}  # of the files that have all of their content
        self._finished: list[FileSummary] = []  # files that are on the disk as a whole
        self._files: list[_BagFile] = []  # those that are not; the last one takes the messages
        try:
            path.mkdir(parents=True)
        except FileExistsError as error:
            raise InvalidInputError(
                f"The bag folder '{path}' exists already; name one that does not."
            ) from error
        except OSError as error:
            raise InvalidInputError(f"The bag folder '{path}' cannot be made: {error}.") from error
        self.disk = Disk(min_space)
        self._begin_file()
        self.disk.drain(_PATIENCE)
        if fault := self.disk.fault:
            self.disk.stop()
            with suppress(OSError):
                self._file.on_disk.path.unlink(missing_ok=True)
                path.rmdir()
            raise InvalidInputError(
                f"The bag folder '{path}' cannot be written to: {fault.reason}; {fault.next_step}, "
                "or name another folder."
            )

    @property
    def message_count(self) -> int:
        """Messages written so far, those included that wait for the disk."""
        return sum(summary.message_count for summary in self._summaries())

    def add_topic(
        self, name: str, kind: str, type_hash: str, qos: Sequence[dict[str, Any]]
    ) -> None:
        """Adds a topic; see `Topic`.

        Raises:
            InvalidInputError: the type's definition is not installed.
        """
        topic = Topic(name, kind, type_hash, qos, self._definitions.find(kind))
        self.topics[name] = topic
        self._file.add_topic(topic)

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Writes one message, or counts it as lost.

        Args:
            topic: a topic that was added.
            stamp: time at which it was received [ns].
            data: the message as CDR.
        """
        if self.disk.backlog > self._max_backlog:
            self.lost += 1
            return
        size, duration, file = self._max_file_size, self._max_file_duration, self._file
        is_long = duration and file.start and stamp - file.start >= duration
        if is_long or (size and file.on_disk.tell() >= size):
            self._complete(file)
            self._begin_file()
        self._file.write(topic, stamp, data)

    def attach(self, name: str, text: str, stamp: int) -> None:
        """Adds a named text to this file and to those that follow; a later one replaces it."""
        self._attachments[name] = (text.encode(), stamp)
        self._file.attach(name, *self._attachments[name])

    def flush(self, *, wait: bool = True) -> None:
        """Hands all messages so far to the disk; once it has them, a killed process loses none.

        The file lacks its index until it is closed, but can be read from its start.

        Args:
            wait: whether to wait until the disk has them, or a first attempt has failed.
        """
        self._file.flush()
        if wait:
            self.disk.drain()
        for file in self._files:
            file.pack(file.on_disk.written)
        while self._files[0].on_disk.is_closed:
            self._finished.append(self._files.pop(0).summary)

    def close(self, hurried: Callable[[], bool] = lambda: False) -> None:
        """Completes the bag: the last file's index, `metadata.yaml` and `manifest.json`.

        What a full disk, or one that hangs, does not take is lost; a slow one is waited for.

        Args:
            hurried: whether to wait no more than a moment, even for a disk that is only slow.

        Raises:
            UnfinishedBagError: what is on the disk can be read, but has no index.
        """
        self._file.flush()
        writing = "a file"
        try:
            if not self.disk.drain(_PATIENCE, hurried):
                self._give_up_waiting()
            self.disk.min_space = 0
            for file in self._files:
                if not file.on_disk.is_closed:
                    self._complete(file)
            if not self.disk.drain(_PATIENCE, hurried):
                raise self._unfinished()
            writing = METADATA
            write_metadata(self.path, self._information())
            writing = MANIFEST
            write_manifest(self.path, self._digests, self.lost)
        except OSError as error:
            raise self._unfinished(f"{writing} cannot be written, {error.strerror}") from error
        finally:
            self.disk.stop()

    def _complete(self, file: "_BagFile") -> None:
        """Hands the end of a file to the disk, and notes what the whole file is."""
        file.close(self._information())
        self._digests[file.on_disk.path.name] = file.digest

    def _give_up_waiting(self) -> None:
        """Counts what the disk did not take as lost, and goes back to what it took.

        Raises:
            UnfinishedBagError: the disk hangs, so that nothing more can be done.
        """
        is_idle = self.disk.abandon()
        for file in [file for file in self._files if not file.on_disk.is_closed]:
            before = file.summary.message_count
            end = file.go_back(file.on_disk.written)
            self.lost += before - file.summary.message_count
            has_header = file.on_disk.written >= file.begin
            if not has_header:
                self._files.remove(file)
            if is_idle and has_header:
                file.on_disk.cut(end)
            elif is_idle:
                with suppress(OSError):
                    file.on_disk.path.unlink(missing_ok=True)
        if not is_idle:
            raise self._unfinished()

    def _unfinished(self, reason: str = "") -> UnfinishedBagError:
        fault = self.disk.fault
        reason = reason or (f"{fault.reason}; {fault.next_step}" if fault else "the disk hangs")
        return UnfinishedBagError(
            f"The bag '{self.path}' could not be completed: {reason}. What is there can be read; "
            f"`ros2 run vgps_ros bag reindex {self.path}` completes it, where there is space."
        )

    def _information(self) -> str:
        return bag_information(self.topics.values(), self._summaries())

    def _summaries(self) -> list[FileSummary]:
        return [*self._finished, *(file.summary for file in self._files)]

    def _begin_file(self) -> None:
        """Begins a file, which has all topics and attachments of those before it."""
        number = len(self._finished) + len(self._files)
        name = f"{self.path.name}_{number}.mcap"  # as rosbag2 counts them
        self._file = _BagFile(DiskFile(self.disk, self.path / name), self._compression)
        self._files.append(self._file)
        for topic in self.topics.values():
            self._file.add_topic(topic)
        for attachment, (data, stamp) in self._attachments.items():
            self._file.attach(attachment, data, stamp)


class _BagFile(StorageWriter):
    """One file of the bag, on its way to the disk."""

    def __init__(self, on_disk: DiskFile, compression: str):
        self.on_disk = on_disk
        super().__init__(on_disk, compression)

    @property
    def summary(self) -> FileSummary:
        """Summary of all that was written to the file, whether it is on the disk or not."""
        return FileSummary(self.on_disk.path.name, self.start, self.end, self.counts)
