"""Where a robot's parts are in a state, by MuJoCo's forward kinematics."""

import mujoco
import numpy as np

from vgps_ros.core.records import Array


class Kinematics:
    """Poses of a model's bodies and of its centre of mass.

    Args:
        model: the robot; it is only read.
    """

    def __init__(self, model: mujoco.MjModel):
        self.model = model
        self._data = mujoco.MjData(model)

    def at(self, state: Array) -> mujoco.MjData:
        """Returns poses in a state: `xpos`, `xquat` and `subtree_com`, valid until the next call.

        Args:
            state: shape (n_x,), generalized positions [m, rad] first.
        """
        self._data.qpos[:] = state[: self.model.nq]
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)
        return self._data

    def centre_of_mass(self, states: Array) -> Array:
        """Returns the path of the centre of mass, shape (N, 3), [m], for states (N, n_x)."""
        return np.array([self.at(state).subtree_com[0] for state in states]).reshape(-1, 3)

    def links(self, state: Array) -> Array:
        """Returns both ends of each capsule, shape (links, 2, 3), [m]."""
        data = self.at(state)
        capsules = np.flatnonzero(self.model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
        half_lengths = self.model.geom_size[capsules, 1, None]
        axes = data.geom_xmat[capsules].reshape(-1, 3, 3)[:, :, 2]
        centres = data.geom_xpos[capsules]
        return np.stack([centres - half_lengths * axes, centres + half_lengths * axes], axis=1)
