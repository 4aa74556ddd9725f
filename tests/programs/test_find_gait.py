# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The gait's cost: what walks longer is better, whatever it costs in torque."""

from dataclasses import replace

from vgps_ros.programs.find_gait import FALLING, gait_cost
from vgps_ros.tasks import make_task
from vgps_ros.tasks.walker.simbicon import GAIT


def test_a_gait_that_walks_beats_one_that_falls():
    walker = make_task("walker")
    limp = replace(GAIT, torso_stiffness=1.0)
    walking, falling = (gait_cost(walker, gait, seconds=3.0) for gait in (GAIT, limp))
    assert 0 < walking < 0.2 * FALLING < falling
