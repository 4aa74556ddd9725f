# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The chunks of an `.mcap` file that were found whole, and their messages."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, ChunkIndex, Schema

from vgps_ros.bags.mcap_bytes import HEAD, MESSAGE, parsed, records, unpacked


class RawMessage(NamedTuple):
    """A message as it stands in a file.

    Attributes:
        channel: number of its channel.
        stamp: time of receipt [ns].
        data: CDR.
        sequence: its number among its publisher's messages; 0 if that is unknown.
        sent: time of sending [ns].
    """

    channel: int
    stamp: int
    data: bytes
    sequence: int
    sent: int


@dataclass(frozen=True)
class Place:
    """A whole chunk.

    Attributes:
        begin: of its record in the file [bytes]; of messages outside chunks, of the first.
        end: of its record [bytes].
        is_run: true if it is a run of messages outside chunks.
        size: of its records, uncompressed [bytes].
        start: time at which its first message was received [ns].
        last: time at which its last message was received [ns].
        counts: number of messages by channel.
    """

    begin: int
    end: int
    is_run: bool
    size: int
    start: int
    last: int
    counts: Counter[int]


@dataclass
class Content:
    """All that is whole in a file.

    Attributes:
        places: the chunks, in the order of the file.
        attachments: in the order of the file.
        schemas: by number.
        channels: by number.
        indexes: what the file's index says of its chunks; empty if it has no readable index.
        compression: of the last chunk.
        gaps: begin and end of each stretch that is damaged [bytes].
        doubled: number of chunks that were there already.
        start: when the first message was received [ns]; 0 if there is none.
        last: when the last message was received [ns].
        is_complete: true if the file has its index and ends where it should.
    """

    places: list[Place] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    indexes: list[ChunkIndex] = field(default_factory=list)
    compression: str = "none"
    gaps: list[tuple[int, int]] = field(default_factory=list)
    doubled: int = 0
    start: int = 0
    last: int = 0
    is_complete: bool = False

    def define(self, kind: int, record: bytes) -> None:
        """Notes a schema or a channel; of two with one number the first counts.

        Raises:
            DamagedError: it is not whole.
        """
        if kind == Opcode.SCHEMA:
            schema = parsed(Schema, record)
            self.schemas.setdefault(schema.id, schema)
        elif kind == Opcode.CHANNEL:
            channel = parsed(Channel, record)
            self.channels.setdefault(channel.id, channel)

    def missing(self) -> list[tuple[int, ChunkIndex]]:
        """Returns the chunks of the index that are not whole, with their numbers from 1 on."""
        whole = {(place.start, place.last, place.size) for place in self.places}
        return [
            (number, index)
            for number, index in enumerate(self.indexes, start=1)
            if (index.message_start_time, index.message_end_time, index.uncompressed_size)
            not in whole
        ]

    def misplaced(self) -> int:
        """Returns how many chunks the index has at places where none begins.

        Other readers go by the index, so they would read something else there.
        """
        places = {(place.begin, place.end - place.begin) for place in self.places}
        named = [(index.chunk_start_offset, index.chunk_length) for index in self.indexes]
        return sum(place not in places for place in named)


def messages(path: Path, place: Place) -> Iterator[RawMessage]:
    """Yields the messages of a chunk that was found whole.

    Raises:
        DamagedError: the file was changed since.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        file.seek(place.begin)
        data = file.read(place.end - place.begin)
    content = data if place.is_run else unpacked(data[HEAD.size :])[0]
    for kind, begin, end in records(content):
        if kind == Opcode.MESSAGE:
            channel, sequence, stamp, sent = MESSAGE.unpack_from(content, begin)
            yield RawMessage(channel, stamp, content[begin + MESSAGE.size : end], sequence, sent)
