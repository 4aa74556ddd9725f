# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""One `.mcap` file of a rosbag2 bag, written with its index.

The file is made of mcap's public records. mcap's own `Writer` is not used: it has no public way to
count, or to go back to an earlier state, as a bag on a full disk must.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import IO

import lz4.frame
import yaml
import zstandard
from mcap import records
from mcap.opcode import Opcode

from vgps_ros.bags.blocks import Blocks, bytes_of
from vgps_ros.bags.manifest import PackedDigest
from vgps_ros.bags.mcap_bytes import MAGIC
from vgps_ros.bags.storage import Topic
from vgps_ros.core.checks import one_of
from vgps_ros.storage.disk import DiskFile

COMPRESSIONS: dict[str, Callable[[bytes], bytes]] = {
    "none": bytes,
    "lz4": lz4.frame.compress,
    "zstd": zstandard.compress,
}

_CHUNK_SIZE = 2**18  # small enough that decoding one does not hold up a replay [bytes]
# The start of a message's record: kind, length, channel, sequence number, receipt, publication.
_MESSAGE = struct.Struct("<BQHIQQ")
_LENGTH_BEFORE_DATA = _MESSAGE.size - struct.calcsize("<BQ")


class StorageWriter:
    """A file that is being written.

    Args:
        file: empty; each block that is handed over to it ends with a whole record.
        compression: of the chunks: none, lz4 or zstd.

    Attributes:
        begin: where the header ends, before which the file cannot be cut [bytes].
        start: when the first message was received [ns]; 0 if there is none.
        end: when the last message was received [ns]; 0 if there is none.
    """

    def __init__(self, file: DiskFile | IO[bytes], compression: str):
        self.start = self.end = 0
        self._compress = COMPRESSIONS[one_of("compression", compression, COMPRESSIONS)]
        self._compression = "" if compression == "none" else compression
        self._schemas: dict[tuple[str, str, bytes], records.Schema] = {}
        self._channels: dict[str | int, records.Channel] = {}
        self._counts: Counter[int] = Counter()
        self._file = file
        header = MAGIC + bytes_of(records.Header("ros2", "vgps_ros"))
        self._file.write(header)
        self._blocks = Blocks(header)
        self.begin = self._file.tell()
        self._begin_chunk()

    @property
    def counts(self) -> dict[str, int]:
        """Messages of each topic so far."""
        counts = Counter({channel.topic: 0 for channel in self._channels.values()})
        for channel in self._channels.values():
            counts[channel.topic] += self._counts[channel.id]
        return dict(counts)

    @property
    def digest(self) -> PackedDigest:
        """The digest of the file up to here; once it is closed, it covers the whole file."""
        return self._blocks.digest(self.counts)

    def add_topic(self, topic: Topic) -> None:
        """Makes a topic known, before its first message."""
        metadata = {
            "offered_qos_profiles": yaml.safe_dump(list(topic.qos), sort_keys=False),
            "topic_type_hash": topic.type_hash,
        }
        channel = records.Channel(0, topic.name, topic.serialization, metadata, 0)
        schema = records.Schema(0, topic.definition.encode(), "ros2msg", topic.kind)
        self.add_channel(topic.name, channel, schema)

    def add_channel(
        self, key: str | int, channel: records.Channel, schema: records.Schema | None
    ) -> None:
        """Makes a channel known, with a number of its own; the key is that of its messages."""
        number = 0
        if schema is not None:
            content = (schema.name, schema.encoding, schema.data)
            if content not in self._schemas:
                self._schemas[content] = own = replace(schema, id=len(self._schemas) + 1)
                self._add(bytes_of(own))
            number = self._schemas[content].id
        channel = replace(channel, id=len(self._channels) + 1, schema_id=number)
        self._channels[key] = channel
        self._add(bytes_of(channel))

    def write(
        self, key: str | int, stamp: int, data: bytes, sequence: int = 0, sent: int | None = None
    ) -> None:
        """Writes a message.

        Args:
            key: its topic, or the key of its channel.
            stamp: time at which it was received [ns].
            data: the message, as CDR.
            sequence: its number among its publisher's messages.
            sent: time at which it was sent [ns]; that of its receipt if None.
        """
        channel, length = self._channels[key].id, _LENGTH_BEFORE_DATA + len(data)
        sent = stamp if sent is None else sent
        self._counts[channel] += 1
        self._index.setdefault(channel, []).extend((stamp, self._chunk_size))
        self._add(_MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, stamp, sent))
        self._add(data)
        self.end = max(self.end, stamp)
        self.start = min(self.start or stamp, stamp)
        if self._chunk_size > _CHUNK_SIZE:
            self.flush()

    def attach(self, name: str, data: bytes, stamp: int) -> None:
        """Adds a named text; of several with one name the last one counts."""
        self.add_attachment(records.Attachment(stamp, stamp, name, "text/plain", data))

    def add_attachment(self, attachment: records.Attachment) -> None:
        """Adds an attachment as it stands in another file."""
        self.flush()
        block, at = bytes_of(attachment), self._file.tell()
        index = records.AttachmentIndex(
            at,
            len(block),
            attachment.log_time,
            attachment.create_time,
            len(attachment.data),
            attachment.name,
            attachment.media_type,
        )
        self._file.write(block)
        self._blocks.add(block, index, Counter())

    def flush(self) -> None:
        """Hands all messages so far to the file: a killed process loses none that it wrote."""
        if not self._index:
            return
        data, at = b"".join(self._chunk), self._file.tell()
        compressed = self._compress(data)
        stamps = [stamp for entries in self._index.values() for stamp in entries[::2]]
        start, end = min(stamps), max(stamps)
        chunk = bytes_of(
            records.Chunk(self._compression, compressed, end, start, zlib.crc32(data), len(data))
        )
        block, places = bytearray(chunk), {}
        for channel, entries in self._index.items():
            places[channel], size = at + len(block), 8 * len(entries)
            block += struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + size, channel, size)
            block += struct.pack(f"<{len(entries)}Q", *entries)
        index = records.ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=at,
            compression=self._compression,
            compressed_size=len(compressed),
            message_end_time=end,
            message_index_length=len(block) - len(chunk),
            message_index_offsets=places,
            message_start_time=start,
            uncompressed_size=len(data),
        )
        counts = {channel: len(entries) // 2 for channel, entries in self._index.items()}
        self._file.write(bytes(block))
        self._blocks.add(block, index, Counter(counts))
        self._file.flush()
        self._begin_chunk()

    def close(self, metadata: str) -> None:
        """Completes the file: metadata as rosbag2 puts it there, and the index."""
        self.flush()
        at = self._file.tell()
        chunk_count, chunks = self._blocks.entries(records.ChunkIndex)
        attachment_count, attachments = self._blocks.entries(records.AttachmentIndex)
        described = bytes_of(records.Metadata("rosbag2", {"serialized_metadata": metadata}))
        data = described + bytes_of(records.DataEnd(0))
        known = bytes_of(
            *self._schemas.values(),
            *self._channels.values(),
            records.Statistics(
                attachment_count=attachment_count,
                channel_count=len(self._channels),
                channel_message_counts=dict(self._counts),
                chunk_count=chunk_count,
                message_count=self._counts.total(),
                message_end_time=self.end,
                message_start_time=self.start,
                metadata_count=1,
                schema_count=len(self._schemas),
            ),
        )
        last = bytes_of(records.MetadataIndex(at, len(described), "rosbag2"))
        summary = b"".join((known, attachments, chunks, last))
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, at + len(data), 0)
        checksum = struct.pack("<I", zlib.crc32(summary + footer))
        end = data + summary + footer + checksum + MAGIC
        self._blocks.finish(end)
        self._file.write(end)
        self._file.close()

    def pack(self, position: int) -> None:
        """Takes less memory for the blocks before a position that `go_back` will never undo."""
        self._blocks.pack(position)

    def go_back(self, position: int) -> int:
        """Forgets what came after a position, also an index; the file can then be closed again.

        Args:
            position: end of what is whole in the file [bytes].

        Returns:
            Where the file must be cut: after the last chunk with its index, or attachment.
        """
        end, self._counts, self.start, self.end = self._blocks.go_back(position)
        self._begin_chunk()
        return end

    def _begin_chunk(self) -> None:
        self._chunk: list[bytes] = []
        self._chunk_size = 0
        self._index: dict[int, list[int]] = {}  # by channel: time and place of each message

    def _add(self, data: bytes) -> None:
        """Adds a record, or a part of one, to the chunk."""
        self._chunk.append(data)
        self._chunk_size += len(data)
