# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A task file whose first motion is found by sampling."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import with_values
from vgps_ros.programs.__main__ import main
from vgps_ros.search.settings import SearchSettings
from vgps_ros.search.training import train
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks import make_task

PENDULUM = """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.05" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"LIMIT/></actuator>
</mujoco>
"""
LIMIT = ' ctrllimited="true" ctrlrange="-1.5 1.5"'  # 2.5 N·m would lift the arm without a swing
TASK = """
model: pendulum.xml
control_period: 0.02
horizon: 3.0
sensors: {tip: {type: framezaxis, xbody: arm}}
cost:
  - {sensor: tip, target: [0.0, 0.0, -1.0]}
  - {control: all, weight: 1.0e-3}
observe: [{joint: hinge, as: sin_cos}, joint_velocities]
begin: {law: sampling, BEGIN}
"""


@pytest.fixture
def task_of(tmp_path):
    """Returns a function that makes the task of a pendulum that is swung up."""

    def make(begin="plan: 1.5, period: 0.1", limit=LIMIT):
        (tmp_path / "pendulum.xml").write_text(PENDULUM.replace("LIMIT", limit))
        (tmp_path / "task.yaml").write_text(TASK.replace("BEGIN", begin))
        return make_task(str(tmp_path))

    return make


def unrefined(task):
    """Returns the task with first motions that DDP does not refine."""
    return replace(task, begin=replace(task.begin, ddp_iterations=0))


def motion_of(task, seed=0):
    rng = np.random.default_rng(seed)
    return task.begin(task, task.initial_state, task.planned_horizon, rng).trajectory


def test_a_pendulum_that_is_too_heavy_to_lift_is_swung_up(task_of):
    task = unrefined(task_of("plan: 1.5, period: 0.1, samples: 64"))
    motion = motion_of(task)
    assert np.abs(motion.controls).max() <= 1.5
    assert np.cos(motion.states[-1, 0]) < -0.9
    assert_array_equal(
        motion.states, task.dynamics.replay(motion.states[0], motion.controls[None])[0]
    )


def test_number_of_threads_changes_no_bit_of_the_motion(task_of, monkeypatch):
    found = []
    for threads in (1, 2, 5):
        monkeypatch.setattr("os.sched_getaffinity", lambda _, n=threads: range(n))
        task = task_of("plan: 0.4, period: 0.2")
        assert task.dynamics.simulations.threads == threads
        found.append(motion_of(task))
    for motion in found[1:]:
        assert_array_equal(motion.states, found[0].states)
        assert_array_equal(motion.controls, found[0].controls)


def test_seeds_give_different_motions_and_the_same_one_again(task_of):
    task = unrefined(task_of("plan: 0.4, period: 0.2"))
    assert_array_equal(motion_of(task).controls, motion_of(task).controls)
    assert (motion_of(task).controls != motion_of(task, seed=1).controls).any()


def test_iterations_of_ddp_lower_the_cost_of_the_motion(task_of):
    task = task_of("plan: 1.0, period: 0.1, std: 3", "")
    plain, refined = (task.trajectory_cost(motion_of(each)) for each in (unrefined(task), task))
    assert refined < plain


def test_a_standard_deviation_stands_for_a_range_that_is_not_there(task_of):
    task = task_of("plan: 0.4, period: 0.2, std: 0.5", limit="")
    assert np.isfinite(motion_of(task).states).all()


def test_such_a_task_trains(task_of, tmp_path):
    task = task_of("plan: 0.6, period: 0.2")
    chosen = {"iterations": 2, "initial_ddp_iterations": 5, "ddp_iterations": 1}
    settings = with_values(SearchSettings(), {**chosen, "situations": 2})
    content = train("vgps", task, settings, 0, RunFolder(tmp_path / "run"))
    assert len(content["iterations"]) == 2


def test_it_is_checked_and_shown(task_of, tmp_path, capsys):
    task_of("plan: 0.6, period: 0.2")
    main(["check", str(tmp_path), "--iterations", "3"])
    assert "first rollout" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("begin", "limit", "sentence"),
    [
        ("plan: 0.01", LIMIT, r"begin\.plan: it is 0.01 s, .*control_period, 0.02 s"),
        ("period: 0.01", LIMIT, r"begin\.period: it is 0.01 s, .*control_period, 0.02 s"),
        ("plan: 0.5, period: 0.6", LIMIT, r"begin\.period: it is 0.6 s, but a plan of 0.5 s"),
        ("noise: 0.2", "", r"begin: a control of the model has no range; give `std`"),
        ("std: [1, 2]", LIMIT, r"begin\.std: it has 2 values, but the model has 1 actuators"),
        ("std: 1, noise: 0.2", LIMIT, r"begin\.noise: .*leave one of them out"),
        ("method: best", LIMIT, r"begin\.method: 'method' is no key here"),
        ("samples: 1", LIMIT, r"begin\.samples"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(task_of, begin, limit, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        task_of(begin, limit)


def test_a_replay_that_diverges_disturbs_no_other(task_of, rng):
    model = task_of().dynamics.model
    controls = rng.uniform(-1, 1, (6, 20, 1))
    controls[2, 7] = np.inf
    found = [
        Dynamics(model, threads=threads).replay(np.array([0.1, 0.0]), controls)
        for threads in (1, 2, 5)
    ]
    for states in found:
        assert_array_equal(states, found[0])
    assert np.isnan(found[0][2, 8:]).all()
    assert np.isfinite(np.delete(found[0], 2, axis=0)).all()
