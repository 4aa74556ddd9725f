# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a motion costs and asks of a robot, on a block that slides as Coulomb says."""

from pathlib import Path

import numpy as np
import pytest

from tests.search.test_robustness import BLOCK, TASK
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.search.gait import gaits, measure_gait
from vgps_ros.tasks import make_task, registry

SHIPPED = Path(registry.__file__).parent / "quadruped" / "policy.json"

# Small steps, and a motor whose force may have a limit.
FINE = BLOCK.replace('timestep="0.01"', 'timestep="0.002" cone="elliptic"')
assert FINE != BLOCK


@pytest.fixture
def block(tmp_path):
    def made(limit='forcerange="-20 20"', option="<option "):
        text = FINE.replace('joint="x"/>', f'joint="x" {limit}/>').replace("<option ", option)
        (tmp_path / "block.xml").write_text(text)
        (tmp_path / "task.yaml").write_text(TASK)
        return make_task(str(tmp_path))

    return made


def slid(task, force, speed):
    """Returns a motion that begins with a speed, once the block has settled on the floor."""
    n = task.dynamics.state_dim
    settled = task.dynamics.rollout(task.initial_state, lambda *_: np.zeros(1), 200).states[-1]
    settled[n // 2 :] = [speed, 0.0]
    motion = task.dynamics.rollout(settled, lambda *_: np.array([force]), 100)
    return motion.states, motion.controls


def test_a_block_that_slides_evenly_costs_its_friction(block):
    task = block()
    states, controls = slid(task, 9.81, 0.5)
    speed = states[:-1, 2].mean()
    found = measure_gait(task, states, controls)
    assert found.power == pytest.approx(9.81 * speed, rel=1e-9)
    assert found.cost_of_transport == pytest.approx(0.5, rel=0.01)
    assert found.load == pytest.approx(9.81 / 20.0, rel=1e-9)
    assert found.slip == pytest.approx(speed, rel=0.05)


def test_what_rests_costs_nothing_and_has_no_cost_of_transport(block):
    task = block(limit="")
    found = measure_gait(task, *slid(task, 0.0, 0.0))
    assert found.power == pytest.approx(0.0, abs=1e-6)
    assert (found.cost_of_transport, found.load) == (None, None)
    assert found.slip == pytest.approx(0.0, abs=1e-3)
    assert found.impact == pytest.approx(1.0, rel=0.01)


def test_what_nothing_holds_has_neither_slip_nor_impact(block):
    task = block(option='<option gravity="0 0 0" ')
    states, controls = slid(task, 0.0, 0.5)
    states[:, 1] += 0.5  # above the floor
    found = measure_gait(task, states, controls)
    assert (found.slip, found.impact, found.cost_of_transport) == (None, None, None)


def test_the_quadruped_that_stands_gives_no_power_and_one_that_walks_does():
    task = make_task("quadruped")
    rest, *walks = gaits(task, driver_of(task.deployment, open_policy(SHIPPED)))
    assert rest["power"] < 1.0
    assert 0.99 < rest["impact"] < 1.05
    assert all(each["power"] > 10.0 and each["load"] < 1.0 for each in walks)
