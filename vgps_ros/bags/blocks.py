# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Keeps what the index and the digest of a file that is being written will say of its blocks.

A block is a part of the file that is handed over in one call, a chunk with its index or an
attachment, so that the file may be cut after it.
"""

import hashlib
from collections import Counter, deque
from typing import Any, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.records import AttachmentIndex, ChunkIndex, McapRecord

from vgps_ros.bags.manifest import DIGEST, PackedDigest

_Entry = ChunkIndex | AttachmentIndex


class _Block(NamedTuple):
    """A block that the file may still be cut before."""

    end: int  # in the file [bytes]
    entry: _Entry  # in the file's index
    counts: Counter[int]  # messages by the numbers of their channels
    sha256: bytes
    so_far: Any  # SHA-256 of the file up to its end, which can go on


class Blocks:
    """The blocks of one file.

    A recorder makes a million chunks in a few days. As records they take 2 kB each, so those that
    are on the disk are packed: a chunk with n topics takes 155 + 10 n bytes.

    Args:
        header: the bytes before the first block.
    """

    def __init__(self, header: bytes):
        self._hash = hashlib.sha256(header)
        self._blocks: deque[_Block] = deque()
        self._begin = len(header)
        # Of the blocks that are packed:
        self._end = self._begin
        self._counts: Counter[int] = Counter()
        self._first = self._last = 0
        self._entries = {ChunkIndex: bytearray(), AttachmentIndex: bytearray()}
        self._numbers: Counter[type] = Counter()
        self._digests = bytearray()
        self._packed_hash = self._hash.copy()

    def add(self, data: bytes | bytearray, entry: _Entry, counts: Counter[int]) -> None:
        """Adds a block, its entry in the index, and its messages by the numbers of channels."""
        self._hash.update(data)
        end = (self._blocks[-1].end if self._blocks else self._end) + len(data)
        sha256 = hashlib.sha256(data).digest()
        self._blocks.append(_Block(end, entry, counts, sha256, self._hash.copy()))

    def pack(self, position: int) -> None:
        """Packs the blocks before a position, before which the file will not be cut [bytes]."""
        while self._blocks and self._blocks[0].end <= position:
            block = self._blocks.popleft()
            entry = block.entry
            self._end, self._packed_hash = block.end, block.so_far
            self._counts += block.counts
            self._entries[type(entry)] += bytes_of(entry)
            self._numbers[type(entry)] += 1
            self._digests += DIGEST.pack(block.end, block.sha256)
            if isinstance(entry, ChunkIndex):
                start = entry.message_start_time
                self._first = min(self._first or start, start)
                self._last = max(self._last, entry.message_end_time)

    def go_back(self, position: int) -> tuple[int, Counter[int], int, int]:
        """Forgets the blocks that end after a position [bytes].

        Returns:
            The end of the last block before it [bytes]; the number of messages by the numbers of
            their channels; the times of the first and of the last one [ns], 0 if there is none.
        """
        self.pack(position)
        self._blocks.clear()
        self._hash = self._packed_hash.copy()
        return self._end, self._counts.copy(), self._first, self._last

    def entries(self, kind: type[_Entry]) -> tuple[int, bytes]:
        """Returns the number of chunks, or of attachments, and their entries in the index."""
        rest = [block.entry for block in self._blocks if isinstance(block.entry, kind)]
        return self._numbers[kind] + len(rest), bytes(self._entries[kind]) + bytes_of(*rest)

    def finish(self, end: bytes) -> None:
        """Takes the bytes after the last block into the file's digest."""
        self._hash.update(end)

    def digest(self, messages: dict[str, int]) -> PackedDigest:
        """Returns the digest of the file with these numbers of messages by topic."""
        rest = b"".join(DIGEST.pack(block.end, block.sha256) for block in self._blocks)
        return PackedDigest(
            self._hash.hexdigest(), self._begin, bytes(self._digests) + rest, messages
        )


def bytes_of(*parts: McapRecord) -> bytes:
    """Returns records as they stand in a file."""
    builder = RecordBuilder()
    for part in parts:
        part.write(builder)
    return builder.end()
