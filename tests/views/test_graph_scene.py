# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The scene: geometry and contacts of any robot, and messages in whatever order they come."""

import dataclasses
import datetime
import io

import mujoco
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from PIL import Image
from rerun.chunk import RrdReader
from std_msgs.msg import Header, String
from vgps_msgs.msg import LearningProgress

from tests.servo_arm import LEG
from tests.simulation.robots import EVERYTHING, everything, random_states
from vgps_ros.core.ddp.solve import Status
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.conversions import (
    command_to_msg,
    distribution_to_msg,
    gains_to_msg,
    plan_to_msg,
    signals_to_msg,
    stamp_of,
    state_to_msg,
)
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.search.mpc import Plan
from vgps_ros.simulation.controls import closed_loops, controls_of
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import compile_model
from vgps_ros.tasks import make_task
from vgps_ros.views.graph_scene import GraphScene

BOX = """
<mujoco>
  <option timestep="0.001"/>
  <asset><mesh name="tetra" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <geom name="wall" type="plane" size="0 0 1" pos="0 9 0" euler="90 0 0"/>
    <body pos="0 0 0.1">
      <joint name="height" type="slide" axis="0 0 1"/>
      <geom name="box" type="box" size=".1 .1 .1" mass="2"/>
      <geom name="ball" type="sphere" size=".02" pos="0 0 .1" mass="0"/>
      <geom name="rod" type="cylinder" size=".02 .05" pos="0 0 .1" mass="0"/>
      <geom name="egg" type="ellipsoid" size=".02 .03 .05" pos="0 0 .1" mass="0"/>
      <geom name="limb" type="capsule" size=".02 .05" pos="0 0 .1" mass="0"/>
      <geom name="rock" type="mesh" mesh="tetra" pos="0 0 .1" mass="0"/>
    </body>
  </worldbody>
  <actuator><motor name="height" joint="height"/></actuator>
</mujoco>
"""


class Recorded:
    """A scene, what it reported, and what it wrote."""

    def __init__(self, path):
        self.path = path
        self.reports: list[tuple[str, str | None]] = []
        self.scene = GraphScene(path, lambda topic, text: self.reports.append((topic, text)))

    def close(self) -> dict[str, list]:
        """Returns the chunks of each entity."""
        self.scene.close()
        chunks: dict[str, list] = {}
        for chunk in RrdReader(self.path).stream():
            chunks.setdefault(str(chunk.entity_path), []).append(chunk)
        return chunks


@pytest.fixture
def recorded(tmp_path) -> Recorded:
    return Recorded(tmp_path / "scene.rrd")


def column(chunks, component: str):
    """All rows of a component, as Python values."""
    rows = []
    for chunk in chunks:
        table = chunk.to_record_batch()
        names = [name for name in table.schema.names if name.endswith(component)]
        for name in names:
            rows += table.column(name).to_pylist()
    return [row for row in rows if row is not None]


def views(path):
    """Returns the names of the views in the layout with which a recording ends."""
    reader = RrdReader(path)
    # The first layout, which holds where the recorder is killed, has all views.
    layouts = [list(reader.stream(store=store)) for store in reader.blueprints()]
    names = [column([c for c in layout if "/view/" in str(c.entity_path)], "display_name")
             for layout in layouts]  # fmt: skip
    return [name for [name] in min(names, key=len)]


def test_every_kind_of_geometry_is_drawn_and_moves(recorded):
    recorded.scene.show("/mjcf_description", String(data=BOX))
    for i in range(3):
        state = np.array([0.1 * i, 0.0])
        recorded.scene.show("/joint_states", state_to_msg(state, ["height"], stamp_of(i)))
    chunks = recorded.close()
    assert "/world/robot/floor" not in chunks  # lines stand for it
    for name in ("wall", "box", "ball", "rod", "egg", "limb", "rock"):
        shown = chunks[f"/world/robot/{name}"]
        assert sum(c.num_rows for c in shown if not c.is_static) == 3
        assert any(c.is_static for c in shown)
    moved = [row[0][2] for row in column(chunks["/world/robot/box"], "translation")]
    np.testing.assert_allclose(moved, [0.1, 0.2, 0.3], rtol=1e-6)


def test_contact_forces_carry_the_weight_of_what_rests_on_the_floor(recorded):
    model = mujoco.MjModel.from_xml_string(BOX)
    data = mujoco.MjData(model)
    for _ in range(3000):
        mujoco.mj_step(model, data)
    recorded.scene.show("mjcf_description", String(data=BOX))
    state = np.concatenate([data.qpos, data.qvel])
    resting = state_to_msg(state, ["height"], Time(sec=1), np.zeros(1))
    recorded.scene.show("joint_states", resting)
    in_the_air = state_to_msg(state + np.array([0.5, 0.0]), ["height"], Time(sec=2), np.zeros(1))
    recorded.scene.show("joint_states", in_the_air)
    pressed = state_to_msg(state, ["height"], Time(sec=3), np.array([-5.0]))
    recorded.scene.show("joint_states", pressed)
    forces = [
        1000.0 * np.sum(np.reshape(row, (-1, 3)), axis=0)
        for row in column(recorded.close()["/world/contact_forces"], "vectors")
    ]
    # In the resting state the solver's force depends on the state alone, so the push changes it
    # only through the acceleration that it would cause.
    np.testing.assert_allclose(forces[0], [0.0, 0.0, 2.0 * 9.81], rtol=0.02, atol=0.05)
    np.testing.assert_array_equal(forces[1], np.zeros(3))
    assert forces[2][2] > forces[0][2]


