# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""States split into messages and joined again: a base, balls, activations, in any order."""

import random
from contextlib import suppress

import mujoco
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from numpy.testing import assert_allclose, assert_array_equal
from rclpy.serialization import deserialize_message, serialize_message

from tests.nodes.malformed import broken
from tests.simulation.robots import everything, random_states
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.messages.robot_state import StateCollector, StateMessages
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import state_names
from vgps_ros.tasks import make_task

MODEL = everything()
STATES = StateMessages(state_layout(MODEL))
ALL = ["odom", "multi_dof_joint_states", "activations", "joint_states"]


def a_state(seed: int = 1) -> np.ndarray:
    return random_states(MODEL, np.random.default_rng(seed), 1)[0]


def shuffled(messages: dict, seed: int) -> dict:
    """Returns the messages as another sender may order their names, with a name of its own."""
    rng = random.Random(seed)
    joints, bodies = messages["joint_states"], messages["multi_dof_joint_states"]
    joints.name = [*joints.name, "another"]
    joints.position, joints.velocity = ([*v, 7.0] for v in (joints.position, joints.velocity))
    order = rng.sample(range(len(joints.name)), len(joints.name))
    for field in ("name", "position", "velocity"):
        values = getattr(joints, field)
        setattr(joints, field, [values[i] for i in order])
    names, transforms, twists = bodies.joint_names, bodies.transforms, bodies.twist
    bodies.joint_names = [*names, "another"]
    bodies.transforms, bodies.twist = [*transforms, transforms[0]], [*twists, twists[0]]
    if rng.random() < 0.5:
        for field in ("joint_names", "transforms", "twist"):
            setattr(bodies, field, getattr(bodies, field)[::-1])
    return messages


@given(st.integers(0, 10**6))
def test_a_state_comes_back_bit_for_bit_in_any_order_of_its_joints(seed):
    state = a_state(seed)
    joined = STATES.join(shuffled(STATES.split(state, Time()), seed))
    turned = [i for i, name in enumerate(state_names(MODEL)) if name.startswith("base/v")]
    exact = np.delete(np.arange(len(state)), turned)
    assert joined[exact].tobytes() == state[exact].tobytes()
    assert_allclose(joined[turned], state[turned], rtol=0, atol=1e-15)


@given(st.integers(0, 10**6))
def test_all_who_join_the_same_messages_have_the_same_state_bit_for_bit(seed):
    messages = STATES.split(a_state(seed), Time())
    sent = {t: deserialize_message(serialize_message(m), type(m)) for t, m in messages.items()}
    assert STATES.join(sent).tobytes() == STATES.join(messages).tobytes()


def test_odometry_has_the_pose_in_the_world_and_the_twist_in_the_base():
    model, state = MODEL, a_state()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.act[:] = np.split(state, [model.nq, model.nq + model.nv])
    mujoco.mj_forward(model, data)
    odometry = STATES.split(state, Time(sec=3))["odom"]
    assert isinstance(odometry, Odometry)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base")
    assert odometry.header.stamp.sec == 3
    pose, twist = odometry.pose.pose, odometry.twist.twist
    at, q = pose.position, pose.orientation
    base = model.body("base").id
    assert_allclose([at.x, at.y, at.z], data.xpos[base])
    assert_allclose([q.w, q.x, q.y, q.z], data.xquat[base])
    velocity = np.empty(6)  # of the body's origin, in its own axes, the angular one first
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, base, velocity, 1)
    for part, expected in ((twist.angular, velocity[:3]), (twist.linear, velocity[3:])):
        assert_allclose([part.x, part.y, part.z], expected, atol=1e-12)


def test_a_robot_without_a_base_has_joint_states_alone(swimmer, rng):
    states = StateMessages(state_layout(swimmer.dynamics.model))
    assert list(states.topics) == ["joint_states"]
    state = rng.standard_normal(10)
    assert_array_equal(states.join(states.split(state, Time())), state)


