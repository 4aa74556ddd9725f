# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Forces on a robot: those that somebody applies to a body, and those of actuators on joints."""

from typing import NamedTuple

import mujoco
import numpy as np

from vgps_ros.core.checks import find_name
from vgps_ros.core.records import Array
from vgps_ros.simulation.model import actuated_joint_names, joint_names


class AppliedForce(NamedTuple):
    """Describes what acts on a body during a step.

    Attributes:
        body: number of the body.
        wrench: force on its centre of mass and torque, along the world's axes, shape (6,) [N, N·m].
    """

    body: int
    wrench: Array


class BodyFrames:
    """Turns what acts in the frames of a model's bodies, which move, to the world's axes."""

    def __init__(self, model: mujoco.MjModel):
        self._model, self._data = model, mujoco.MjData(model)
        bodies = map(model.body, range(1, model.nbody))
        self._bodies = {body.name: body.id for body in bodies if body.name}

    def body(self, name: str) -> int:
        """Returns the number of a body.

        Raises:
            InvalidInputError: there is no such body.
        """
        return self._bodies[find_name("body", name, list(self._bodies))]

    def applied(self, state: Array, body: int, force: Array, torque: Array) -> AppliedForce:
        """Returns what a force at a body's origin and a torque come to in a state (n_x,).

        Both are along the axes of the body's frame, shape (3,) [N, N·m].
        """
        data = self._data
        data.qpos[:] = state[: self._model.nq]
        mujoco.mj_kinematics(self._model, data)
        axes = data.xmat[body].reshape(3, 3)
        force, arm = axes @ force, data.xpos[body] - data.xipos[body]
        return AppliedForce(body, np.concatenate([force, axes @ torque + np.cross(arm, force)]))


def controls_are_forces(model: mujoco.MjModel) -> bool:
    """Returns whether each control is the force on a joint of its own, as of a motor of gear 1."""
    alone = set(actuated_joint_names(model)) <= set(joint_names(model))
    plain = (
        (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        & (model.actuator_gear[:, 0] == 1.0)
        & (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED)
        & (model.actuator_gainprm[:, 0] == 1.0)
        & (model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE)
        & (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE)
    )
    return alone and bool(plain.all())


class JointForces:
    """Forces on the hinges and slides, whatever the actuators are.

    Of a motor with gear 1 it is the control itself, within the motor's limits.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self._data = mujoco.MjData(model)
        dofs = [int(model.joint(name).dofadr[0]) for name in joint_names(model)]
        self._dofs = np.array(dofs, dtype=np.intp)

    def __call__(self, state: Array, control: Array) -> Array:
        """Returns the forces [N·m, N] of a control u in a state x, one for each joint."""
        model, data = self._model, self._data
        nq, n = model.nq, model.nq + model.nv
        data.qpos[:], data.qvel[:], data.act[:] = state[:nq], state[nq:n], state[n:]
        data.ctrl[:] = control
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        forces: Array = data.qfrc_actuator[self._dofs]
        return forces
