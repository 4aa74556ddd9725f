# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What the compiled loops rely on in MuJoCo, numba and llvmlite; a new version may change it."""

import mujoco
import numpy as np
import pytest

from vgps_ros.core.compilation import compile_at_first_call
from vgps_ros.simulation.mujoco_functions import mj_step_skip


@compile_at_first_call
def _steps(model, data, count):
    for _ in range(count):
        mj_step_skip(model, data, -1, 1)


@pytest.fixture
def model(swimmer):
    return swimmer.dynamics.model


def test_mujoco_still_has_the_private_name_of_an_address(model):
    for record in (model, mujoco.MjData(model)):
        assert isinstance(getattr(record, "_address", None), int), (
            f"{type(record).__name__} of mujoco {mujoco.__version__} has no number `_address`: "
            "find the pointer's new name, and change vgps_ros/simulation/dynamics.py."
        )


def test_compiled_calls_do_what_mujoco_s_python_functions_do(model):
    ours, theirs = mujoco.MjData(model), mujoco.MjData(model)
    ours.ctrl[:] = theirs.ctrl[:] = (20.0, -10.0)
    _steps(model._address, ours._address, 6)
    mujoco.mj_step(model, theirs, 6)
    np.testing.assert_array_equal(np.r_[ours.qpos, ours.qvel], np.r_[theirs.qpos, theirs.qvel])
    assert ours.time == pytest.approx(6 * model.opt.timestep), (
        "numba's or llvmlite's way to call a C function has changed: see "
        "vgps_ros/simulation/mujoco_functions.py."
    )
