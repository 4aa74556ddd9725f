# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A file that is being written takes little memory for what is on the disk already."""

import hashlib
import io
import tracemalloc

import pytest
from mcap.reader import make_reader

from vgps_ros.bags.metadata import bag_information
from vgps_ros.bags.storage import Topic
from vgps_ros.bags.storage_writer import StorageWriter

TOPICS = [Topic(f"/topic_{i}", "std_msgs/msg/Empty", "", [], "") for i in range(10)]


class Nowhere(io.RawIOBase):
    """A file that keeps nothing."""

    size = 0

    def write(self, data):
        self.size += len(data)
        return len(data)

    def tell(self):
        return self.size


def write_chunks(writer: StorageWriter, count: int, file: io.IOBase, packs: bool) -> None:
    for chunk in range(count):
        for i, topic in enumerate(TOPICS):
            writer.write(topic.name, 10**18 + 100 * chunk + i, b"data")
        writer.flush()
        if packs:
            writer.pack(file.tell())


@pytest.fixture
def begun():
    """Returns a function that begins a file with ten topics and an attachment."""

    def begin(file: io.IOBase | None = None) -> tuple[StorageWriter, io.BytesIO]:
        file = file or io.BytesIO()
        file.close = lambda: None  # so that its content can be read afterwards
        writer = StorageWriter(file, "none")
        for topic in TOPICS:
            writer.add_topic(topic)
        writer.attach("note", b"text", 1)
        return writer, file

    return begin


def test_a_chunk_on_the_disk_takes_few_bytes_of_memory(begun):
    writer, file = begun(Nowhere())
    write_chunks(writer, 10, file, packs=True)
    tracemalloc.start()
    try:
        write_chunks(writer, 1000, file, packs=True)
        taken = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert taken < 400 * 1000


def test_of_a_file_that_is_closed_a_recorder_keeps_forty_bytes_of_each_chunk(begun):
    """Until its bag ends, which may have many files."""
    writer, file = begun(Nowhere())
    write_chunks(writer, 1000, file, packs=True)
    writer.close(bag_information(TOPICS, []))
    tracemalloc.start()
    try:
        digest = writer.digest
        taken = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert len(digest.unpacked().chunks) == 1001
    assert taken < 45 * 1000


def test_packed_blocks_change_no_byte_of_the_file(begun):
    contents = []
    for packs in (False, True):
        writer, file = begun()
        write_chunks(writer, 20, file, packs)
        writer.close(bag_information(TOPICS, []))
        contents.append(file.getvalue())
        assert writer.digest.sha256 == hashlib.sha256(file.getvalue()).hexdigest()
        for begin, end, sha256 in writer.digest.unpacked().chunks:
            assert sha256 == hashlib.sha256(file.getvalue()[begin:end]).hexdigest()
        assert len(writer.digest.unpacked().chunks) == 21
    assert contents[0] == contents[1]
    summary = make_reader(io.BytesIO(contents[0])).get_summary()
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count == 20
    assert len(summary.attachment_indexes) == summary.statistics.attachment_count == 1
    assert summary.statistics.message_count == 200


@pytest.mark.parametrize("packs", [False, True])
def test_a_file_goes_back_to_what_the_disk_has(begun, packs):
    writer, file = begun()
    write_chunks(writer, 5, file, packs)
    on_the_disk = file.tell()
    write_chunks(writer, 5, file, packs=False)
    writer.close("")  # the disk takes none of it
    end = writer.go_back(on_the_disk + 1)
    assert end == on_the_disk
    assert writer.counts == {topic.name: 5 for topic in TOPICS}
    assert (writer.start, writer.end) == (10**18, 10**18 + 409)
    file.seek(end)
    file.truncate()
    writer.close("")
    assert writer.digest.sha256 == hashlib.sha256(file.getvalue()).hexdigest()
    messages = list(make_reader(io.BytesIO(file.getvalue())).iter_messages())
    assert len(messages) == 50
