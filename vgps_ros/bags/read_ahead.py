"""Reads a bag ahead in a thread, so that the decoding of a chunk delays no message.

A chunk of a megabyte takes 2 ms or more to decode, and a disk may take longer. The player must
publish on time, so it takes its messages from a queue that a thread keeps filled. The queue has a
largest size, which bounds the memory.
"""

import threading
from collections.abc import Generator, Iterable
from contextlib import suppress
from queue import Empty, Queue

from vgps_ros.bags.reader import BagMessage

_BATCHES = 16  # largest number of batches in the queue
_MESSAGES, _BYTES = 250, 2**20  # a batch ends at either size; handing over single ones costs time

_Batches = Queue[list[BagMessage] | Exception | None]


def read_ahead(messages: Iterable[BagMessage]) -> Generator[BagMessage, None, None]:
    """Yields the messages while a thread reads those that follow.

    An error while reading is raised here, after the messages before it. Closing the generator ends
    the thread.
    """
    batches, stopped = _Batches(_BATCHES), threading.Event()
    thread = threading.Thread(target=_fill, args=[messages, batches, stopped], daemon=True)
    thread.start()
    try:
        while batch := batches.get():
            if isinstance(batch, Exception):
                raise batch
            yield from batch
    finally:
        stopped.set()
        with suppress(Empty):  # the thread may be waiting for room in the queue
            while True:
                batches.get_nowait()
        thread.join()


def _fill(messages: Iterable[BagMessage], batches: _Batches, stopped: threading.Event) -> None:
    """Puts the messages into the queue in batches, then the error that ended them, or None."""
    batch: list[BagMessage] = []
    size, end = 0, None
    try:
        for message in messages:
            batch.append(message)
            size += len(message.data)
            if len(batch) == _MESSAGES or size > _BYTES:
                batches.put(batch)
                batch, size = [], 0
                if stopped.is_set():
                    return
    except Exception as error:
        end = error
    if batch:
        batches.put(batch)
    batches.put(end)
