# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Plots and rendered pictures show the figures that they are given."""

import itertools
import os
import re
import subprocess
import sys
from ctypes.util import find_library

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from vgps_ros import DRAWS_BY
from vgps_ros.robot.signals import Command
from vgps_ros.search.commanded_motion import CommandedMotion, planar_path
from vgps_ros.search.run_record import RunRecord
from vgps_ros.views.filmstrip import RenderingError, filmstrip, frames, write_moving_picture
from vgps_ros.views.learning_curve import learning_curve
from vgps_ros.views.plots import driving, motion, save, trajectory
from vgps_ros.views.robot_shape import RobotShape


@pytest.fixture
def result():
    costs = [None, 300.0, 180.0]
    entries = [
        {
            "k": k,
            "alpha": 1.0 / k,
            "bound": -400.0,
            "ddp_cost": 160.0 + k,
            "deterministic_cost": 170.0 + k,
            "stochastic_cost_mean": cost,
            "stochastic_cost_median": cost,
        }
        for k, cost in enumerate(costs, start=1)
    ]
    return {
        "task": "swimmer",
        "method": "vgps",
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
    ratio = np.array([300.0, 180.0, 171.0, 172.0, 173.0, 400.0, 800.0, 1200.0]) / 158.0
    assert_allclose(stochastic[1:], ratio[:2])
    assert_allclose(lines["deterministic policy"].get_ydata(), ratio[2:5])
    assert_allclose(lines["bound −L(q, θ) ÷ α"].get_ydata(), ratio[5:])
    assert set(lines["initial DDP solution"].get_ydata()) == {1.0}
    assert list(alphas.lines[0].get_ydata()) == [1.0, 0.5, 1 / 3]
    assert costs.get_ylabel()
    assert alphas.get_xlabel()


def test_the_inset_of_a_learning_curve_shows_the_end_of_a_long_run(result):
    entry = result["iterations"][-1]
    result["iterations"] = [
        entry | {"k": k, "stochastic_cost_mean": 160.0 + 3000.0 * 0.5**k} for k in range(1, 31)
    ]
    costs = learning_curve(result).axes[0]
    [inset] = costs.child_axes
    low, high = inset.get_ylim()
    shown = [line.get_ydata() for line in inset.lines if "bound" not in line.get_label()]
    assert low < 1.0 <= max(np.max(values) for values in shown) < high < 1.2
    assert_allclose(inset.lines[0].get_ydata(), costs.lines[0].get_ydata()[-15:])
    assert inset.get_yscale() == "linear"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("cost", [0.0, 1e-3, 1e7])
def test_a_learning_curve_has_few_ticks_whatever_its_costs(result, cost, tmp_path):
    for entry in result["iterations"]:
        entry |= {"stochastic_cost_mean": cost, "ddp_cost": cost, "deterministic_cost": cost}
        del entry["bound"]
    result["initial_ddp_cost"] = cost and 158.0
    figure = learning_curve(result)
    save(figure, tmp_path / "curve.png")
    low, high = figure.axes[0].get_ylim()
    assert 1 <= sum(low <= tick <= high for tick in figure.axes[0].get_yticks()) <= 9


@pytest.mark.parametrize("value", [0.0, -1.0, 1e-300, 1e300, np.nan, np.inf, None])
def test_no_figure_of_a_result_keeps_its_curve_from_being_drawn(result, value, tmp_path):
    for entry in result["iterations"]:
        entry |= {"stochastic_cost_mean": value, "bound": value, "alpha": value or 0.0}
    result |= {"initial_ddp_cost": value, "task": "$\\frac{" + "a" * 10_000}
    save(learning_curve(result), tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 1000


def test_learning_curve_of_a_result_without_bounds_has_no_bound(result):
    for entry in result["iterations"]:
        del entry["bound"]
    labels = [line.get_label() for line in learning_curve(result).axes[0].lines]
    assert "stochastic policy" in labels
    assert not any("bound" in label for label in labels)


@pytest.fixture
def run(swimmer, states):
    """A run with a motion, and a q whose deviation grows with time."""
    deviations = np.linspace(0.0, 0.5, len(states))
    return RunRecord(
        mjcf=swimmer.mjcf,
        time_step=0.02,
        initial_states=states + 0.1,
        mean_states=states,
        state_covariances=deviations[:, None, None] ** 2 * np.eye(10),
        executed_states=states + 0.2,
    )


def test_motion_shows_the_path_of_the_centre_of_mass_beside_the_initial_one(swimmer, run):
    axes = motion(run).axes[0]
    lines = {line.get_label(): line for line in axes.lines}
    shape = RobotShape(swimmer.dynamics.model)
    for label, states in (
        ("learned policy", run.executed_states),
        ("initial DDP solution", run.initial_states),
    ):
        assert_allclose(lines[label].get_xydata(), shape.path(states)[:, :2])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")


@pytest.mark.parametrize(
    ("joints", "plane"),
    [
        ('<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>', (0, 2)),
        ('<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>', (0, 1)),
        ('<joint type="slide" axis="1 0 0"/><joint axis="0 1 0"/>', (0, 2)),  # a cart-pole
        ('<joint axis="0 0 1"/><joint axis="0 0 1" pos="1 0 0"/>', (0, 1)),
        ('<joint axis="0 0 1"/><joint axis="0 1 0"/>', (0, 2)),  # an arm
        ("<freejoint/>", (0, 2)),
    ],
)
def test_a_robot_is_seen_so_that_its_motion_shows(joints, plane):
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body>{joints}"
        '<geom type="capsule" size=".1 .2"/></body></worldbody></mujoco>'
    )
    assert RobotShape(model).plane == plane


def test_tubes_are_two_standard_deviations_around_the_mean_with_the_executed_angle(run):
    figure = trajectory(run)
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "root_yaw\n[rad]", "front_joint\n[rad]", "back_joint\n[rad]",
    ]  # fmt: skip
    assert figure.axes[-1].get_xlabel() == "time [s]"
    time = 0.02 * np.arange(len(run.mean_states))
    deviation = np.linspace(0.0, 0.5, len(time))
    for axes, i in zip(figure.axes, (2, 3, 4), strict=True):
        [band] = axes.collections
        edges = band.get_paths()[0].vertices
        for x, mean, sd in zip(time, run.mean_states[:, i], deviation, strict=True):
            found = edges[np.isclose(edges[:, 0], x), 1]
            assert_allclose([found.min(), found.max()], [mean - 2 * sd, mean + 2 * sd])
        lines = {line.get_label(): line for line in axes.lines}
        assert_allclose(lines["executed policy"].get_ydata(), run.executed_states[:, i])


