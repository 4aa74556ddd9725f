# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The exit from a tube is found at its time, and a motion that only runs late is recognised."""

import numpy as np
import pytest

from vgps_ros.views.plots import find_tube_exit

STEP = 0.01
TIME = STEP * np.arange(601)
DEVIATION = np.full((601, 2), 0.1)


def gait(time):
    return np.stack([np.sin(2 * np.pi * time), 0.5 * np.cos(2 * np.pi * time)], axis=1)


def test_a_motion_within_the_tube_does_not_leave_it():
    assert find_tube_exit(gait(TIME) + 0.19, gait(TIME), DEVIATION, STEP) is None


def test_touching_the_edge_for_a_moment_is_no_exit():
    executed = gait(TIME)
    executed[300:305] += 1.0
    assert find_tube_exit(executed, gait(TIME), DEVIATION, STEP) is None


@pytest.mark.parametrize("delay", [0.2, -0.2])
def test_a_gait_that_runs_late_or_early_is_the_same_motion(delay):
    executed = np.where(TIME[:, None] < 2.0, gait(TIME), gait(TIME - delay))
    found = find_tube_exit(executed, gait(TIME), DEVIATION, STEP)
    assert found is not None
    assert found.time == pytest.approx(2.0, abs=0.11)
    assert found.delay == pytest.approx(delay, abs=STEP)
    assert str(found).endswith(f"the same motion, 0.20 s {'later' if delay > 0 else 'earlier'}")


def test_another_motion_is_said_to_be_one():
    executed = gait(TIME)
    executed[200:, 1] = 1.0  # the second joint stops
    found = find_tube_exit(executed, gait(TIME), DEVIATION, STEP)
    assert found is not None
    assert (found.coordinate, found.delay) == (1, None)
    assert found.time == pytest.approx(2.0)


def test_a_motion_that_ends_early_is_compared_as_far_as_it_goes():
    assert find_tube_exit(gait(TIME)[:3], gait(TIME), DEVIATION, STEP) is None
    assert find_tube_exit(gait(TIME)[:100] + 9.0, gait(TIME), DEVIATION, STEP) is not None
