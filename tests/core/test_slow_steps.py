# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A program says what it is at, but only where that takes long."""

import time
from types import SimpleNamespace

import pytest

from vgps_ros.core import slow_steps


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(slow_steps, "_DELAY", 0.05)


def test_nobody_is_told_of_a_moment(capsys):
    slow_steps.progress_lines("Samples")(0.5)
    time.sleep(0.2)
    assert capsys.readouterr().err == ""


def test_the_time_left_is_told_by_the_share_that_is_done(capsys, monkeypatch):
    clock = iter([0.0, 1.0, 9.0, 10.0, 19.0, 20.0, 40.0])
    monkeypatch.setattr(slow_steps, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    monkeypatch.setattr(slow_steps, "_DELAY", 2.0)
    report = slow_steps.progress_lines("Samples")
    for share in (0.1, 0.01, 0.25, 0.4, 0.5, 1.0):
        report(share)
    assert capsys.readouterr().err.splitlines() == [
        "Samples: 25 %, about 30 s left.",
        "Samples: 50 %, about 20 s left.",
    ]


def test_progress_that_takes_long_is_told_once_in_a_while(capsys):
    report = slow_steps.progress_lines("Samples")
    time.sleep(0.1)
    for share in (0.25, 0.5, 1.0):
        report(share)
    assert capsys.readouterr().err.startswith("Samples: 25 %, about ")
    report(1.0)
    assert capsys.readouterr().err == ""