def test_the_topics_are_those_that_the_robot_needs():
    assert list(STATES.topics) == ALL
    two = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody>
        <body name="drone"><freejoint/><geom size=".1"/></body>
        <body name="parcel" pos="1 0 0"><freejoint/><geom size=".1"/></body>
        </worldbody></mujoco>"""
    )
    states = StateMessages(state_layout(two))
    assert list(states.topics) == ["odom", "multi_dof_joint_states", "joint_states"]
    state = np.r_[two.qpos0, np.arange(12.0)]
    messages = states.split(state, Time())
    assert messages["odom"].child_frame_id == "drone"
    assert messages["multi_dof_joint_states"].joint_names == ["parcel"]
    assert_array_equal(states.join(messages), state)


# A planar robot's base from its odometry

TURNED = """
<mujoco><worldbody>
  <body name="cart" pos="1 2 3" euler="20 30 40">
    <joint name="y" type="slide" axis="0 1 0" ref=".3"/>
    <joint name="x" type="slide" axis="1 1 0"/>
    <joint name="yaw" axis="0 0 1" pos=".3 -.2 .1" ref="20"/>
    <geom size=".1"/>
    <body name="pole"><joint name="pole" axis="0 1 0"/><geom size=".1" pos="0 0 1"/></body>
  </body>
</worldbody><actuator><motor joint="pole"/></actuator></mujoco>
"""


def measured(model: mujoco.MjModel, states: StateMessages, x: np.ndarray) -> dict:
    """Returns a state as a real robot measures it: encoders of its limbs, odometry of its base."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = x[: model.nq], x[model.nq :]
    mujoco.mj_forward(model, data)
    messages, body = states.split(x, Time()), 1
    joints = messages["joint_states"]
    keep = [
        i for i, name in enumerate(joints.name) if model.jnt_bodyid[model.joint(name).id] > body
    ]
    for field in ("name", "position", "velocity"):
        values = getattr(joints, field)
        setattr(joints, field, [values[i] for i in keep])
    odometry = Odometry(child_frame_id=model.body(body).name)
    at, turned = odometry.pose.pose.position, odometry.pose.pose.orientation
    at.x, at.y, at.z = data.xpos[body].tolist()
    turned.w, turned.x, turned.y, turned.z = data.xquat[body].tolist()
    velocity, twist = np.empty(6), odometry.twist.twist
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 1)
    twist.angular.x, twist.angular.y, twist.angular.z = velocity[:3].tolist()
    twist.linear.x, twist.linear.y, twist.linear.z = velocity[3:].tolist()
    return {"odom": odometry, "joint_states": joints}


@pytest.mark.parametrize("name", ["swimmer", "walker", "hopper", "half_cheetah", "turned"])
def test_odometry_tells_what_the_joint_states_of_a_planar_robot_lack(name, rng):
    turned = mujoco.MjModel.from_xml_string(TURNED)
    model = turned if name == "turned" else make_task(name).dynamics.model
    states = StateMessages(state_layout(model))
    assert list(states.topics) == ["joint_states"]  # which have all in the simulation
    for _ in range(20):
        x = np.r_[model.qpos0 + rng.uniform(-3, 3, model.nq), rng.uniform(-3, 3, model.nv)]
        messages = measured(model, states, x)
        assert not states.is_complete({"joint_states": messages["joint_states"]})
        assert states.is_complete(messages)
        assert_allclose(states.join(messages), x, rtol=0, atol=1e-12)


def test_odometry_does_not_change_what_complete_joint_states_say(swimmer, rng):
    states, state = StateMessages(state_layout(swimmer.dynamics.model)), rng.standard_normal(10)
    messages = states.split(state, Time())
    assert states.is_complete(messages)
    assert states.join({"odom": Odometry(), **messages}).tobytes() == state.tobytes()


