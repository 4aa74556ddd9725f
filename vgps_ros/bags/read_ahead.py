# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a bag ahead in a thread, so that the decoding of a chunk delays no message.

A chunk of a megabyte takes 2 ms or more to decode, and a disk may take longer. The player must
publish on time, so a thread reads some batches of messages ahead. Their number bounds the memory.
"""

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

from vgps_ros.bags.reader import BagMessage

_BATCHES = 16  # number of batches that are read ahead
_MESSAGES, _BYTES = 250, 2**20  # a batch ends at either size; handing over single ones costs time


def read_ahead(messages: Iterable[BagMessage]) -> Generator[BagMessage, None, None]:
    """Yields the messages while a thread reads those that follow.

    An error while reading is raised here, after the messages before it. Closing the generator ends
    the thread.
    """
    batches, reader = _batches(messages), ThreadPoolExecutor(1, "read_ahead")
    coming = deque(reader.submit(next, batches, None) for _ in range(_BATCHES))
    try:
        while batch := coming.popleft().result():
            coming.append(reader.submit(next, batches, None))
            yield from batch
    finally:
        reader.shutdown(cancel_futures=True)


def _batches(messages: Iterable[BagMessage]) -> Iterator[list[BagMessage]]:
    batch: list[BagMessage] = []
    size = 0
    try:
        for message in messages:
            batch.append(message)
            size += len(message.data)
            if len(batch) == _MESSAGES or size > _BYTES:
                yield batch
                batch, size = [], 0
    except Exception:
        if batch:
            yield batch
        raise
    yield batch
