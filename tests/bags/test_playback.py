# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Playback without a graph: when messages come, and what holds them."""

import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest

from vgps_ros.bags import BagMessage
from vgps_ros.bags.playback import Playback, PlaybackSettings, with_clock
from vgps_ros.core.errors import InvalidInputError

START = 10**18
PATIENCE = 20.0  # the machine may be busy [s]
HOUR = 3600


def messages(*times: float) -> list[BagMessage]:
    """Messages received at these times after the start [s]."""
    return [
        BagMessage("/a", "std_msgs/msg/Empty", START + round(t * 1e9), bytes([i]))
        for i, t in enumerate(times)
    ]


class Run:
    """A playback in a thread, and what it has published when."""

    def __init__(self, recorded: list[BagMessage], **settings: object):
        self.published: list[BagMessage] = []
        self.times: list[float] = []
        values = PlaybackSettings(**{"delay": 0.0, **settings})  # type: ignore[arg-type]
        self.playback = Playback(lambda: recorded, self._take, START, values)
        self._thread = threading.Thread(target=self.playback.run)
        self.began = time.monotonic()
        self._thread.start()

    def _take(self, message: BagMessage) -> None:
        self.times.append(time.monotonic() - self.began)
        self.published.append(message)

    @property
    def numbers(self) -> list[int]:
        return [message.data[0] for message in self.published]

    def wait(self) -> None:
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()

    def wait_for(self, count: int) -> None:
        wait_until(lambda: len(self.published) >= count)


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.fixture
def let_pass(monkeypatch):
    """Returns a function that moves the playback's clock on by an hour, at once."""
    passed = 0

    def move_on() -> None:
        nonlocal passed
        passed += HOUR * 10**9

    clock = SimpleNamespace(monotonic_ns=lambda: time.monotonic_ns() + passed)
    monkeypatch.setattr("vgps_ros.bags.playback.time", clock)
    return move_on


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_no_message_comes_before_its_time(rate):
    due = [0.0, 0.1, 0.1, 0.3, 0.4]
    run = Run(messages(*due), rate=rate)
    run.wait()
    assert run.numbers == [0, 1, 2, 3, 4]
    assert all(t >= d / rate for t, d in zip(run.times, due, strict=True))
    assert run.playback.position >= 0.4


def test_a_slow_publisher_delays_no_message_that_is_due_later(let_pass):
    """The first message takes an hour. Handed on, the delay would never let the third come."""

    def publish(message: BagMessage) -> None:
        published.append(message.data[0])
        if message.data[0] == 0:
            let_pass()

    published: list[int] = []
    recorded, settings = messages(0.0, 0.1, HOUR + 0.3), PlaybackSettings(delay=0.0)
    playback = Playback(lambda: recorded, publish, START, settings)
    thread = threading.Thread(target=playback.run)
    thread.start()
    thread.join(PATIENCE)
    playback.stop()
    assert published == [0, 1, 2]


def test_the_offset_leaves_out_what_came_before_it_and_is_not_waited_for():
    run = Run(messages(0.0, 99.9, 100.0, 100.2), start_offset=100.0)
    run.wait()
    assert run.numbers == [2, 3]
    assert 0.2 <= run.times[1] < 5.0


def test_the_delay_comes_before_the_first_message():
    run = Run(messages(0.0, 0.1), delay=0.3)
    assert run.playback.position == 0.0
    run.wait()
    assert run.times[0] >= 0.3
    assert run.times[1] >= 0.4


def test_after_a_pause_it_goes_on_from_where_it_was(let_pass):
    run = Run(messages(0.0, 1.0, 1.1))
    run.wait_for(1)
    run.playback.pause()
    assert run.playback.paused
    position = run.playback.position
    let_pass()
    time.sleep(0.1)
    assert run.numbers == [0]
    assert run.playback.position == position
    run.playback.resume()
    run.wait()
    assert run.numbers == [0, 1, 2]
    assert run.times[1] >= 1.0


def test_steps_give_one_message_each_and_say_when_there_is_none():
    run = Run(messages(0.0, 30.0, 30.1), start_paused=True)
    assert [run.playback.step().data[0] for _ in range(2)] == [0, 1]
    assert run.playback.position == 30.0
    time.sleep(0.2)
    assert run.numbers == [0, 1]
    run.playback.resume()  # from the time of the last step
    assert run.playback.step() is None  # not paused
    run.wait()
    assert run.numbers == [0, 1, 2]
    assert run.playback.step() is None
    assert run.playback.ended


def test_the_step_after_the_last_message_is_answered_when_it_ends():
    run = Run(messages(0.0), start_paused=True)
    assert run.playback.step() is not None
    assert run.playback.step() is None
    run.wait()


@pytest.mark.parametrize("paused", [False, True])
def test_stop_ends_it_in_a_wait_and_in_a_pause(paused):
    run = Run(messages(0.0, 1000.0), start_paused=paused)
    if not paused:
        run.wait_for(1)
    run.playback.stop()
    run.wait()
    assert len(run.published) == (0 if paused else 1)


def test_a_loop_begins_again_until_it_is_stopped():
    run = Run(messages(0.0, 0.05, 0.1), loop=True, start_offset=0.05)
    run.wait_for(5)
    run.playback.pause()
    run.playback.resume()
    run.wait_for(7)
    run.playback.stop()
    run.wait()
    assert run.numbers[:7] == [1, 2, 1, 2, 1, 2, 1]
    assert run.times[6] >= 3 * 0.05


def test_a_loop_over_nothing_ends():
    Run(messages(0.0), loop=True, start_offset=5.0).wait()


def test_a_bad_rate_is_refused_with_the_valid_ones():
    with pytest.raises(InvalidInputError, match=r"rate is 0.0, but it must be from 0.01 to 100"):
        Playback(list, print, START, PlaybackSettings(rate=0.0))


def test_an_error_while_reading_comes_after_what_was_read_and_ends_steps():
    def broken() -> Iterator[BagMessage]:
        yield from messages(0.0, 0.1)
        raise OSError("unreadable")

    published: list[BagMessage] = []
    playback = Playback(broken, published.append, START, PlaybackSettings(delay=0.0))
    with pytest.raises(OSError, match="unreadable"):
        playback.run()
    assert len(published) == 2
    assert playback.ended


def test_ticks_of_the_clock_come_before_what_came_after_them():
    times = [0.0, 0.25, 0.6]
    mixed = list(with_clock(messages(*times), lambda: round(0.2e9)))
    found = [((m.stamp - START) / 1e9, m.topic) for m in mixed]
    assert [t for t, topic in found if topic == "/clock"] == [0.0, 0.2, 0.4, 0.6]
    assert [t for t, topic in found if topic == "/a"] == times
    assert found == sorted(found, key=lambda f: (f[0], f[1] == "/a"))
