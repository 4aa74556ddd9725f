# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The simulation of a cluster against what it must be in the limits."""

import pytest

from benchmarks.cluster import simulate

TIMES = [1.0, 2.0, 3.0, 2.0]


@pytest.mark.parametrize(
    ("workers", "per_task", "expected"),
    [(1, 0.0, 8.0), (2, 0.0, 4.0), (100, 0.0, 3.0), (100, 10.0, 42.0)],
)
def test_solves_wait_for_a_worker_or_for_the_scheduler(workers, per_task, expected):
    assert simulate(TIMES, workers, per_task) == expected
