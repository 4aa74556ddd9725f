"""Positions of a robot's limbs and of its centre of mass, for drawings."""

import mujoco
import numpy as np

from vgps_ros.core.records import Array


class RobotShape:
    """Computes where the limbs of a model and its centre of mass are in a state.

    Attributes:
        data: MuJoCo's data for the state that was asked for last.
        names: names of the limbs in the MJCF, which are the geometries of moving bodies.
        plane: the two coordinates in which the robot moves: those perpendicular to its hinges, or
            the axes of two slides if it has no hinge. A robot that moves in space is seen from its
            side.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self.data = mujoco.MjData(model)
        moving = model.body_weldid[model.geom_bodyid] > 0
        self._ids = np.flatnonzero(moving & (model.geom_type >= mujoco.mjtGeom.mjGEOM_SPHERE.value))
        self._halves = np.array([_half_axis(model, i) for i in self._ids.tolist()]).reshape(-1, 3)
        self.names = [model.geom(i).name for i in self._ids]
        self.plane = _plane(model)

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
