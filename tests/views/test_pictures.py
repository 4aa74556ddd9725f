"""Plots and the Rerun scene show the figures that they are given."""

import subprocess
import sys
from collections import Counter
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from rerun.chunk import RrdReader

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.views.plots import learning_curve, motion, plot_learning_curve
from vgps_ros.views.robot_scene import RobotScene
from vgps_ros.views.robot_shape import RobotShape


@pytest.fixture
def result():
    costs = [None, 300.0, 180.0]
    entries = [
        {
            "k": k,
            "alpha": 1.0 / k,
            "ddp_cost": 160.0 + k,
            "deterministic_cost": 170.0 + k,
            "stochastic_cost_mean": cost,
        }
        for k, cost in enumerate(costs, start=1)
    ]
    return {
        "task": "swimmer",
        "seed": 3,
        "hidden_units": [5],
        "initial_ddp_cost": 158.0,
        "iterations": entries,
    }


@pytest.fixture
def states(rng):
    return rng.normal(scale=0.4, size=(20, 10))


def test_learning_curve_has_solid_stochastic_dashed_deterministic_and_the_ddp_line(result):
    costs, alphas = learning_curve(result).axes
    lines = {line.get_label(): line for line in costs.lines}
    assert lines["stochastic policy"].get_linestyle() == "-"
    assert lines["deterministic policy"].get_linestyle() == "--"
    stochastic = lines["stochastic policy"].get_ydata()
    assert np.isnan(stochastic[0])  # it diverged
    assert list(stochastic[1:]) == [300.0, 180.0]
    assert list(lines["deterministic policy"].get_ydata()) == [171.0, 172.0, 173.0]
    assert set(lines["initial DDP solution"].get_ydata()) == {158.0}
    assert list(alphas.lines[0].get_ydata()) == [1.0, 0.5, 1 / 3]
    assert costs.get_ylabel()
    assert alphas.get_xlabel()


def test_learning_curve_is_written_as_a_picture(result, tmp_path):
    plot_learning_curve(result, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")


def test_motion_shows_the_path_of_the_centre_of_mass_beside_the_initial_one(swimmer, states):
    axes = motion(swimmer, states, states + 0.1).axes[0]
    lines = {line.get_label(): line for line in axes.lines}
    shape = RobotShape(swimmer.dynamics.model)
    assert_allclose(lines["learned policy"].get_xydata(), shape.path(states)[:, :2])
    assert_allclose(lines["initial DDP solution"].get_xydata(), shape.path(states + 0.1)[:, :2])


def test_shape_agrees_with_the_link_geometry_worked_out_by_hand(swimmer, states):
    shape = RobotShape(swimmer.dynamics.model)
    for x, y, yaw, front, back in states[:, :5]:
        unit = lambda angle: np.array([np.cos(angle), np.sin(angle)])  # noqa: E731
        middle = np.array([x, y])
        nose, tail = middle + unit(yaw) / 2, middle - unit(yaw) / 2
        expected = {
            "middle": (tail, nose),
            "front": (nose, nose + unit(yaw + front)),
            "back": (tail, tail - unit(yaw + back)),
        }
        state = np.array([x, y, yaw, front, back, 0, 0, 0, 0, 0])
        for capsule, ends in zip(shape.capsules, shape.axes(state), strict=True):
            found = sorted(map(tuple, ends[:, :2].round(9)))
            assert_allclose(found, sorted(map(tuple, np.round(expected[capsule.name], 9))))
        centres = [np.mean(pair, axis=0) for pair in expected.values()]
        assert_allclose(shape.centre_of_mass(state)[:2], np.mean(centres, axis=0), atol=1e-12)


def test_scene_holds_a_row_for_each_message_and_passes_rerun_s_own_check(swimmer, states, tmp_path):
    path = tmp_path / "run.rrd"
    scene = RobotScene(swimmer, path)
    for t, state in enumerate(states):
        scene.log_state(t * 20_000_000, state)
        scene.log_command(t * 20_000_000, np.array([1.0, -1.0]))
    scene.restart_path()
    scene.log_state(0, states[0])
    scene.log_progress(1, {"alpha": 0.9, "stochastic_cost": float("inf")})
    scene.log_initial_solution(0, states)
    scene.close()
    rows: Counter[str] = Counter()
    for chunk in RrdReader(path).stream():
        if not chunk.is_static:
            rows[str(chunk.entity_path)] += chunk.num_rows
    assert rows["/joint_states/position"] == rows["/joint_states/velocity"] == 21
    assert rows["/joint_command/effort"] == 20
    assert rows["/world/robot/front"] == 21
    assert rows["/world/centre_of_mass"] == 19  # no jump back at the reset
    assert rows["/learning/alpha"] == 1
    assert "/learning/stochastic_cost" not in rows  # it diverged
    rerun = Path(sys.executable).with_name("rerun")
    subprocess.run([rerun, "rrd", "verify", path], check=True, capture_output=True)


def test_scene_refuses_a_file_that_exists(swimmer, tmp_path):
    (tmp_path / "run.rrd").write_text("mine")
    with pytest.raises(InvalidInputError, match="exists already; name another file"):
        RobotScene(swimmer, tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").read_text() == "mine"


def test_a_capsule_of_rerun_lies_where_mujoco_has_it(swimmer):
    """Rerun's capsule runs from its origin along +z; the scene shifts it by half its length."""
    shape = RobotShape(swimmer.dynamics.model)
    model, data = swimmer.dynamics.model, mujoco.MjData(swimmer.dynamics.model)
    state = np.array([1.0, 2.0, 0.5, 0.3, -0.2, 0, 0, 0, 0, 0])
    data.qpos[:] = state[:5]
    mujoco.mj_kinematics(model, data)
    centres, rotations = shape.poses(state)
    for i, capsule in enumerate(shape.capsules):
        shifted = centres[i] + rotations[i] @ [0, 0, -capsule.half_length]
        end = shifted + rotations[i] @ [0, 0, 2 * capsule.half_length]
        assert_allclose((shifted + end) / 2, data.geom(capsule.name).xpos, atol=1e-12)
