# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Limits of a robot's state that hold for every task and every policy.

A joint far beyond its range, or faster than any motor turns it, was measured wrongly: such a state
is not used at all. A base that is tilted far from where it starts is measured rightly, but no
policy drives there, while the robot may be told to stand up.
"""

import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.robot.bodies import StateLayout, vertical
from vgps_ros.safety.settings import SafetySettings


class StateLimits:
    """Tells which limit of the settings a state breaks, as a sentence; empty where it breaks none.

    Args:
        settings: the limits; 0 stands for none.
        layout: what the numbers of a state are.
        upright: a state in which the base is not tilted, shape (n_x,).
    """

    def __init__(self, settings: SafetySettings, layout: StateLayout, upright: Array):
        self._settings, self._layout = settings, layout
        base = layout.base
        self._up = vertical(base.parts(upright)[1]) if base else np.zeros(3)
        margin, fastest = settings.joint_margin or np.inf, settings.joint_speed_limit or np.inf
        ends = zip(layout.ranges, (-margin, margin), (-fastest, fastest), strict=True)
        count = len(layout.joints)
        self._lowest, self._highest = (np.append(e + m, np.full(count, v)) for e, m, v in ends)

    def misread(self, state: Array) -> str:
        """Says which joint of a state (n_x,) cannot be where, or as fast as, it was measured."""
        layout, measured = self._layout, state[self._layout.joint_places]
        strange = (measured < self._lowest) | (measured > self._highest)
        if not strange.any():
            return ""
        velocity, i = divmod(int(np.argmax(strange)), len(layout.joints))
        if velocity:
            return (
                f"{layout.joints[i]} is measured to move at {measured[strange][0]:.4g} in a "
                f"second, but joint_speed_limit is {self._settings.joint_speed_limit:g}; check the "
                "driver's velocities, or raise it."
            )
        low, high = layout.ranges[:, i]
        return (
            f"{layout.joints[i]} is measured at {measured[i]:.4g}, but its range is "
            f"{low:.4g} to {high:.4g}; check the zero, the unit and the order of the driver's "
            "joints, or raise joint_margin."
        )

    def tilted(self, state: Array) -> str:
        """Says how far the base of a state (n_x,) is tilted, if it is too far for a policy."""
        limit, base = self._settings.tilt_limit, self._layout.base
        if not limit or base is None:
            return ""
        tilt = float(np.arccos(np.clip(vertical(base.parts(state)[1]) @ self._up, -1.0, 1.0)))
        if tilt <= limit:
            return ""
        return (
            f"the base is tilted by {tilt:.2f} rad, but tilt_limit is {limit:g} rad; set the robot "
            "upright, or let it stand up."
        )