def test_what_comes_before_the_robots_description_waits_for_it(recorded):
    swimmer = make_task("swimmer")
    state = state_to_msg(np.zeros(10), swimmer.joint_names, Time())
    recorded.scene.show("/joint_states", state)
    wrong = dataclasses.replace(swimmer.controls, names=("wrong", "names"))
    recorded.scene.show("/joint_command", command_to_msg(np.ones(2), wrong, Time()))
    assert recorded.reports == []
    recorded.scene.show("/mjcf_description", String(data=swimmer.mjcf))
    assert [topic for topic, text in recorded.reports if text] == ["joint_command"]
    chunks = recorded.close()
    assert sum(c.num_rows for c in chunks["/joint_states/position"] if not c.is_static) == 1
    assert "/world/contact_forces" not in chunks  # the swimmer touches nothing


def test_a_free_base_is_drawn_at_its_pose_once_both_of_its_messages_are_there(recorded):
    model = everything()
    states = StateMessages(state_layout(model))
    recorded.scene.show("mjcf_description", String(data=EVERYTHING))
    drawn = random_states(model, np.random.default_rng(0), 3)
    for i, state in enumerate(drawn):
        efforts = np.arange(2.0)
        for topic, message in reversed(states.split(state, stamp_of(i), efforts).items()):
            recorded.scene.show(f"/robot/{topic}", message)
    recorded.scene.show("odom", states.split(drawn[0], stamp_of(7))["odom"])  # of half a state
    assert [(topic, text) for topic, text in recorded.reports if text] == []
    chunks = recorded.close()
    data = mujoco.MjData(model)
    poses = zip(
        drawn,
        column(chunks["/world/odom"], "translation"),
        column(chunks["/world/odom"], "quaternion"),
        column(chunks["/odom/position"], "scalars"),
        column(chunks["/world/robot/trunk"], "translation"),
        column(chunks["/joint_states/position"], "scalars"),
        strict=True,
    )
    for state, at, turned, plotted, trunk, joints in poses:
        data.qpos[:] = state[: model.nq]
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(at[0], state[:3], rtol=1e-6)
        np.testing.assert_allclose(turned[0], np.roll(state[3:7], -1), rtol=1e-6)
        np.testing.assert_allclose(plotted, state[:3])
        np.testing.assert_allclose(trunk[0], data.geom("trunk").xpos, rtol=1e-6)
        np.testing.assert_allclose(joints, state[7:9])


def test_what_a_policy_is_told_is_plotted_over_the_robots_time(recorded, swimmer):
    recorded.scene.show("mjcf_description", String(data=swimmer.mjcf))
    values = [np.array([0.5, 0.0, 1.0]), np.array([0.2, 1.0, 0.0])]
    names = ["command/forward", "clock/sin", "clock/cos"]
    for i, each in enumerate(values):
        recorded.scene.show("/robot/context", signals_to_msg(each, names, stamp_of(i)))
    assert [text for _, text in recorded.reports if text] == []
    chunks = recorded.close()
    # Apart, since a clock's swing would hide how the commands change.
    for entity, columns in (("/context/command", [0]), ("/context/clock", [1, 2])):
        plotted = column(chunks[entity], "scalars")
        np.testing.assert_array_equal(plotted, np.array(values)[:, columns])


def test_a_distribution_of_another_robot_is_left_out(recorded, swimmer, random_distribution):
    recorded.scene.show("mjcf_description", String(data=swimmer.mjcf))
    for wrong in ({"n_x": 9}, {"n_u": 3}):
        q = random_distribution(**{"n_x": 10, **wrong})
        message = distribution_to_msg(q, swimmer.deployment, 0, 0, Time())
        recorded.scene.show("trajectory_distribution", message)
    assert [bool(text) for _, text in recorded.reports] == [False, True, True]
    recorded.close()