def test_what_is_not_known_is_not_drawn(run):
    nothing = RunRecord(run.mjcf, 0.02)
    assert all(draw(nothing) is None for draw in (trajectory, motion, filmstrip))


needs_egl = pytest.mark.skipif(
    find_library("EGL") is None, reason="libEGL is not installed: nothing can be rendered"
)


@needs_egl
def test_a_filmstrip_shows_the_robot_as_it_moves(run):
    figure = filmstrip(run)
    pictures = [axes.images[0].get_array() for axes in figure.axes]
    assert len(pictures) == 5
    assert [axes.get_title() for axes in figure.axes][-1] == "0.4 s"
    for frame, after in itertools.pairwise(pictures):
        assert frame.std() > 5.0  # something is there
        assert np.any(frame != after)


@needs_egl
def test_a_robot_whose_model_has_no_light_is_seen(swimmer):
    dark = re.sub("<light[^>]*/>", "", swimmer.mjcf)
    assert "<light" not in dark
    picture = next(frames(dark, swimmer.initial_state[None], 60, 80))
    assert picture.mean() > 100.0  # of 255


@needs_egl
def test_a_moving_picture_has_a_frame_for_each_25th_of_a_second(run, tmp_path):
    assert write_moving_picture(run, tmp_path / "motion.gif")
    with Image.open(tmp_path / "motion.gif") as picture:
        assert picture.n_frames == 10  # 19 steps of 0.02 s, every second one
        assert picture.info["duration"] == 40


@needs_egl
def test_a_robot_whose_shapes_are_missing_is_drawn_by_its_masses():
    """As one whose meshes were left out: in the middle of the picture there is something red.

    A link that is only a frame, of no weight and wide moments of inertia, does not hide it.
    """
    body = '<body pos="0 0 1"><freejoint/>{}</body>'
    inertial = '<inertial pos="0 0 0" mass="{0}" diaginertia="{1} {1} {1}"/>'
    bare = inertial.format(1, 0.02) + f"<body>{inertial.format(1e-6, 1e-5)}</body>"
    state = np.eye(1, 13, 3)
    shown = (
        next(frames(f"<mujoco><worldbody>{body.format(of)}</worldbody></mujoco>", state, 60, 80))
        for of in (bare, '<geom type="box" size=".2 .2 .2"/>')
    )
    shown = list(shown)
    (red, green, _), (grey, other, _) = (picture[25:35, 35:45].mean((0, 1)) for picture in shown)
    assert red > green + 50
    red, green, _ = shown[0][:5, :5].mean((0, 1))
    assert red < green + 20
    assert abs(grey - other) < 20


