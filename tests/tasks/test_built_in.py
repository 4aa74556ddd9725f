# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Every built-in task loads, and DDP lowers its cost by a share that was measured."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.tasks.solving import remaining_share, solved
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.search.settings import search_settings
from vgps_ros.tasks import BUILT_IN, make_task

# n_dx, n_u, DDP iterations, and the share of the first cost that may remain after them.
EXPECTED = {
    "arm": (14, 7, 12, 0.07),
    "cart_pole": (4, 1, 25, 0.8),
    "half_cheetah": (18, 6, 10, 0.40),
    "hopper": (12, 3, 15, 0.9),
    "quadruped": (36, 12, 15, 0.50),
    "rotor": (2, 1, 5, 0.35),
    "swimmer": (10, 2, 10, 0.55),
    "walker": (18, 6, 5, 0.40),
}


@pytest.fixture(params=EXPECTED)
def name(request):
    return request.param


def test_each_folder_is_a_built_in_task():
    assert set(BUILT_IN) == set(EXPECTED)


def test_a_task_has_its_size_and_settings(name):
    task, (n_dx, n_u, *_) = make_task(name), EXPECTED[name]
    assert task.name == name
    assert (task.dims["n_dx"], task.dims["n_u"]) == (n_dx, n_u)
    assert not task.fallen(task.initial_state)
    search_settings(task)


def test_its_model_is_built_of_primitives_in_one_file(name):
    spec = mujoco.MjSpec.from_string(make_task(name).mjcf)
    assert not spec.meshes
    assert not spec.hfields
    assert not spec.textures


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n == "hopper" else []) for n in EXPECTED]
)
def test_ddp_lowers_its_cost(name):
    *_, iterations, share = EXPECTED[name]
    assert remaining_share(solved(make_task(name), iterations)) < share


@pytest.mark.parametrize("mover", ["swimmer", "walker", "half_cheetah", "hopper", "quadruped"])
def test_what_a_policy_reads_does_not_tell_how_far_a_robot_has_gone(mover):
    task = make_task(mover)
    moved = task.initial_state.copy()
    moved[0] += 3.0
    assert_allclose(task.observation(moved), task.observation(task.initial_state), atol=1e-12)


def test_quadruped_touches_the_ground_with_its_feet_alone():
    model = make_task("quadruped").dynamics.model
    can_touch = {
        model.geom(i).name
        for i in range(model.ngeom)
        if model.geom_contype[i] or model.geom_conaffinity[i]
    }
    assert {name.rpartition("_")[2] for name in can_touch} == {"floor", "foot"}
    assert len(can_touch) == 5


def test_quadruped_weighs_about_as_much_as_a_go1():
    model = make_task("quadruped").dynamics.model
    assert model.body_subtreemass[0] == pytest.approx(12.7, abs=1.0)


def test_quadruped_stands_where_its_servos_hold_its_pose(rng):
    task = make_task("quadruped")
    held = task.begin(task, task.initial_state, 250, rng).trajectory
    assert not task.fallen(held.states).any()
    # Servos give way to its weight until they carry it.
    assert held.states[-1, 2] == pytest.approx(0.21, abs=0.03)
    assert np.abs(held.states[-1, -12:]).max() < 0.01


@pytest.mark.slow
def test_hopper_hops_ahead_in_its_first_motion(rng):
    task = make_task("hopper")
    hops = task.begin(task, task.initial_state, task.planned_horizon, rng).trajectory
    assert not task.fallen(hops.states).any()
    assert task.distance(hops.states[0], hops.states[-1]) > 1.0


def test_arm_learns_from_several_starts_that_differ():
    task = make_task("arm")
    assert search_settings(task).situations > 1
    assert (task.varied_state_std > task.initial_std).any()


def test_unknown_task_is_refused_with_all_names():
    with pytest.raises(InvalidInputError) as error:
        make_task("quadruple")
    assert all(name in str(error.value) for name in EXPECTED)
    assert str(error.value).endswith("Did you mean 'quadruped'?")


def test_task_files_name_units_where_they_are_not_plain(name):
    text = (Path("vgps_ros/tasks") / name / "task.yaml").read_text()
    assert "# [s]" in text
