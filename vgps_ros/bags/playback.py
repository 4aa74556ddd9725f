"""Plays recorded messages back at the times at which they were received.

A message received t seconds after the bag's start is due at origin + t / rate. The origin moves
only when playing is paused and goes on, or begins again: no delay is handed on to the next message.
"""

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass

from vgps_ros.bags.read_ahead import read_ahead
from vgps_ros.bags.reader import BagMessage
from vgps_ros.core.settings import check_settings, setting

_SECOND = 10**9  # [ns]


@dataclass(frozen=True)
class PlaybackSettings:
    """How a bag is played; the fields' own descriptions are what users read."""

    rate: float = setting(
        1.0, "seconds of the bag per second of the wall clock", minimum=0.01, maximum=100.0
    )
    loop: bool = setting(False, "whether to begin again at the end")
    start_offset: float = setting(
        0.0, "time after the bag's start at which to begin [s]", minimum=0.0, maximum=1e9
    )
    delay: float = setting(
        1.0,
        "time before the first message, in which subscribers find the topics [s of the wall clock]",
        minimum=0.0,
        maximum=3600.0,
    )
    start_paused: bool = setting(False, "whether to wait for a service call before playing")


class Playback:
    """Playing of one bag. `run` plays; the other methods may be called from other threads.

    Args:
        read: returns the messages, in the order in which they were received; called again for each
            round of a loop.
        publish: takes each message when it is due.
        start: the bag's start, from which times are counted [ns].
        settings: see there.

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
        self._offset = round(settings.start_offset * _SECOND)
        self._changed = threading.Condition()  # guards all below
        self._earliest = 2**62  # monotonic time of the first message [ns]; far off until it runs
        self._position = self._offset  # after the bag's start [ns]; while it plays, at least
        self._set_origin()
        self._paused = settings.start_paused
        self._step_wanted = False
        self._stepped: BagMessage | None = None
        self._ended = False

    @property
    def paused(self) -> bool:
        """Whether it waits for `resume` or `step`."""
        return self._paused

    @property
    def ended(self) -> bool:
        """Whether all is played, or it was stopped."""
        return self._ended

    @property
    def position(self) -> float:
        """Where it is, after the bag's start [s]."""
        with self._changed:
            return self._now() / _SECOND

    def run(self) -> None:
        """Plays until the end, or until it is stopped.

        An error while reading or publishing ends it and is raised here.
        """
        with self._changed:
            self._earliest = time.monotonic_ns() + round(self._settings.delay * _SECOND)
            self._set_origin()
        try:
            while self._play_once() and self._settings.loop:
                self._rewind()
        finally:
            self.stop()

    def pause(self) -> None:
        """Holds all messages from now on."""
        with self._changed:
            self._position = self._now()
            self._paused = True
            self._changed.notify_all()

    def resume(self) -> None:
        """Goes on from where it was."""
        with self._changed:
            if self._paused:
                self._paused = False
                self._set_origin()
                self._changed.notify_all()

    def step(self) -> BagMessage | None:
        """Plays the next message at once, if it is paused, and goes on from that one's time.

        Returns:
            The message; None if there is none any more, or if it is not paused.
        """
        with self._changed:
            if not self._paused or self._ended:
                return None
            self._step_wanted, self._stepped = True, None
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._step_wanted or self._ended)
            return self._stepped

    def stop(self) -> None:
        """Ends it, whatever it is doing."""
        with self._changed:
            self._position = self._now()
            self._ended = True
            self._changed.notify_all()

    def _play_once(self) -> bool:
        """Plays all messages; returns whether there were any and it may go on."""
        played = False
        with closing(read_ahead(self._wanted())) as messages:
            for message in messages:
                if not self._wait_for(message.stamp - self._start):
                    return False
                self._publish(message)
                played = True
                if self._step_wanted:
                    self._answer_step(message)
        return played

    def _wanted(self) -> Iterator[BagMessage]:
        first = self._start + self._offset
        return (message for message in self._read() if message.stamp >= first)

    def _wait_for(self, position: int) -> bool:
        """Waits until a message of this time is due; returns False if it was stopped."""
        with self._changed:
            while not self._ended:
                if self._paused:
                    if self._step_wanted:
                        self._position = max(self._position, position)
                        return True
                    self._changed.wait()
                else:
                    due = self._origin + round(position / self._settings.rate)
                    left = due - time.monotonic_ns()
                    if left <= 0:
                        self._position = max(self._position, position)
                        return True
                    self._changed.wait(left / _SECOND)
            return False

    def _answer_step(self, message: BagMessage) -> None:
        with self._changed:
            self._step_wanted, self._stepped = False, message
            self._changed.notify_all()

    def _rewind(self) -> None:
        """Goes to the first message of the next round, due when the last one was."""
        with self._changed:
            self._origin += round((self._position - self._offset) / self._settings.rate)
            self._position = self._offset

    def _set_origin(self) -> None:
        """Lets playing go on from the position: now, or when the delay is over."""
        now = max(time.monotonic_ns(), self._earliest)
        # Monotonic time of the bag's start [ns].
        self._origin = now - round(self._position / self._settings.rate)

    def _now(self) -> int:
        """Position at this moment [ns]."""
        if self._paused or self._ended:
            return self._position
        elapsed = time.monotonic_ns() - self._origin
        return max(self._position, round(elapsed * self._settings.rate))