def test_without_a_way_to_draw_a_sentence_says_what_to_install(run):
    program = (
        "import sys; sys.modules['mujoco.egl'] = None\n"
        "from vgps_ros.views.filmstrip import frames\n"
        "next(frames(sys.stdin.read(), None, 10, 10))"
    )
    environment = {name: text for name, text in os.environ.items() if name != "MUJOCO_GL"}
    failed = subprocess.run(
        [sys.executable, "-c", program],
        input=run.mjcf, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "RenderingError: MuJoCo cannot draw here with MUJOCO_GL=egl; install libegl1" in (
        failed.stderr
    )


@pytest.mark.parametrize("library", ["foo", "osmesa", "glfw"])
def test_what_draws_nothing_does_not_care_for_what_draws(library):
    """MuJoCo itself fails at its import where the variable names what is not there."""
    environment = {**os.environ, "MUJOCO_GL": library}
    environment.pop(DRAWS_BY, None)
    command = [sys.executable, "-m", "vgps_ros.programs", "check", "cart_pole", "--iterations", "1"]
    subprocess.run(command, env=environment, capture_output=True, check=True, timeout=300)


def test_an_unknown_library_is_refused_with_those_that_are_known(run, monkeypatch):
    monkeypatch.setenv(DRAWS_BY, "foo")
    with pytest.raises(RenderingError, match="MUJOCO_GL is 'foo', but must be one of egl, osmesa"):
        next(frames(run.mjcf, run.executed_states, 10, 10))


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
        for name, ends in zip(shape.names, shape.axes(state), strict=True):
            found = sorted(map(tuple, ends[:, :2].round(9)))
            assert_allclose(found, sorted(map(tuple, np.round(expected[name], 9))))
        centres = [np.mean(pair, axis=0) for pair in expected.values()]
        assert_allclose(shape.centre_of_mass(state)[:2], np.mean(centres, axis=0), atol=1e-12)


def test_a_robot_without_capsules_is_drawn_too():
    mjcf = """<mujoco><worldbody><body><freejoint/><geom type="box" size=".1 .2 .1"/></body>
        </worldbody></mujoco>"""
    (picture,) = frames(mjcf, np.array([[0.0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]]), 60, 80)
    assert picture.shape == (60, 80, 3)
    assert picture.std() > 1


@pytest.mark.parametrize("has_path", [True, False])
def test_what_was_driven_stands_beside_what_was_asked(has_path):
    speed, angle = Command("forward", 0.0, 1.0, unit="m/s"), Command("aim", -1.0, 1.0, unit="rad")
    asked = np.column_stack([np.full(100, 0.5), np.repeat([0.0, 0.4], 50)])
    done = asked + np.array([0.1, 0.0])
    done[60:] -= [0.0, 0.2]
    there = np.column_stack([np.linspace(0.0, 1.0, 101), np.zeros(101), np.zeros(101)])
    paths = (there, 1.3 * there) if has_path else (None, None)
    counts = np.arange(100) % 50 >= 10
    driven = CommandedMotion(0.02, 0.0, (speed, angle), asked, done, counts, *paths)
    assert driven.errors == {"forward": pytest.approx(0.1), "aim": pytest.approx(0.2 * 0.5**0.5)}
    *above, first, second = driving(driven).axes
    assert first.get_title(loc="right") == "rms error 0.100 m/s"
    assert second.get_title(loc="right") == "rms error 0.141 rad"
    for axes, i in ((first, 0), (second, 1)):
        told, did = axes.lines
        assert_allclose(told.get_ydata(), asked[:, i])
        assert_allclose(did.get_ydata()[0], done[0, i])  # a mean over 15 steps
        assert_allclose(did.get_xdata()[0], 0.14)
    if has_path:
        assert_allclose(above[0].lines[1].get_xdata(), 1.3 * there[:, 0])
        assert "the end is off by 0.30 m" in above[0].get_title(loc="left")
    else:
        assert not above
        assert driven.drift is None


def test_the_yaw_of_a_path_goes_on_past_half_a_turn():
    yaw = np.linspace(0.0, 7.0, 50)
    states = np.zeros((50, 13))
    states[:, 0], states[:, 3], states[:, 6] = yaw, np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    assert_allclose(planar_path(states), np.column_stack([yaw, np.zeros(50), yaw]), atol=1e-12)
