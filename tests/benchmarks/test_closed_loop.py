# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""In a closed loop a plan drives only after the time that it took, and both sides read alike."""

import time

import mujoco
import numpy as np
import pytest

from benchmarks.closed_loop import drive
from benchmarks.sampling_peers import ROOT, shared_problem
from vgps_ros.simulation.model import compile_model
from vgps_ros.tasks import make_task


class Counter:
    """A robot whose state is the sum of its controls."""

    def __init__(self):
        self.state = np.zeros(1)

    def advance(self, control):
        self.state = self.state + control


class SlowPlanner:
    """Its plan gives the step from which it was made; it takes a time."""

    def __init__(self, seconds):
        self.seconds = seconds

    def plan(self, state, step):
        time.sleep(self.seconds)
        return lambda _, at: np.array([float(step)])


def test_a_plan_drives_only_after_the_time_that_it_took():
    driven = drive(Counter(), SlowPlanner(0.05), 12, 0.02, 0.0)
    made_at = driven.controls[:, 0]
    np.testing.assert_array_equal(driven.states[1:, 0], np.cumsum(made_at))
    late = np.arange(12) - made_at
    assert (late[made_at > 0] >= 3).all()  # .05 s are more than two control steps
    assert made_at[-1] > 0
    assert driven.plans < 12


def test_a_fast_planner_plans_more_than_once_a_step():
    driven = drive(Counter(), SlowPlanner(0.0), 5, 0.02, 0.1)
    assert driven.plans > 10


@pytest.mark.parametrize("robot", ["cart_pole", "hopper"])
def test_the_peer_finds_each_reading_where_mujoco_has_it(robot):
    task = make_task(str(ROOT / "benchmarks" / "without_demonstration" / f"{robot}.yaml"))
    problem = shared_problem(task)
    model = compile_model(problem["mjcf"])
    data = mujoco.MjData(model)
    state = task.initial_state + 0.1 * np.arange(task.dims["n_x"])
    data.qpos[:], data.qvel[:] = np.split(state, [model.nq])
    mujoco.mj_forward(model, data)
    found = [
        data.sensordata[at] if kind == "sensor" else state[at] for kind, at in problem["readings"]
    ]
    np.testing.assert_allclose(found, task.cost.features(state), rtol=0, atol=1e-12)