@given(st.data())
def test_odometry_broken_in_any_way_gives_a_finite_state_or_is_refused(data):
    model = mujoco.MjModel.from_xml_string(TURNED)
    for states, whole in (
        (STATES, STATES.split(a_state(), Time())),
        (
            turned := StateMessages(state_layout(model)),
            measured(model, turned, np.r_[model.qpos0, np.ones(4)]),
        ),
    ):
        odometry = data.draw(broken(whole["odom"]))
        with suppress(InvalidInputError):
            assert np.isfinite(states.join(whole | {"odom": odometry})).all()


def test_a_robot_that_stands_on_a_motor_has_no_planar_base():
    for name in ("cart_pole", "arm", "rotor", "quadruped"):
        states = StateMessages(state_layout(make_task(name).dynamics.model))
        assert states.sources == states.topics


def changed(topic: str, change) -> dict:
    messages = STATES.split(a_state(), Time())
    change(messages[topic])
    return messages


@pytest.mark.parametrize(
    ("topic", "change", "sentence"),
    [
        ("odom", lambda m: setattr(m, "child_frame_id", "base_link"), "it must be the robot's"),
        (
            "odom",
            lambda m: setattr(m.pose.pose.position, "y", float("nan")),
            "odom: position of base is nan at index 1",
        ),
        (
            "odom",
            lambda m: setattr(m.twist.twist.linear, "x", float("inf")),
            "odom: linear velocity of base is inf",
        ),
        (
            "odom",
            lambda m: [setattr(m.pose.pose.orientation, k, 0.0) for k in "wxyz"],
            "orientation of base has the length 0",
        ),
        (
            "multi_dof_joint_states",
            lambda m: setattr(m, "joint_names", ["tale"]),
            r"joints \['tale'\].*'tail'",
        ),
        ("multi_dof_joint_states", lambda m: setattr(m, "twist", []), "1 transforms and 0 twists"),
        ("activations", lambda m: setattr(m, "name", ["knee"]), "'slow_knee'"),
        ("activations", lambda m: setattr(m, "position", []), "activations.position has 0"),
        ("joint_states", lambda m: setattr(m, "velocity", []), "joint_states.velocity has 0"),
    ],
)
def test_a_message_that_does_not_fit_is_refused_by_name(topic, change, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        STATES.join(changed(topic, change))


# Messages of one stamp


def sent(state: int, stamp: int) -> list[tuple[str, object]]:
    """Returns the messages of a state that its base's x marks."""
    x = a_state()
    x[0] = state
    return list(STATES.split(x, stamp_of(stamp)).items())


@given(st.randoms(use_true_random=False), st.integers(1, 8))
def test_each_state_is_complete_once_however_its_topics_interleave(rng, count):
    queues = {t: [sent(i, i)[k] for i in range(count)] for k, t in enumerate(ALL)}
    collector, found = StateCollector(STATES.is_complete), []
    while any(queues.values()):
        topic = rng.choice([t for t, queue in queues.items() if queue])
        if messages := collector.add(*queues[topic].pop(0)):
            found.append(STATES.join(messages)[0])
    assert found == list(range(count))


def test_what_lacks_a_message_is_left_out_and_never_mixed_with_another_state():
    collector = StateCollector(STATES.is_complete)

    def complete(messages) -> list[float]:
        return [STATES.join(m)[0] for m in (collector.add(*pair) for pair in messages) if m]

    assert complete(sent(1, 10)[1:]) == []  # its odometry is lost
    assert complete(sent(2, 20)) == [2]
    assert complete(sent(3, 10)[:1]) == []  # after a reset: the old messages are forgotten
    assert complete(sent(3, 10)[1:]) == [3]
    assert complete([*sent(4, 20), *sent(4, 20)]) == [4, 4]  # sent again


def test_messages_that_never_become_a_state_take_bounded_memory():
    collector = StateCollector(STATES.is_complete)
    state = a_state()
    for i in range(3000):
        assert collector.add("odom", STATES.split(state, stamp_of(i))["odom"]) is None
    assert len(collector._waiting) == 1000


def test_a_rotor_needs_no_base():
    assert StateMessages(state_layout(make_task("rotor").dynamics.model)).base is None