def test_a_plan_is_drawn_where_it_leads_and_one_of_another_robot_is_left_out(recorded, swimmer):
    recorded.scene.show("mjcf_description", String(data=swimmer.mjcf))
    motion = swimmer.dynamics.rollout(swimmer.initial_state, lambda *_: np.ones(2), 5)
    plan = Plan(0, motion, np.zeros((5, 2, 10)), 2.5, Status.CONVERGED)
    recorded.scene.show("/plan", plan_to_msg(plan, swimmer, 0.01, Time(sec=1)))
    wrong = plan_to_msg(plan, swimmer, 0.01, Time(sec=2))
    wrong.trajectory.n_x = 9
    recorded.scene.show("/plan", wrong)
    assert [bool(text) for _, text in recorded.reports] == [False, False, True]
    chunks = recorded.close()
    ((strip,),) = column(chunks["/world/plan"], "strips")
    assert np.shape(strip) == (6, 3)
    assert column(chunks["/plan/cost"], "scalars") == [[2.5]]
    found = views(recorded.path)
    assert any("plans" in name for name in found)
    assert "learning curve" not in found


@pytest.mark.parametrize(
    ("mjcf", "sentence"),
    [
        ("<mujoco>", "does not compile"),
        ("<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>", "has no joint"),
        (
            "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>",
            "joints have no name",
        ),
    ],
)
def test_a_robot_that_cannot_be_drawn_is_reported(recorded, mjcf, sentence):
    recorded.scene.show("mjcf_description", String(data=mjcf))
    [(topic, text)] = recorded.reports
    assert topic == "mjcf_description"
    assert sentence in text
    recorded.close()


def test_an_existing_file_is_refused(tmp_path):
    (tmp_path / "scene.rrd").write_text("mine")
    with pytest.raises(InvalidInputError, match="exists already"):
        Recorded(tmp_path / "scene.rrd")
    assert (tmp_path / "scene.rrd").read_text() == "mine"


def progress(k, iterations):
    return LearningProgress(
        header=Header(stamp=stamp_of(k)), task="box", method="vgps", iteration=k,
        iterations=iterations, alpha=1.0, initial_ddp_cost=10.0, ddp_cost=9.0,
        stochastic_cost_mean=20.0, stochastic_cost_median=19.0, deterministic_cost=11.0,
    )  # fmt: skip


@pytest.mark.parametrize("last", [3, 2])  # a whole training, and one that was interrupted
def test_a_learning_curve_shows_at_every_time(recorded, last):
    recorded.scene.show("mjcf_description", String(data=BOX))
    for k in range(1, last + 1):
        recorded.scene.show("learning_progress", progress(k, 3))
    [chunk] = recorded.close()["/learning_curve"]
    assert chunk.is_static
    [[blob]] = column([chunk], "blob")
    with Image.open(io.BytesIO(bytes(blob))) as picture:
        assert picture.size[0] > 600


def test_a_recording_without_a_training_has_no_view_of_learning(recorded, swimmer):
    recorded.scene.show("mjcf_description", String(data=swimmer.mjcf))
    recorded.close()
    assert not any(
        "learning" in name or "plans" in name or "bound" in name for name in views(recorded.path)
    )


def test_a_training_has_its_views_and_a_planner_has_its_own(recorded, swimmer):
    recorded.scene.show("mjcf_description", String(data=swimmer.mjcf))
    recorded.scene.show("learning_progress", progress(1, 1))
    recorded.close()
    found = views(recorded.path)
    assert "learning curve" in found
    assert not any("plans" in name for name in found)


def test_time_begins_at_0_and_dates_are_those_of_the_stamps(recorded):
    recorded.scene.show("mjcf_description", String(data=BOX))
    recorded.scene.show(
        "joint_states", state_to_msg(np.array([0.1, 0.0]), ["height"], stamp_of(2_500_000_000))
    )
    [chunk] = [c for c in recorded.close()["/joint_states/position"] if not c.is_static]
    table = chunk.to_record_batch()
    assert table.column("time").to_pylist() == [datetime.timedelta(seconds=2.5)]
    assert table.column("ros2_timestamp").to_pylist() == [
        datetime.datetime(1970, 1, 1, 0, 0, 2, 500_000)
    ]


def test_commands_are_plotted_by_their_kinds_also_where_gains_make_servos_of_motors(recorded):
    leg = compile_model(LEG)
    motors = controls_of(leg)
    served = controls_of(compile_model(closed_loops(LEG, np.full(2, 80.0), np.full(2, 3.0))))
    recorded.scene.show("/mjcf_description", String(data=LEG))
    recorded.scene.show("/joint_states", state_to_msg(np.zeros(4), ["shoulder", "elbow"], Time()))
    recorded.scene.show("/joint_command", command_to_msg(np.ones(2), motors, Time()))
    recorded.scene.show("/joint_gains", gains_to_msg(served, Time()))
    recorded.scene.show("/joint_command", command_to_msg(np.full(2, 0.3), served, Time()))
    assert not any(text for _, text in recorded.reports)
    chunks = recorded.close()
    assert [6.0, -6.0] in column(chunks["/joint_command/effort"], "scalars")
    np.testing.assert_allclose(column(chunks["/joint_command/position"], "scalars"), [[0.3, 0.3]])
    assert "position [rad]" in views(recorded.path)
