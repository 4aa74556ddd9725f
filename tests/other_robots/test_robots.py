# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Robots of others, each by one YAML file: they load, and DDP lowers the cost by a known share.

Their packages are those of requirements/robots.txt; a test whose package is missing is skipped.
"""

import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from tests.simulation.urdf_kinematics import largest_difference
from tests.tasks.solving import remaining_share, solved
from vgps_ros.programs.__main__ import main
from vgps_ros.search.settings import search_settings
from vgps_ros.tasks import make_task

FOLDER = Path(__file__).parent
# n_dx, n_u, DDP iterations, and the share of the first cost that may remain after them.
EXPECTED = {
    "ant_controller": (28, 8, 10, 0.35),
    "dm_cartpole": (4, 1, 10, 1.0),
    "dm_cheetah": (18, 6, 10, 0.45),
    "dm_reacher": (4, 2, 15, 0.15),
    "go1": (36, 12, 15, 0.45),
    "gym_ant": (28, 8, 10, 0.15),
    "gym_half_cheetah": (18, 6, 10, 0.50),
    "gym_hopper": (12, 3, 10, 0.95),
    "gym_walker2d": (18, 6, 15, 0.99),
}


SLOW = ("dm_cartpole", "gym_hopper", "gym_walker2d")  # to sample a first motion, or to solve


@pytest.fixture(params=EXPECTED)
def name(request):
    return request.param


@pytest.fixture
def task(name):
    path = FOLDER / f"{name}.yaml"
    package = re.search(r"package://(\w+)/", path.read_text())[1]
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed: pip install --no-deps -r requirements/robots.txt")
    return make_task(str(path))


def test_each_file_is_tried():
    assert {path.stem for path in FOLDER.glob("*.yaml")} == set(EXPECTED)


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass':UserWarning")
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in EXPECTED]
)
def test_a_robot_loads_and_ddp_lowers_its_cost(name, task):
    n_dx, n_u, iterations, share = EXPECTED[name]
    assert (task.dims["n_dx"], task.dims["n_u"]) == (n_dx, n_u)
    assert not task.fallen(task.initial_state)
    search_settings(task)
    assert remaining_share(solved(task, iterations)) < share


def test_the_urdf_of_a_robot_has_mujocos_kinematics(task, rng):
    assert largest_difference(task.dynamics.model, rng) < 1e-12


@pytest.mark.slow
def test_the_first_file_of_a_humanoid_makes_it_step(tmp_path, monkeypatch):
    if find_spec("mjlab") is None:
        pytest.skip("mjlab is not installed: pip install --no-deps -r requirements/robots.txt")
    monkeypatch.chdir(tmp_path)
    model = "package://mjlab/asset_zoo/robots/unitree_g1/xmls/g1.xml"
    main(["new", "g1", "--model", model, "--lock", "*_wrist_*"])
    task = make_task("g1")
    assert (task.dims["n_dx"], task.dims["n_u"]) == (58, 23)
    found = solved(task, 12)
    assert remaining_share(found) < 0.45
    mean = found.distribution.mean
    feet = [i for i, name in enumerate(task.cost_names) if name.startswith("foot_")]
    heights = task.cost.features(mean.states[:-1], mean.controls)[:, feet]
    assert (np.ptp(heights, axis=0) > 0.03).all()
    assert not task.fallen(mean.states).any()


def test_meshes_stand_in_the_model_itself():
    path = FOLDER / "go1.yaml"
    if find_spec("mjlab") is None:
        pytest.skip("mjlab is not installed: pip install --no-deps -r requirements/robots.txt")
    mjcf = make_task(str(path)).mjcf
    assert "vertex=" in mjcf
    assert ".stl" not in mjcf
