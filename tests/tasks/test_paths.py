# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Tasks whose first solve begins with a path that nobody can follow."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from numpy.testing import assert_allclose, assert_array_equal

from tests.limited_pendulum import write_task
from tests.tasks.hopper_file import HOPPER, TASK
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Trajectory
from vgps_ros.messages.optimization import request_from_msg, request_to_msg
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.situations import Situation
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.tasks import make_task

SIDE = ", file: side.csv"  # a turn to one side


@pytest.fixture
def pendulum(tmp_path):
    """Returns a function that makes the pendulum's task with a beginning."""

    rows = "".join(f"{t},{1.5 * t}\n" for t in (0, 1))
    (tmp_path / "side.csv").write_text("time,hinge/position\n" + rows)

    def make(begin):
        return make_task(write_task(tmp_path, ("search:", f"begin: {{law: path{begin}}}\nsearch:")))

    return make


def request_of(task, **changes):
    given = {"guess": np.zeros((50, 1)), "guess_states": task.begin.states} | changes
    return OptimizationRequest(0, 0, 0, 1.0, 60, Situation.at_start(task), **given)


def test_a_path_has_the_velocities_of_its_positions(pendulum):
    path = pendulum(SIDE).begin.states
    assert_allclose(path[[0, 25, 50], 0], [0.0, 0.75, 1.5], atol=1e-12)
    assert_allclose(path[:, 1], 1.5, atol=1e-9)  # 1.5 rad in 1 s


def test_without_a_file_the_robot_stays(pendulum):
    task = pendulum("")
    assert_array_equal(task.begin.states, np.zeros((51, 2)))


def test_a_recorded_motion_of_another_robot_moves_the_joints_that_it_has(tmp_path):
    (tmp_path / "hopper.xml").write_text(HOPPER)
    (tmp_path / "other.csv").write_text("time,root_x/position,hip/position\n0,0,0.1\n10,5,0.9\n")
    begin = "begin: {law: path, file: other.csv}\n"
    without = "\n".join(line for line in TASK.splitlines() if not line.startswith("begin"))
    (tmp_path / "task.yaml").write_text(without + "\n" + begin)
    task = make_task(str(tmp_path))
    times = 0.01 * np.arange(461)
    assert_allclose(task.begin.states[:, 0], 0.5 * times)
    assert_allclose(task.begin.states[:, 3], 0.1 + 0.08 * times)
    assert_allclose(
        task.begin.states[:, [1, 2]], np.broadcast_to(task.initial_state[[1, 2]], (461, 2))
    )
    assert_allclose(task.begin.states[:, [4, 7]], np.broadcast_to([0.5, 0.08], (461, 2)))


@pytest.mark.parametrize(
    ("begin", "sentence"),
    [
        (", file: missing.csv", r"missing\.csv"),
        (", file: empty.csv", r"empty\.csv has none of the columns hinge/position"),
    ],
)
def test_a_path_that_the_model_lacks_is_refused(pendulum, tmp_path, begin, sentence):
    (tmp_path / "empty.csv").write_text("time,knee/position\n0,1\n")
    with pytest.raises(InvalidInputError, match=sentence):
        pendulum(begin)


def test_a_solve_closes_the_path_and_executes_what_it_returns(pendulum):
    task = pendulum(SIDE)
    assert np.abs(task.dynamics.gaps(Trajectory(task.begin.states, np.zeros((50, 1))))).max() > 0.01
    result = optimize(task, request_of(task))
    own = optimize(task, request_of(task, guess=None, guess_states=None))
    assert_array_equal(own.distribution.mean.states, result.distribution.mean.states)
    mean = result.distribution.mean
    replay = task.dynamics.rollout(mean.states[0], lambda t, _: mean.controls[t], task.horizon)
    assert_array_equal(replay.states, mean.states)
    executed = optimize(task, request_of(task, guess_states=None))
    assert_allclose(result.cost, executed.cost, rtol=1e-3)
    assert_array_equal(result.distribution.mean.states[0], task.initial_state)


def test_a_path_goes_through_a_message_bit_for_bit(pendulum):
    task = pendulum(SIDE)
    request = request_of(task)
    back = request_from_msg(request_to_msg(request, task, Time()), task)
    assert_array_equal(back.guess_states, request.guess_states)
    assert_array_equal(back.guess, request.guess)
    plain = request_of(task, guess_states=None)
    assert request_from_msg(request_to_msg(plain, task, Time()), task).guess_states is None


def test_states_of_a_wrong_size_or_without_controls_are_refused(pendulum):
    task = pendulum(SIDE)
    with pytest.raises(InvalidInputError, match=r"guess\.states has shape \(50, 2\)"):
        optimize(task, request_of(task, guess_states=task.begin.states[1:]))
    with pytest.raises(InvalidInputError, match=r"guess\.states without guess\.controls"):
        optimize(task, request_of(task, guess=None))
