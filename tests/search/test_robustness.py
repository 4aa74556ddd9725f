# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Survival under disturbances, on a block that a constant force draws over rough ground."""

import numpy as np
import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search.judgement import Trial
from vgps_ros.search.robustness import behaviours, replay_rollout, robustness
from vgps_ros.tasks import make_task
from vgps_ros.tasks.disturbance import Disturbance, DisturbanceSettings

# A block of 2 kg, which has fallen where it is faster than 1 m/s. Its friction bears 9.81 N.
BLOCK = """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="9 9 1" friction="0.5 0 0"/>
    <body name="block" pos="0 0 0.1">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="box" size="0.1 0.1 0.1" mass="2" friction="0.5 0 0" condim="3"/>
    </body>
  </worldbody>
  <actuator><motor name="x" joint="x"/></actuator>
</mujoco>
"""
TASK = """
model: block.xml
control_period: 0.01
horizon: 1.0
cost: [{sensor: x/velocity}]
"""
FALLEN = "fallen: [{sensor: x/velocity, beyond: 1.0}]\n"


@pytest.fixture
def block(tmp_path):
    (tmp_path / "block.xml").write_text(BLOCK)
    (tmp_path / "task.yaml").write_text(TASK + FALLEN)
    return make_task(str(tmp_path))


def drawn_by(task, force):
    """Returns a driver that draws with a constant force [N], whatever the state."""
    shape = Architecture(task.observation.names, (), 1)
    parameters = np.zeros(shape.num_parameters)
    parameters[-1] = force  # the bias
    return Driver(GaussianPolicy(shape, parameters, np.ones(1)), task.observation)


def trial(task, count, steps):
    starts, silent = np.tile(task.initial_state, (count, 1)), np.zeros((count, steps, 1))
    return Trial(starts, np.empty((count, steps, 0)), silent)


def tried(task, force, count=1, steps=200, seed=3, push_before=0.0, **values):
    """Tries disturbances on rollouts that a constant force draws [N]."""
    settings = DisturbanceSettings(body="block", push_before=push_before)
    driver, given = drawn_by(task, force), trial(task, count, steps)
    return robustness(task, driver, given, values, seed, settings)


def test_friction_is_borne_from_where_it_holds_the_force(block):
    """6 N pass what friction bears, 9.81 N times its factor, below 0.61; 1 m/s comes within 2 s."""
    assert tried(block, 6.0, count=2, frictions=[2.0, 0.3, 0.7, 0.5]) == {
        "frictions": {
            "values": [0.3, 0.5, 0.7, 2.0],
            "fallen": [[0, 1], [0, 1], [], []],
            "survival": [0.0, 0.0, 1.0, 1.0],
            "borne": [0.7, 2.0],
        }
    }


def test_a_payload_holds_the_block_by_its_weight(block):
    """12 N pass what friction bears of 2 kg, but not what it bears of 3 kg."""
    found = tried(block, 12.0, payloads=[0.0, 1.0])["payloads"]
    assert (found["survival"], found["borne"]) == ([0.0, 1.0], None)
    # It is not listed, but the block falls without a payload.
    assert tried(block, 12.0, payloads=[1.0])["payloads"]["borne"] is None


def test_each_rollout_has_its_own_start_noise_and_disturbance(block):
    """Only the one on ice that something moves falls, in whatever order they stand."""
    some = trial(block, 4, 200)
    some.noise[1:3] = 3.0
    some.starts[3, block.dynamics.model.nq] = 1.5  # faster than it may be, from the start
    ice, rough = Disturbance(friction=0.1), Disturbance(friction=1.0)

    def up(*disturbances):
        return behaviours(block, drawn_by(block, 0.0), disturbances, some).up[:, 0].tolist()

    assert up(ice, ice, rough, rough) == [True, False, True, False]
    assert up(ice, rough, ice, rough) == [True, True, False, False]


