# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""One `.mcap` file of a rosbag2 bag: its topics, its messages, and what is damaged.

A file whose writer was killed has no index and may end within a record.
"""

import fcntl
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Channel

from vgps_ros.bags.chunks import Place, RawMessage, messages
from vgps_ros.bags.mcap_bytes import DamagedError
from vgps_ros.bags.scan import scan
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.plain_yaml import read_yaml


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: its full name.
        kind: its type, such as `sensor_msgs/msg/JointState`.
        type_hash: RIHS01 hash of the type, as the graph has it.
        qos: profiles that its publishers offer, as `metadata.yaml` has them.
        definition: the type's definition, with those of its fields.
        serialization: of its messages.
    """

    name: str
    kind: str
    type_hash: str
    qos: Sequence[dict[str, Any]]
    definition: str
    serialization: str = "cdr"


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
    """The content of a file, as far as it is whole.

    Attributes:
        path: the file.
        content: its chunks and attachments.
        topics: its topics by the numbers of their channels.
        summary: times and counts of its messages.
        damages: a sentence on each part that is not whole.
        is_complete: whether it has its index and ends where it should.

    Raises:
        OSError: it cannot be read.
    """

    def __init__(self, path: Path):
        self.path = path
        self.content = content = scan(path)
        self.topics = {n: self._topic(channel) for n, channel in content.channels.items()}
        self.is_complete = content.is_complete
        counts: Counter[str] = Counter()
        for place in content.places:
            for channel, count in place.counts.items():
                if channel in self.topics:
                    counts[self.topics[channel].name] += count
        self.summary = FileSummary(path.name, content.start, content.last, dict(counts))
        self.damages = [f"{path.name}: {sentence}" for sentence in self._damages()]

    def messages(self, place: Place) -> list[tuple[Topic, RawMessage]]:
        """Returns the messages of a chunk with their topics.

        Raises:
            OSError: the file cannot be read.
            InvalidInputError: it was changed since it was opened.
        """
        try:
            found = list(messages(self.path, place))
        except (DamagedError, struct.error) as error:
            raise InvalidInputError(f"'{self.path}' was changed while it was read.") from error
        return [(self.topics[m.channel], m) for m in found if m.channel in self.topics]

    def _damages(self) -> Iterator[str]:
        content = self.content
        missing = content.missing()
        for number, index in missing:
            names = (self.topics.get(channel) for channel in index.message_index_offsets)
            topics = ", ".join(sorted(topic.name for topic in names if topic))
            yield (
                f"chunk {number} of {len(content.indexes)} is damaged, with messages of {topics} "
                f"from {index.message_start_time * 1e-9:.3f} to "
                f"{index.message_end_time * 1e-9:.3f} s"
            )
        if not content.indexes or not missing:
            for begin, end in content.gaps:
                yield f"bytes {begin} to {end} are damaged"
        if content.doubled:
            yield f"{content.doubled} chunks were there twice, and count once"
        unknown = {c for place in content.places for c in place.counts} - set(self.topics)
        if unknown:
            count = sum(place.counts[c] for place in content.places for c in unknown)
            yield f"{count} messages are of topics whose description is damaged"

    def _topic(self, channel: Channel) -> Topic:
        schema = self.content.schemas.get(channel.schema_id)
        try:
            qos = read_yaml(channel.metadata.get("offered_qos_profiles", "[]"), "a QoS profile")
        except InvalidInputError:
            qos = []
        return Topic(
            channel.topic,
            schema.name if schema else "",
            channel.metadata.get("topic_type_hash", ""),
            qos if isinstance(qos, list) else [],
            schema.data.decode(errors="replace") if schema else "",
            channel.message_encoding,
        )
