# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The chunks and attachments of an `.mcap` file that prove to be whole, and how to find the next.

A stranger's file can hold millions of them that overlap, each of which would be read to its end
before its check sum refuses it. So what is read in vain is bounded, in proportion to the file.
"""

import mmap
import struct
from collections.abc import Iterator

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment

from vgps_ros.bags.mcap_bytes import (
    HEAD,
    LARGEST,
    DamagedError,
    attachment,
    chunk_head,
    require_attachment,
    unpacked,
)

_BLOCK = 2**18  # searched at once for the beginning of a record; more does not stay in the cache
_IN_VAIN = 64  # bytes that may be read in vain for each byte of a file
_STEP = 2**9  # bytes that are read in the time of one step from a record to the next


class WholeRecords:
    """The records of a file that have a check sum.

    Args:
        data: the file.
    """

    def __init__(self, data: mmap.mmap):
        self._data = data
        self._left = _IN_VAIN * len(data) + LARGEST
        self._unproven = 0  # bytes read since the last record that proved to be whole

    def proven(self) -> None:
        """Notes that what was read so far was not in vain."""
        self._unproven = 0

    def chunk(self, begin: int, end: int) -> tuple[bytes, str, int]:
        """Returns the records of the chunk that stands there, its compression and its check sum.

        Raises:
            DamagedError: it is not whole, or too much was read in vain.
            struct.error: it ends too early.
        """
        size = chunk_head(self._data, begin + HEAD.size, end).size
        self._spend(max(size, end - begin))
        return unpacked(self._data[begin + HEAD.size : end])

    def attachment(self, begin: int, end: int) -> Attachment:
        """Returns the attachment that stands there.

        Raises:
            DamagedError: it is not whole, or too much was read in vain.
            struct.error: it ends too early.
        """
        require_attachment(self._data, begin + HEAD.size, end)
        self._spend(end - begin)
        return attachment(self._data[begin + HEAD.size : end])

    def head(self, at: int) -> tuple[int, int]:
        """Returns the kind of the record at a place, and where it ends.

        Raises:
            DamagedError: it does not end in the file, or there is no such kind.
        """
        self._unproven += _STEP
        return self._head(at)

    def _head(self, at: int) -> tuple[int, int]:
        if at + HEAD.size > len(self._data):
            raise DamagedError
        kind, length = HEAD.unpack_from(self._data, at)
        end = at + HEAD.size + length
        if end > len(self._data) or not (1 <= kind <= Opcode.DATA_END or kind >= 0x80):
            raise DamagedError
        return kind, end

    def next(self, at: int) -> int:
        """Returns where the next whole record begins from a place on, or the end of the file."""
        for begin in _candidates(self._data, at):
            self._left -= self._unproven
            self._unproven = 0
            try:
                kind, end = self._head(begin)
                (self.chunk if kind == Opcode.CHUNK else self.attachment)(begin, end)
            except (DamagedError, struct.error):
                continue
            self.proven()
            return begin
        return len(self._data)

    def _spend(self, size: int) -> None:
        self._unproven += size
        if self._unproven > self._left:
            raise DamagedError


def _candidates(data: mmap.mmap, at: int) -> Iterator[int]:
    """Yields the places from `at` on where a chunk or an attachment of less than a TB may begin."""
    for begin in range(at, len(data), _BLOCK):
        block = np.frombuffer(data[begin : begin + _BLOCK + HEAD.size - 1], np.uint8)
        kinds = block[: 1 - HEAD.size]
        found = np.flatnonzero((kinds == Opcode.CHUNK) | (kinds == Opcode.ATTACHMENT))
        for byte in range(HEAD.size - 3, HEAD.size):  # the highest of its length
            found = found[block[found + byte] == 0]
        yield from (begin + found).tolist()