def test_pushes_of_all_sizes_come_at_the_same_times_which_the_seed_names(block):
    """Half of the times are after the rollout's end, which no size of a push makes a fall."""
    given = {"count": 30, "steps": 100, "push_before": 2.0, "pushes": [1.0, 50.0, 100.0]}
    found = tried(block, 0.0, **given)["pushes"]
    assert found["survival"][0] == 1.0  # 0.5 m/s at most
    assert 0.2 < found["survival"][1] == found["survival"][2] < 0.8
    assert found["borne"] == [0.0, 1.0]
    assert [len(each) for each in found["fallen"]] == [
        round(30 * (1.0 - share)) for share in found["survival"]
    ]
    assert tried(block, 0.0, **given)["pushes"] == found
    assert tried(block, 0.0, seed=5, **given)["pushes"]["survival"] != found["survival"]


@pytest.mark.parametrize(("kind", "value"), [("pushes", 50.0), ("frictions", 0.2)])
def test_a_replay_is_of_the_same_rollout(block, kind, value):
    settings = DisturbanceSettings(body="block", push_before=2.0)
    driver, given = drawn_by(block, 4.5), trial(block, 10, 100)
    (fallen,) = robustness(block, driver, given, {kind: [value]}, 3, settings)[kind]["fallen"]
    assert fallen
    for rollout in range(10):
        states = replay_rollout(block, driver, given, 3, settings, kind, value, rollout)
        assert block.fallen(states).any() == (rollout in fallen)


def test_a_range_ends_at_the_first_size_that_is_not_borne(block):
    """A slope of s draws the block down where tan s passes 0.5, on one side and on the other."""
    found = tried(block, 0.0, slopes=[-0.6, -0.4, 0.4, 0.6, 0.2])["slopes"]
    assert found["survival"] == [0.0, 1.0, 1.0, 1.0, 0.0]
    assert found["borne"] == [-0.4, 0.4]


def test_a_lighter_block_slides_where_its_weight_held_it(block):
    """6 N pass what friction bears of 1 kg, but not of 1.4 kg."""
    assert tried(block, 6.0, masses=[0.4, 0.5, 0.7, 2.0])["masses"] == {
        "values": [0.4, 0.5, 0.7, 2.0],
        "fallen": [[0], [0], [], []],
        "survival": [0.0, 0.0, 1.0, 1.0],
        "borne": [0.7, 2.0],
    }


def test_contacts_of_mujoco_replace_those_of_the_model(block, tmp_path):
    """A block on soft ground sinks below where it may be, but not on MuJoCo's."""
    (tmp_path / "block.xml").write_text(BLOCK.replace('condim="3"', 'condim="3" solref="0.2 1"'))
    (tmp_path / "task.yaml").write_text(TASK + "fallen: [{sensor: z/position, below: -0.003}]\n")
    soft = make_task(str(tmp_path))
    assert tried(soft, 0.0, contacts=[0, 1])["contacts"]["survival"] == [0.0, 1.0]


def test_a_step_stops_what_slides(block):
    """12 N draw the block to 1 m/s within .46 m, but the first step is .3 m ahead of its front."""
    values, driver, given = {"steps": [0.0, 0.05]}, drawn_by(block, 12.0), trial(block, 1, 200)
    settings = DisturbanceSettings(body="block")
    found = robustness(block, driver, given, values, 3, settings)
    assert found["steps"]["survival"] == [0.0, 1.0]


def test_another_engine_computes_the_same_friction(block):
    """As `test_friction_is_borne_from_where_it_holds_the_force`, by an elliptic cone."""
    for force, survives in ((6.0, 1.0), (12.0, 0.0)):
        assert tried(block, force, engines=[0, 1])["engines"]["survival"] == [survives] * 2


def test_a_task_that_does_not_know_a_fall_is_refused(block, tmp_path):
    (tmp_path / "task.yaml").write_text(TASK)
    with pytest.raises(InvalidInputError, match="does not say when the robot has fallen"):
        tried(make_task(str(tmp_path)), 0.0, steps=10, pushes=[1.0])
