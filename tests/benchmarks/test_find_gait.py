# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The gait's cost: what walks longer is better, whatever it costs in torque."""

from dataclasses import replace

from benchmarks.find_gait import FALLING, from_vector, gait_cost, to_vector
from vgps_ros.tasks import make_task
from vgps_ros.tasks.walker.simbicon import GAIT


def test_a_gait_that_walks_beats_one_that_falls():
    walker = make_task("walker")
    limp = replace(GAIT, torso_stiffness=1.0)
    walking, falling = (gait_cost(walker, gait, seconds=3.0) for gait in (GAIT, limp))
    assert 0 < walking < 0.2 * FALLING < falling


def test_a_gait_as_a_vector_is_the_same_gait():
    assert from_vector(to_vector(GAIT)) == GAIT
