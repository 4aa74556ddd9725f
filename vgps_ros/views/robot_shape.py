# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Positions of a robot's limbs and of its centre of mass, for drawings."""

import mujoco
import numpy as np

from vgps_ros.core.records import Array

_FROM_SIDE, _FROM_ABOVE = (-0.4, -1.7, 0.4), (0.0, -0.2, 1.4)  # in sizes of the robot


class RobotShape:
    """Computes where the limbs of a model and its centre of mass are in a state.

    Attributes:
        data: MuJoCo's data for the state that was asked for last.
        names: names of the limbs in the MJCF, which are the geometries of moving bodies.
        plane: the two coordinates in which the robot moves: those perpendicular to its hinges, or
            the axes of two slides if it has no hinge. A robot that moves in space is seen from its
            side.
        viewpoint: from where the whole robot is seen in that plane, relative to its centre of mass,
            shape (3,) [m].
    """

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self.data = mujoco.MjData(model)
        moving = model.body_weldid[model.geom_bodyid] > 0
        self._ids = np.flatnonzero(moving & (model.geom_type >= mujoco.mjtGeom.mjGEOM_SPHERE.value))
        self._halves = np.array([_half_axis(model, i) for i in self._ids.tolist()]).reshape(-1, 3)
        self.names = [model.geom(i).name for i in self._ids]
        self.plane = _plane(model)
        away = _FROM_ABOVE if self.plane == (0, 1) else _FROM_SIDE
        self.viewpoint: Array = model.stat.extent * np.array(away)

    def axes(self, state: Array) -> Array:
        """Returns both ends of each limb's longest axis, shape (G, 2, 3) [m]."""
        self._place(state)
        centres = self.data.geom_xpos[self._ids]
        turned = self.data.geom_xmat[self._ids].reshape(-1, 3, 3)
        half = np.einsum("gij,gj->gi", turned, self._halves)
        return np.stack([centres - half, centres + half], axis=1)

    def centre_of_mass(self, state: Array) -> Array:
        """Returns the whole robot's centre of mass, shape (3,) [m]."""
        self._place(state)
        mujoco.mj_comPos(self._model, self.data)
        centre: Array = self.data.subtree_com[0].copy()
        return centre

    def path(self, states: Array) -> Array:
        """Returns the centre of mass in each state, shape (T, 3) [m]."""
        return np.array([self.centre_of_mass(state) for state in states])

    def _place(self, state: Array) -> None:
        self.data.qpos[:] = state[: self._model.nq]
        mujoco.mj_kinematics(self._model, self.data)


def floor(model: mujoco.MjModel) -> int | None:
    """Returns the index of the floor, which is the model's first plane, or None without one."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    return int(planes[0]) if len(planes) else None


def _half_axis(model: mujoco.MjModel, i: int) -> Array:
    """Returns half of a geometry's longest axis, in its own frame, shape (3,) [m]."""
    half, size = np.zeros(3), model.geom_size[i]
    round_about_z = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)
    if mujoco.mjtGeom(model.geom_type[i]) in round_about_z:
        half[2] = size[1]
    else:
        half[size.argmax()] = size.max()
    return half


def _plane(model: mujoco.MjModel) -> tuple[int, int]:
    """Returns the coordinates of the plane that a robot's joints leave it in; else x and z."""
    in_space = model.jnt_type < int(mujoco.mjtJoint.mjJNT_SLIDE)
    hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    normals, slides = (set(np.abs(data.xaxis[a]).argmax(axis=1)) for a in (hinges, ~hinges))
    if in_space.any() or len(normals) > 1 or (not normals and len(slides) != 2):
        return 0, 2
    first, second = sorted({0, 1, 2} - normals if normals else slides)
    return first, second
