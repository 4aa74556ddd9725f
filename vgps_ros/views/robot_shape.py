"""Where a robot's geometry is, for whoever draws it."""

from dataclasses import dataclass

import mujoco
import numpy as np

from vgps_ros.core.records import Array


@dataclass(frozen=True)
class Capsule:
    """A capsule of the robot.

    Attributes:
        name: of the geometry in the MJCF.
        radius: [m].
        half_length: of the cylinder between the two half spheres [m].
        colour: red, green, blue, alpha in [0, 1].
    """

    name: str
    radius: float
    half_length: float
    colour: tuple[float, ...]


class RobotShape:
    """The capsules of a model, and their poses in a state."""

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self._data = mujoco.MjData(model)
        self._ids = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
        self.capsules = [
            Capsule(
                name=model.geom(i).name or f"capsule_{i}",
                radius=float(model.geom_size[i, 0]),
                half_length=float(model.geom_size[i, 1]),
                colour=tuple(model.geom_rgba[i].tolist()),
            )
            for i in self._ids
        ]

    def poses(self, state: Array) -> tuple[Array, Array]:
        """Returns centres (G, 3) [m] and rotation matrices (G, 3, 3) of the capsules."""
        self._place(state)
        return self._data.geom_xpos[self._ids], self._data.geom_xmat[self._ids].reshape(-1, 3, 3)

    def axes(self, state: Array) -> Array:
        """Returns both ends of each capsule's axis, shape (G, 2, 3) [m]."""
        centres, rotations = self.poses(state)
        half = rotations[:, :, 2] * np.array([[c.half_length] for c in self.capsules])
        return np.stack([centres - half, centres + half], axis=1)

    def centre_of_mass(self, state: Array) -> Array:
        """Returns the whole robot's centre of mass, shape (3,) [m]."""
        self._place(state)
        mujoco.mj_comPos(self._model, self._data)
        centre: Array = self._data.subtree_com[0].copy()
        return centre

    def path(self, states: Array) -> Array:
        """Returns the centre of mass in each state, shape (T, 3) [m]."""
        return np.array([self.centre_of_mass(state) for state in states])

    def _place(self, state: Array) -> None:
        self._data.qpos[:] = state[: self._model.nq]
        mujoco.mj_kinematics(self._model, self._data)
