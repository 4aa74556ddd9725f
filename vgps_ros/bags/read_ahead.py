"""Reads ahead in a thread, so that decoding a chunk of a bag delays no message.

A chunk of a megabyte takes 2 ms or more to decode, and a disk may take longer. A consumer that must
keep times takes its messages from a queue that a thread keeps filled; the queue is bounded, and so
is memory.
"""

import threading
from collections import deque
from collections.abc import Generator, Iterable

from vgps_ros.bags.reader import BagMessage

_MAX_MESSAGES = 4000  # waiting to be taken
_MAX_BYTES = 2**24
_BATCH = 100  # messages handed over at once: locks cost time too


def read_ahead(messages: Iterable[BagMessage]) -> Generator[BagMessage, None, None]:
    """Yields the same messages, read by a thread.

    What goes wrong while reading is raised here, after the messages before it. Closing the
    generator ends the thread.
    """
    reader = _Reader(messages)
    try:
        while batch := reader.take():
            yield from batch
    finally:
        reader.stop()


class _Reader:
    def __init__(self, messages: Iterable[BagMessage]):
        self._messages = messages
        self._batches: deque[list[BagMessage]] = deque()
        self._count = self._bytes = 0  # in the queue
        self._changed = threading.Condition()
        self._stopped = self._complete = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="read_ahead", daemon=True)
        self._thread.start()

    def take(self) -> list[BagMessage]:
        """Waits for the next messages and returns them; an empty list is the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._batches or self._complete)
            if self._batches:
                batch = self._batches.popleft()
                self._count -= len(batch)
                self._bytes -= _size(batch)
                self._changed.notify_all()
                return batch
        if self._error:
            raise self._error
        return []

    def stop(self) -> None:
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
        self._thread.join()

    def _read(self) -> None:
        batch: list[BagMessage] = []
        try:
            for message in self._messages:
                batch.append(message)
                if len(batch) == _BATCH or len(message.data) > _MAX_BYTES // _BATCH:
                    if not self._put(batch):
                        return
                    batch = []
        except Exception as error:
            self._error = error
        if batch:
            self._put(batch)
        with self._changed:
            self._complete = True
            self._changed.notify_all()

    def _put(self, batch: list[BagMessage]) -> bool:
        """Adds messages once there is room; returns False if they are no longer wanted."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._stopped or (self._count < _MAX_MESSAGES and self._bytes < _MAX_BYTES)
            )
            self._batches.append(batch)
            self._count += len(batch)
            self._bytes += _size(batch)
            self._changed.notify_all()
            return not self._stopped


def _size(batch: list[BagMessage]) -> int:
    return sum(len(message.data) for message in batch)
