# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Computes the forces that a model's actuators exert on its joints."""

import mujoco
import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.simulation.model import actuated_joint_names, joint_names


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

    Args:
        model: the robot.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self._data = mujoco.MjData(model)
        dofs = [int(model.joint(name).dofadr[0]) for name in joint_names(model)]
        self._dofs = np.array(dofs, dtype=np.intp)

    def __call__(self, state: Array, control: Array) -> Array:
        """Returns the forces [N·m, N] of a control u in a state x, one for each joint."""
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:], data.act[:] = np.split(state, [model.nq, model.nq + model.nv])
        data.ctrl[:] = control
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        forces: Array = data.qfrc_actuator[self._dofs]
        return forces
