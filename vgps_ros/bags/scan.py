# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds all that is whole in an `.mcap` file, whatever is around it.

A file is read from its start, record by record. Where a record is damaged, reading goes on with the
next one after it that proves itself by its structure and its check sum. So a damage costs what it
hit.
"""

import mmap
import struct
import zlib
from collections import Counter
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer

from vgps_ros.bags.chunks import Content, Place
from vgps_ros.bags.mcap_bytes import HEAD, MAGIC, MESSAGE, DamagedError, parsed, records
from vgps_ros.bags.whole_records import WholeRecords

_RUN = 2**20  # messages outside chunks are taken together up to this size [bytes]


def scan(path: Path) -> Content:
    """Reads a whole file once.

    Raises:
        OSError: it cannot be read.
    """
    content = Content()
    if not path.stat().st_size:
        return content
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        _Scan(data, content).run()
    return content


class _Scan:
    def __init__(self, data: mmap.mmap, content: Content):
        self._data, self._content = data, content
        self._whole = WholeRecords(data)
        self._seen: set[tuple[int, int, int]] = set()
        self._run = -1  # where a run of messages outside chunks begins; -1 outside one

    def run(self) -> None:
        """Fills in the content."""
        at = sure = len(MAGIC) if self._data[: len(MAGIC)] == MAGIC else 0
        size = len(self._data)
        while at < size:
            try:
                kind, end = self._whole.head(at)
                if self._run >= 0 and not self._belongs_to_run(kind, end):
                    self._end_run(at)
                    sure = at
                    self._whole.proven()
                if self._take(kind, at, end):
                    sure = end
                    self._whole.proven()
                at = end
                if kind == Opcode.FOOTER:
                    if self._data[at:] != MAGIC:
                        raise DamagedError
                    self._content.is_complete = True
                    break
            except (DamagedError, struct.error):
                if self._run >= 0:
                    self._end_run(at)
                    sure = at
                # What has no check sum and led here may be what is damaged, so it is read again.
                at = self._whole.next(sure + (sure == at))
                self._content.gaps.append((sure, at))
                sure = at
        if self._run >= 0:
            self._end_run(min(at, size))
        self._read_summary()

    def _belongs_to_run(self, kind: int, end: int) -> bool:
        is_content = kind in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
        return is_content and end - self._run <= _RUN

    def _take(self, kind: int, at: int, end: int) -> bool:
        """Takes a record; returns whether it has proven that it is whole."""
        if kind == Opcode.CHUNK:
            self._take_chunk(at, end)
            return True
        if kind == Opcode.ATTACHMENT:
            self._content.attachments.append(self._whole.attachment(at, end))
            return True
        if kind in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE) and self._run < 0:
            self._run = at
        return False

    def _take_chunk(self, at: int, end: int) -> None:
        chunk, compression, checksum = self._whole.chunk(at, end)
        key = (checksum, len(chunk), zlib.crc32(chunk))
        if key in self._seen:
            self._content.doubled += 1
            return
        # One without messages stands in the index, too.
        self._content.places.append(Place(at, end, False, len(chunk), *self._survey(chunk)))
        self._seen.add(key)
        self._content.compression = compression or "none"

    def _end_run(self, at: int) -> None:
        begin, self._run = self._run, -1
        try:
            found = self._survey(self._data[begin:at])
        except (DamagedError, struct.error):
            self._content.gaps.append((begin, at))
        else:
            place = Place(begin, at, True, at - begin, *found)
            if place.counts:
                self._content.places.append(place)

    def _survey(self, data: bytes) -> tuple[int, int, Counter[int]]:
        """Reads schemas and channels; returns first and last time and counts of the messages."""
        content, counts, stamps = self._content, Counter[int](), []
        for kind, begin, end in records(data):
            if kind == Opcode.MESSAGE:
                channel, _, stamp, _ = MESSAGE.unpack_from(data, begin)
                counts[channel] += 1
                stamps.append(stamp)
            else:
                content.define(kind, data[begin:end])
        first, last = min(stamps, default=0), max(stamps, default=0)
        if stamps:
            content.start = min(content.start or first, first)
            content.last = max(content.last, last)
        return first, last, counts

    def _read_summary(self) -> None:
        """Reads the index, whose check sum covers it; schemas and channels stand there again."""
        data, content = self._data, self._content
        footer = len(data) - len(MAGIC) - HEAD.size - 20
        if footer < 0 or data[-len(MAGIC) :] != MAGIC or data[footer] != Opcode.FOOTER:
            content.is_complete = False
            return
        found = parsed(Footer, data[footer + HEAD.size : footer + HEAD.size + 20])
        begin = found.summary_start
        covered = data[begin : len(data) - len(MAGIC) - 4] if 0 < begin <= footer else b""
        if found.summary_crc and zlib.crc32(covered) != found.summary_crc:
            content.is_complete = False
            return
        try:
            for kind, first, end in records(data[begin:footer] if begin else b""):
                record = data[begin + first : begin + end]
                if kind == Opcode.CHUNK_INDEX:
                    content.indexes.append(parsed(ChunkIndex, record))
                else:
                    content.define(kind, record)
        except (DamagedError, struct.error):
            content.is_complete = False
        else:  # the damage before it, which the scan may not have got past, is told by the index
            content.is_complete |= bool(content.indexes)
