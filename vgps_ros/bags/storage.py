"""One `.mcap` file of a rosbag2 bag, read as far as it goes.

A file whose writer was killed has no index and may end within a record; all before that is read.
"""

import fcntl
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: its full name.
        kind: its type, such as `sensor_msgs/msg/JointState`.
        type_hash: RIHS01 hash of the type, as the graph has it.
        qos: profiles that its publishers offer, as `metadata.yaml` has them.
        definition: the type's definition, with those of its fields.
    """

    name: str
    kind: str
    type_hash: str
    qos: Sequence[dict[str, Any]]
    definition: str


def is_being_written(path: Path) -> bool:
    """Returns whether some process still writes the file."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


@dataclass(frozen=True)
class FileSummary:
    """Describes one file of a bag.

    Attributes:
        name: name of the file in the folder of the bag.
        start: time at which its first message was received [ns].
        end: time at which its last message was received [ns].
        counts: number of messages of each topic.
    """

    name: str
    start: int
    end: int
    counts: dict[str, int]

    @property
    def message_count(self) -> int:
        """Number of messages in the file."""
        return sum(self.counts.values())


class StorageScan:
    """The content of a file, read from its start record by record, as far as it is whole.

    Attributes:
        topics: topics of the file by their names.
        summary: times and counts of its messages.
        compression: compression of its chunks.
        is_complete: whether it has its index and ends where it should.
    """

    def __init__(self, path: Path):
        self.compression = "none"
        self.is_complete = False
        self._path = path
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Topic] = {}
        counts: Counter[str] = Counter()
        start = end = 0
        for record in self.records():
            if not isinstance(record, Attachment):
                topic, message = record
                counts[topic.name] += 1
                start = min(start or message.log_time, message.log_time)
                end = max(end, message.log_time)
        self.topics = {topic.name: topic for topic in self._channels.values()}
        self.summary = FileSummary(path.name, start, end, counts)

    def records(self) -> Iterator[tuple[Topic, Message] | Attachment]:
        """Yields messages with their topics, and attachments, in the order of the file."""
        for record in self._whole_records():
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._channels.setdefault(record.id, self._topic(record))
            elif isinstance(record, Message):
                yield self._channels[record.channel_id], record
            elif isinstance(record, Attachment):
                yield record

    def _whole_records(self) -> Iterator[McapRecord]:
        with self._path.open("rb") as file:
            try:
                for record in StreamReader(file, emit_chunks=True).records:
                    if isinstance(record, Chunk):
                        self.compression = record.compression or "none"
                        yield from breakup_chunk(record, validate_crc=True)
                    else:
                        self.is_complete = isinstance(record, Footer)
                        yield record
            except OSError:
                raise
            except Exception:
                self.is_complete = False

    def _topic(self, channel: Channel) -> Topic:
        schema = self._schemas[channel.schema_id]
        return Topic(
            channel.topic,
            schema.name,
            channel.metadata.get("topic_type_hash", ""),
            yaml.safe_load(channel.metadata.get("offered_qos_profiles", "[]")) or [],
            schema.data.decode(),
        )
