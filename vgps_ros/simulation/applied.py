# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A force and a torque that somebody applies to a body of the robot."""

from typing import NamedTuple

import mujoco
import numpy as np

from vgps_ros.core.patterns import known
from vgps_ros.core.records import Array


class Applied(NamedTuple):
    """Describes what acts on a body during a step.

    Attributes:
        body: number of the body.
        wrench: force on its centre of mass and torque, along the world's axes, shape (6,) [N, N·m].
    """

    body: int
    wrench: Array


class BodyFrames:
    """Turns what acts in the frames of a model's bodies, which move, to the world's axes.

    Args:
        model: the robot.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model, self._data = model, mujoco.MjData(model)
        bodies = map(model.body, range(1, model.nbody))
        self._bodies = {body.name: body.id for body in bodies if body.name}

    def body(self, name: str) -> int:
        """Returns the number of a body.

        Raises:
            InvalidInputError: there is no such body.
        """
        return self._bodies[known("body", name, list(self._bodies))]

    def applied(self, state: Array, body: int, force: Array, torque: Array) -> Applied:
        """Returns what a force at a body's origin and a torque come to in a state.

        Args:
            state: x, shape (n_x,).
            body: number of the body.
            force: along the axes of the body's frame, shape (3,) [N].
            torque: likewise, shape (3,) [N·m].
        """
        data = self._data
        data.qpos[:] = state[: self._model.nq]
        mujoco.mj_kinematics(self._model, data)
        axes = data.xmat[body].reshape(3, 3)
        force, arm = axes @ force, data.xpos[body] - data.xipos[body]
        return Applied(body, np.concatenate([force, axes @ torque + np.cross(arm, force)]))
