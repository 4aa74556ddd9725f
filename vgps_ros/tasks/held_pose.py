# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The forces by which servos hold a pose of a robot that stands on the ground under its weight.

A soft servo whose target is the pose itself sags until its deviation carries the weight. So the
robot is simulated, while what a joint lacks of the pose is added to its target, until it is there.
"""

import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.robot.controls import ControlKind, Controls
from vgps_ros.simulation.dynamics import Dynamics

_SECONDS = 8.0  # after which it stands, or never will
_RATE = 2.0  # at which what is lacking is added [1/s]
_NEAR = 0.03  # largest deviation of a joint that stands [rad, m]
_DIGITS = 2  # of a force, to which all processors agree


def carrying_forces(dynamics: Dynamics, controls: Controls, pose: Array) -> Array:
    """Returns τ of each servo of positions that holds a pose (n_x,) at rest, shape (n_u,).

    It is zero of other controls, and of all where the robot does not come to stand in the pose.
    """
    servos = controls.are(ControlKind.POSITION) & controls.positions.any(axis=1)
    state, added = pose, np.zeros(len(controls.names))
    goal, step = controls.positions @ pose, dynamics.time_step
    for _ in range(round(_SECONDS / step) if servos.any() else 0):
        lacking = goal - controls.positions @ state
        added += np.where(servos, _RATE * step * lacking, 0.0)
        state = dynamics.step(state, controls.carrying(pose, controls.stiffness * added))
    stands = np.isfinite(state).all() and (np.abs(goal - controls.positions @ state) < _NEAR).all()
    return np.round(controls.stiffness * added * stands, _DIGITS)
