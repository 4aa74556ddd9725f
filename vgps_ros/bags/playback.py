# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plays recorded messages back with the delays with which they were received.

A message that was received t seconds after the bag's start is due at origin + t / rate. The origin
moves only when playing resumes after a pause, starts again, seeks or changes its rate, so a message
that is late does not delay the next one.
"""

import struct
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated

from vgps_ros.bags.reader import BagMessage
from vgps_ros.core.settings import Range, check_settings

CLOCK_TOPIC, CLOCK_KIND = "/clock", "rosgraph_msgs/msg/Clock"

_CDR_HEADER = bytes((0, 1, 0, 0))  # little endian
_SECOND = 10**9  # [ns]


@dataclass(frozen=True)
class PlaybackSettings:
    """Settings of the playback. Their descriptions are what users read."""

    rate: Annotated[
        float, Range(0.01, 100.0), "seconds of the bag per second of the wall clock"
    ] = 1.0
    loop: Annotated[bool, "whether to begin again at the end"] = False
    start_offset: Annotated[
        float, Range(0.0, 1e9), "time after the bag's start at which to begin [s]"
    ] = 0.0
    delay: Annotated[
        float,
        Range(0.0, 3600.0),
        "time before the first message, in which subscribers find the topics [s of the wall clock]",
    ] = 1.0
    start_paused: Annotated[bool, "whether to wait for a service call before playing"] = False


class Playback:
    """Plays one bag. `run` plays; the other methods may be called from other threads.

    Args:
        read: returns the messages in the order in which they were received. A loop calls it again
            for each round.
        publish: called with each message when it is due.
        start: time of the bag's start [ns].
        settings: rate, offset and delay of the playback.

    Attributes:
        rate: seconds of the bag per second of the wall clock.
        paused: True while it waits for `resume` or `step`.
        ended: True once all messages are played, or `stop` was called.

    Raises:
        InvalidInputError: a setting is out of range.
    """

    def __init__(
        self,
        read: Callable[[], Iterable[BagMessage]],
        publish: Callable[[BagMessage], object],
        start: int,
        settings: PlaybackSettings,
    ):
        check_settings(settings)
        self._read = read
        self._publish = publish
        self._start = start
        self._settings = settings
        self.rate = settings.rate
        self._offset = round(settings.start_offset * _SECOND)
        self._changed = threading.Condition()  # guards all attributes below
        self._sought: int | None = None  # position at which to go on [ns]
        self._earliest = 2**62  # monotonic time of the first message [ns]; far off until `run`
        self._position = self._offset  # lower bound of the time since the bag's start [ns]
        self._set_origin()
        self.paused = settings.start_paused
        self._step_wanted = False
        self._stepped: BagMessage | None = None
        self.ended = False

    @property
    def position(self) -> float:
        """Time since the bag's start at which the playback is [s]."""
        with self._changed:
            return self._now() / _SECOND

    def run(self) -> None:
        """Plays until the end, or until `stop` is called.

        An error while reading or publishing ends the playback and is raised here.
        """
        with self._changed:
            self._earliest = time.monotonic_ns() + round(self._settings.delay * _SECOND)
            self._set_origin()
        begin = self._offset
        try:
            while True:
                again = self._play_from(begin) or begin > self._offset
                with self._changed:
                    if self._sought is not None:
                        begin, self._sought = self._sought, None
                    elif self.ended or not (self._settings.loop and again):
                        break
                    else:  # the next round starts when the last message was due
                        begin = self._offset
                        self._origin += round((self._position - begin) / self.rate)
                        self._position = begin
        finally:
            self.stop()

    def pause(self) -> None:
        """Holds all messages until `resume` or `step`."""
        with self._changed:
            self._position = self._now()
            self.paused = True
            self._changed.notify_all()

    def resume(self) -> None:
        """Plays on from the current position."""
        with self._changed:
            if self.paused:
                self.paused = False
                self._set_origin()
                self._changed.notify_all()

    def set_rate(self, rate: float) -> None:
        """Plays on at another rate.

        Raises:
            InvalidInputError: it is out of range.
        """
        check_settings(replace(self._settings, rate=rate))
        with self._changed:
            self._position = self._now()
            self.rate = rate
            self._set_origin()
            self._changed.notify_all()

    def seek(self, position: int) -> None:
        """Goes on from another time since the bag's start [ns], and stays there while paused."""
        with self._changed:
            self._position = self._sought = position
            self._set_origin()
            self._changed.notify_all()

    def step(self) -> BagMessage | None:
        """Plays one message at once while paused, and moves the position to its time.

        Returns:
            The message, or None if there is no further message or the playback is not paused.
        """
        with self._changed:
            if not self.paused or self.ended:
                return None
            self._step_wanted, self._stepped = True, None
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._step_wanted or self.ended)
            return self._stepped

    def stop(self) -> None:
        """Ends the playback at once."""
        with self._changed:
            self._position = self._now()
            self.ended = True
            self._changed.notify_all()

    def _play_from(self, begin: int) -> bool:
        """Plays from a position [ns]; returns True if it came to the end, and played any."""
        played = False
        first = self._start + begin
        for message in self._read():
            if message.stamp < first:
                continue
            if not self._wait_for(message.stamp - self._start):
                return False
            self._publish(message)
            played = True
            if self._step_wanted and not isinstance(message, ClockTick):
                with self._changed:
                    self._step_wanted, self._stepped = False, message
                    self._changed.notify_all()
        return played

    def _wait_for(self, position: int) -> bool:
        """Waits until a message at this position is due. Returns False after `stop` or `seek`."""
        with self._changed:
            while not self.ended and self._sought is None:
                if self.paused:
                    if self._step_wanted:
                        self._position = max(self._position, position)
                        return True
                    self._changed.wait()
                else:
                    due = self._origin + round(position / self.rate)
                    left = due - time.monotonic_ns()
                    if left <= 0:
                        self._position = max(self._position, position)
                        return True
                    self._changed.wait(left / _SECOND)
            return False

    def _set_origin(self) -> None:
        """Sets the origin so that playing goes on from the position, now or after the delay."""
        now = max(time.monotonic_ns(), self._earliest)
        # The origin is the monotonic time [ns] that corresponds to the bag's start.
        self._origin = now - round(self._position / self.rate)

    def _now(self) -> int:
        """Returns the position at this moment [ns]."""
        if self.paused or self.ended:
            return self._position
        elapsed = time.monotonic_ns() - self._origin
        return max(self._position, round(elapsed * self.rate))


class ClockTick(BagMessage):
    """A message on /clock that the bag does not have; a step does not count it."""

    @classmethod
    def at(cls, stamp: int) -> "ClockTick":
        """Returns the one of a time [ns]."""
        data = _CDR_HEADER + struct.pack("<iI", *divmod(stamp, _SECOND))
        return cls(CLOCK_TOPIC, CLOCK_KIND, stamp, data)


def with_clock(messages: Iterable[BagMessage], period: Callable[[], int]) -> Iterator[BagMessage]:
    """Yields the messages, and before each message the ticks of /clock that are due by then.

    Args:
        messages: messages in the order in which they were received; the first starts the clock.
        period: returns the time between two ticks [ns], which may change.
    """
    tick: int | None = None
    for message in messages:
        tick = message.stamp if tick is None else tick
        while tick <= message.stamp:
            yield ClockTick.at(tick)
            tick += period()
        yield message
