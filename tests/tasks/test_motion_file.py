# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Recorded demonstrations: what is read back, and what is refused."""

import re

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks import make_task
from vgps_ros.tasks.first_motion import with_demonstration
from vgps_ros.tasks.motion_table import load_demonstration, write_motion

WALKER = make_task("walker")


@pytest.fixture
def recorded(tmp_path):
    path = tmp_path / "walk.csv"
    shown, dynamics = WALKER.begin.motion, WALKER.dynamics
    time = dynamics.time_step * np.arange(shown.horizon + 1)
    write_motion(path, dynamics.model, time, shown)
    return path


def test_a_demonstration_is_read_back_bit_for_bit(recorded):
    found = load_demonstration(WALKER, recorded)
    assert_array_equal(found.states, WALKER.begin.motion.states)
    assert_array_equal(found.controls, WALKER.begin.motion.controls)


def test_a_task_starts_where_its_demonstration_does(recorded, swimmer):
    assert_array_equal(with_demonstration(WALKER, recorded).initial_state, WALKER.initial_state)
    with pytest.raises(InvalidInputError, match="lacks the column 'back_joint/effort'; the swimm"):
        with_demonstration(swimmer, recorded)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda t: "\n".join(t.split("\n")[:100]), "has 99 rows, but the walker needs 461: 460 st"),
        (lambda t: t.replace("left_knee", "left_wheel"), "lacks the column 'left_knee/effort'"),
        (lambda t: t.replace("time", "time,lost", 1).replace("\n0", "\n0,0"), "unknown|readable"),
        (lambda t: t.replace("\n0.0,", "\nnan,"), "is nan at index 0"),
        (lambda t: t.replace("\n0.01,", "\n0.02,"), "has 0.02 s between rows 1 and 2, but the w"),
        (
            lambda t: re.sub(r"\n0.0,[^,]*", "\n0.0,1e12", t),
            "1e\\+12 in row 1, but a motion beyond",
        ),
        (lambda t: re.sub(r"[^,\n]*\n0.01,", "-2e9\n0.01,", t), "effort 2e\\+09 in row 1, but a m"),
        (lambda t: "not a table", "has 0 rows|lacks the column"),
        (lambda t: "", "not a readable table"),
    ],
)
def test_a_demonstration_that_does_not_fit_is_refused(recorded, change, sentence):
    recorded.write_text(change(recorded.read_text().replace("\r\n", "\n")))
    with pytest.raises(InvalidInputError, match=sentence):
        load_demonstration(WALKER, recorded)


def test_rates_that_rounding_changes_are_taken(recorded):
    lines = recorded.read_text().splitlines()
    rounded = [f"{float(time):.3f},{rest}" for time, rest in (x.split(",", 1) for x in lines[1:])]
    recorded.write_text("\n".join([lines[0], *rounded]))
    assert np.isfinite(load_demonstration(WALKER, recorded).states).all()
