# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The peers of our derivatives: MuJoCo's plain differences at every step, on one thread."""

import mujoco
import numpy as np

from vgps_ros.core.records import LinearDynamics, Trajectory
from vgps_ros.simulation.dynamics import Dynamics

_EPS = 1e-6


class CentredDynamics(Dynamics):
    """The same dynamics, differentiated by `mjd_transitionFD`, centred."""

    is_centred = True

    def linearize(
        self, trajectory: Trajectory, *, centred: bool = True
    ) -> tuple[LinearDynamics, int]:
        """Returns f_x, f_u along a trajectory, and how many simulator steps they took."""
        assert centred
        horizon, n_dx, n_u = trajectory.horizon, self.space.tangent_dim, self.control_dim
        f_x, f_u = np.tile(np.eye(n_dx), (horizon, 1, 1)), np.zeros((horizon, n_dx, n_u))
        a, b = np.empty((n_dx, n_dx)), np.empty((n_dx, n_u))
        data, ends = mujoco.MjData(self.model), [self.model.nq, self.model.nq + self.model.nv]
        for t in range(horizon):
            data.qpos[:], data.qvel[:], data.act[:] = np.split(trajectory.states[t], ends)
            data.ctrl[:] = trajectory.controls[t]
            data.qacc_warmstart[:] = 0.0
            for substep in range(self.substeps):
                if substep:
                    mujoco.mj_step(self.model, data)
                mujoco.mjd_transitionFD(self.model, data, _EPS, self.is_centred, a, b, None, None)
                f_x[t], f_u[t] = a @ f_x[t], a @ f_u[t] + b
        return LinearDynamics(f_x, f_u), horizon * self.substeps * (
            (1 + self.is_centred) * (n_dx + n_u) + 1
        )


class ForwardDynamics(CentredDynamics):
    """The same by forward differences, which take half as many steps and err more."""

    is_centred = False
