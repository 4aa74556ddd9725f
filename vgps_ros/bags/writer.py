# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes and repairs rosbag2 bags with MCAP storage.

A bag is a folder with `.mcap` files, `metadata.yaml` and `SHA256SUMS`. A thread writes it, so that
a slow disk holds up nobody. A bag whose recorder was killed lacks `metadata.yaml` and the index of
its last file, which `repair` makes anew.
"""

import fcntl
import hashlib
import math
import os
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from mcap.records import Attachment
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vgps_ros.bags.metadata import (
    DIGESTS,
    FILE_NAME,
    FileSummary,
    Topic,
    bag_information,
    write_digests,
    write_metadata,
)
from vgps_ros.core.checks import one_of
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.messages.names import file_of

COMPRESSIONS = tuple(kind.name.lower() for kind in CompressionType)
CHUNK_SIZE = 2**18  # small enough that decoding one does not hold up a replay [bytes]

_PERIOD = 0.05  # between two looks for messages to write [s]
_FLUSH_PERIOD = 0.4  # a killed recorder loses the messages of this time at most, and a moment [s]


class UnfinishedBagError(VgpsError):
    """A bag lacks its index or `metadata.yaml`, since the disk did not take them."""


class BagWriter:
    """A bag that is being written.

    Messages wait in memory for a slow disk, up to a limit; those beyond it are counted as lost.
    Twice a second at least, those that came are handed over to the system. Where the disk refuses
    something, as when it is full, all that comes later is lost, too.

    Args:
        path: folder of the bag; it must not exist.
        compression: of the files' chunks: none, lz4 or zstd.
        max_file_size: begin a new file beyond this size [bytes]; 0: never.
        max_file_duration: begin a new file after this time [ns]; 0: never.
        max_backlog: what may wait for the disk [bytes].

    Attributes:
        path: the folder.
        topics: topics that messages can be written to, by their names.
        fault: a sentence on why nothing can be written any more; empty if it can.

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
    ):
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.fault = ""
        one_of("compression", compression, COMPRESSIONS)
        self._compression = CompressionType[compression.upper()]
        self._max_file_size = max_file_size
        self._max_file_duration = max_file_duration
        self._max_backlog = max_backlog
        self._definitions = MessageDefinitions()
        self._work: deque[tuple[Callable[..., object], tuple[object, ...], int]] = deque()
        self._is_closing = threading.Event()
        # Numbers of works, bytes and messages, each counted by one thread.
        self._put_works = self._put_bytes = self._taken = self._refused = 0
        self._done_works = self._done_bytes = self._seen = self._dropped = 0
        # All below belongs to the writing thread.
        self._attachments: dict[str, Attachment] = {}
        self._known: dict[str, Topic] = {}
        self._files: list[_HashedFile] = []
        try:
            path.mkdir(parents=True)
            self._begin_file()
        except FileExistsError as error:
            raise InvalidInputError(
                f"The bag folder '{path}' exists already; name one that does not."
            ) from error
        except OSError as error:
            raise InvalidInputError(
                f"The bag folder '{path}' cannot be made or written to: {error}; name another one."
            ) from error
        # A daemon: the end of the process must not wait for a bag that nobody closes.
        threading.Thread(target=self._run, name="bag", daemon=True).start()

    @property
    def message_count(self) -> int:
        """Messages written so far, those included that wait for the disk."""
        return self._taken - self._dropped

    @property
    def lost(self) -> int:
        """Number of messages that could not be written."""
        return self._refused + self._dropped

    @property
    def backlog(self) -> int:
        """Number of bytes that wait for the disk."""
        return self._put_bytes - self._done_bytes

    def add_topic(
        self, name: str, kind: str, type_hash: str, qos: Sequence[dict[str, Any]]
    ) -> None:
        """Adds a topic; see `Topic`.

        Raises:
            InvalidInputError: the type's definition is not installed.
        """
        topic = Topic(name, kind, type_hash, qos, self._definitions.find(kind))
        self.topics[name] = topic
        self._put(self._add_topic, topic)

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Writes one message, or counts it as lost.

        Args:
            topic: a topic that was added.
            stamp: time at which it was received [ns].
            data: the message as CDR.
        """
        if self.backlog > self._max_backlog:
            self._refused += 1
            return
        self._taken += 1
        self._put(self._write, topic, stamp, data, size=len(data))

    def attach(self, name: str, text: str, stamp: int) -> None:
        """Adds a named text to this file and to those that follow; a later one replaces it."""
        self._put(self._attach, Attachment(stamp, stamp, name, "text/plain", text.encode()))

    def flush(self) -> None:
        """Waits until the disk has all messages so far, or takes none."""
        self._put(self._flush)
        self._wait()

    def close(self) -> None:
        """Completes the bag: the last file's index, `metadata.yaml` and `SHA256SUMS`.

        Raises:
            UnfinishedBagError: what is on the disk can be read, but has no index.
        """
        self._put(self._finish)
        self._is_closing.set()
        self._wait()
        if self.fault:
            raise self._unfinished(self.fault)
        writing = FILE_NAME
        try:
            write_metadata(self.path, self._known.values(), [f.summary for f in self._files])
            writing = DIGESTS
            write_digests(self.path, {f.path.name: f.sha256.hexdigest() for f in self._files})
        except OSError as error:
            raise self._unfinished(f"{writing} cannot be written, {error.strerror}.") from error

    def _unfinished(self, reason: str) -> UnfinishedBagError:
        return UnfinishedBagError(
            f"The bag '{self.path}' could not be completed: {reason} What is there can be read; "
            f"`ros2 run vgps_ros bag reindex {self.path}` completes it, where there is space."
        )

    def _put(self, work: Callable[..., object], *arguments: object, size: int = 0) -> None:
        """Hands work to the thread, with arguments that keep so many bytes in memory."""
        self._put_bytes += size
        self._put_works += 1
        self._work.append((work, arguments, size))

    def _wait(self) -> None:
        while self._done_works < self._put_works:
            time.sleep(0.005)

    # The writing thread

    def _run(self) -> None:
        is_closing = False
        while not is_closing:
            is_closing = self._is_closing.wait(_PERIOD)  # after which nothing is put any more
            while self._work:
                work, arguments, size = self._work.popleft()
                self._do(work, *arguments)
                self._done_bytes += size
                self._done_works += 1
            if time.monotonic() - self._flushed > _FLUSH_PERIOD:
                self._do(self._flush)

    def _do(self, work: Callable[..., object], *arguments: object) -> None:
        """Does work on the files; after a fault, only counts the messages that are lost."""
        if self.fault:
            self._dropped += work == self._write
            return
        try:
            work(*arguments)
        except OSError as error:
            taken = sum(file.summary.counts.total() for file in self._files)
            self._dropped = self._seen - (taken - self._unsaved)
            self._files[-1].close()
            self.fault = (
                f"Cannot write to '{self._files[-1].path}': {error.strerror}; make room on the "
                "disk, and start a new recording."
            )

    def _begin_file(self) -> None:
        """Begins a file, which has all topics and attachments of those before it."""
        name = f"{self.path.name}_{len(self._files)}.mcap"  # as rosbag2 counts them
        self._files.append(_HashedFile(self.path / name))
        self._mcap = Writer(self._files[-1], 2**62, self._compression)  # type: ignore[arg-type]
        self._mcap.start(Profile.ROS2, "vgps_ros")
        self._schemas: dict[str, int] = {}  # by the type
        self._channels: dict[str, int] = {}  # by the topic
        self._unsaved = self._size = 0  # messages and bytes of the chunk that is not on the disk
        self._flushed = time.monotonic()
        for topic in self._known.values():
            self._add_topic(topic)
        for attachment in self._attachments.values():
            self._attach(attachment)

    def _add_topic(self, topic: Topic) -> None:
        self._known[topic.name] = topic
        metadata = {
            "offered_qos_profiles": yaml.safe_dump(list(topic.qos), sort_keys=False),
            "topic_type_hash": topic.type_hash,
        }
        if topic.kind not in self._schemas:
            schema = topic.kind, SchemaEncoding.ROS2, topic.definition.encode()
            self._schemas[topic.kind] = self._mcap.register_schema(*schema)
        self._channels[topic.name] = self._mcap.register_channel(
            topic.name, MessageEncoding.CDR, self._schemas[topic.kind], metadata
        )

    def _attach(self, attachment: Attachment) -> None:
        self._attachments[attachment.name] = of = attachment
        self._flush()
        self._mcap.add_attachment(of.create_time, of.log_time, of.name, of.media_type, of.data)

    def _write(self, topic: str, stamp: int, data: bytes) -> None:
        self._seen += 1
        file, most = self._files[-1], self._max_file_duration
        is_long = most and file.summary.start and stamp - file.summary.start >= most
        if is_long or (self._max_file_size and file.size >= self._max_file_size):
            self._finish()
            self._begin_file()
        self._files[-1].summary.add(topic, stamp)
        self._unsaved += 1
        self._size += len(data)
        self._mcap.add_message(self._channels[topic], stamp, data, stamp)
        if self._size > CHUNK_SIZE:
            self._flush()

    def _flush(self) -> None:
        """Hands all messages so far to the file, as a chunk."""
        before = self._files[-1].size
        try:
            self._mcap.flush()
        finally:
            if self._files[-1].size > before:
                self._unsaved = self._size = 0
        self._flushed = time.monotonic()

    def _finish(self) -> None:
        """Completes a file with what rosbag2 says of it, and its index."""
        self._flush()
        said = yaml.safe_dump(bag_information(self._known.values(), [self._files[-1].summary]))
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": said})
        self._mcap.finish()
        self._files[-1].close()
        self._flushed = math.inf


class _HashedFile:
    """A new file that is locked while it is written (see `is_being_written`).

    Attributes:
        path: the file.
        summary: times and counts of all messages that were written to it.
        size: bytes of all blocks that are on the disk.
        sha256: digest of these.
    """

    def __init__(self, path: Path):
        self.path, self.summary = path, FileSummary(path.name)
        self.size, self.sha256 = 0, hashlib.sha256()
        self._file = path.open("xb", buffering=0)
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def write(self, block: bytes) -> int:
        """Appends a block.

        Raises:
            OSError: the disk does not take it, or not all of it.
        """
        rest, end = memoryview(block), self.size + len(block)
        while rest:
            rest = rest[os.pwrite(self._file.fileno(), rest, end - len(rest)) :]
        self.size = end
        self.sha256.update(block)
        return len(block)

    def tell(self) -> int:
        """Returns the size of the file [bytes]."""
        return self.size

    def flush(self) -> None:
        """Does nothing: each block is on the disk already."""

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


class MessageDefinitions:
    """Finds the definitions of message types, which a bag holds so that any reader can decode it.

    The definitions of standard types come with rosbags. Those of other types, such as the project's
    own, are read from the `.msg` files of installed interface packages, through the ament index.
    """

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)

    def find(self, name: str) -> str:
        """Returns the definition of a type such as `sensor_msgs/msg/JointState`.

        Raises:
            InvalidInputError: the type's package is not installed, or has no such message.
        """
        if "/msg/" not in name:
            return self._of_call(name)
        self._register(name)
        return self._store.generate_msgdef(name, ros_version=2)[0]

    def _of_call(self, name: str) -> str:
        """Returns the definition of a service's events, or of an action's feedback.

        ROS has no file of it; it is put together as a message's.
        """
        package, _, _ = name.partition("/")
        call, _, kind = name.rpartition("/")[2].rpartition("_")
        parts = re.split(r"^---.*$", self._path(name).read_text(), flags=re.MULTILINE)
        if kind == "Event":
            own = dict(zip(("Request", "Response"), parts, strict=True))
            fields = "service_msgs/ServiceEventInfo info\n"
            fields += f"{package}/{call}_Request[<=1] request\n"
            fields += f"{package}/{call}_Response[<=1] response\n"
        else:
            own = {"Feedback": parts[2]}
            fields = f"unique_identifier_msgs/UUID goal_id\n{package}/{call}_Feedback feedback\n"
        sections = {f"MSG: {package}/{call}_{part}\n{text.strip()}\n" for part, text in own.items()}
        made = {f"{package}/msg/{call}_{part}" for part in own}
        for text in (fields, *own.values()):
            for _, (_, description) in get_types_from_msg(text, f"{package}/msg/X").popitem()[1][1]:
                for inner in set(_type_names(description)) - made:
                    first, *others = self.find(inner).split(f"{'=' * 80}\n")
                    sections |= {f"MSG: {inner.replace('/msg/', '/')}\n{first}", *others}
        return f"{'=' * 80}\n".join([fields, *sorted(sections)])

    def _register(self, name: str) -> None:
        """Adds a type and the types of its fields to the store."""
        if name in self._store.fielddefs:
            return
        types = get_types_from_msg(self._path(name).read_text(), name)
        for fields in types.values():
            for _, (_, description) in fields[1]:
                for inner in _type_names(description):
                    self._register(inner)
        self._store.register(types)

    def _path(self, name: str) -> Path:
        package, space, _ = name.split("/")
        try:
            path = Path(get_package_share_directory(package), f"{file_of(name)}.{space}")
        except (PackageNotFoundError, ValueError):
            path = Path()
        if not path.is_file():
            raise InvalidInputError(
                f"The definition of {name} is not installed: build its package, or source it."
            )
        return path


def _type_names(description: object) -> list[str]:
    """Returns the names of all message types in the description of a field, at any depth."""
    if isinstance(description, str):
        return [description] if "/msg/" in description else []
    if isinstance(description, tuple):
        return [name for part in description for name in _type_names(part)]
    return []
