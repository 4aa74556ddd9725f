# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The tasks at 100 Hz are the built-in robots' but for the time of a control."""

import pytest

from benchmarks.hundred_hertz import ROBOTS, at_hundred_hertz, table
from vgps_ros.tasks import make_task


@pytest.mark.parametrize("robot", ROBOTS)
def test_each_robot_is_controlled_at_100_hz(robot, tmp_path):
    task, own = make_task(at_hundred_hertz(robot, tmp_path)), make_task(robot)
    assert task.dynamics.time_step == pytest.approx(0.01)
    assert task.dims == own.dims
    assert task.cost_names == own.cost_names
    seconds = task.horizon * task.dynamics.time_step
    assert seconds == pytest.approx(own.horizon * own.dynamics.time_step)


def test_the_table_has_a_row_for_each_run():
    figures = {
        "robot": "walker", "controller": "mpc", "plans a second": 40.0, "median plan [ms]": None,
        "missed deadlines": 0.01, "answer p50, p99 [ms]": [0.5, 1.234], "pushes": 30, "falls": 0,
        "median cost a step": 0.1, "mean cost a step": 0.2, "load average": 2.0,
    }  # fmt: skip
    assert "| walker | mpc | 40 | – | 0.01 | 0.5, 1.23 | 30 | 0 |" in table([figures])
