# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Forgeries of a bag, each made as well as it can be: found, or named as what is not proved."""

import hashlib
import math
import re
import struct
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Bool, String

from tests.bags.altered import _STORE, SAMPLE, messages_of, rewritten
from vgps_ros.bags import BagReader
from vgps_ros.bags.bag_check import UNPROVED, BagCheck, check_bag
from vgps_ros.bags.reader import BagMessage
from vgps_ros.bags.writer import MessageDefinitions
from vgps_ros.messages.conversions import nanoseconds, policy_from_msg
from vgps_ros.robot.executed_control import ExecutedPolicy
from vgps_ros.simulation.forces import BodyFrames, JointForces
from vgps_ros.tasks import make_task

KIND, BOOL = "sensor_msgs/msg/JointState", "std_msgs/msg/Bool"
STATES, COMMANDS, PUSH = "/joint_states", "/joint_command", "geometry_msgs/msg/WrenchStamped"
SWIMMER = make_task("swimmer")


def joint_state(data):
    found = _STORE.deserialize_cdr(data, KIND)
    for name in ("position", "velocity", "effort"):
        setattr(found, name, getattr(found, name).copy())
    return found


def serialized(content):
    """As rosbags does it: what rclpy makes of empty arrays has bytes behind the end."""
    return bytes(_STORE.serialize_cdr(content, KIND))


def joints(change, *topics):
    """The sample, where messages of these topics become what `change` makes of them."""
    messages = []
    for message in messages_of():
        data = message.data
        if message.topic in topics:
            content = joint_state(data)
            change(content)
            data = serialized(content)
        messages.append(replace(message, data=data))
    return messages


def put_stamp(message, stamp):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)


def at(stamp, seconds):
    return nanoseconds(stamp) == round(seconds * 1e9)


@cache
def recorded():
    """States by stamp [ns], and the policy that drove."""
    with BagReader(SAMPLE) as bag:
        states = {
            nanoseconds(m.header.stamp): np.concatenate([m.position, m.velocity])
            for _, m in bag.decoded(STATES)
        }
        *_, (_, policy) = bag.decoded("/policy")
    return states, policy_from_msg(policy)


def told(states, controls=None):
    """The sample with other states by stamp, and what the policy answers, or other controls."""
    _, policy = recorded()
    driven, forces = ExecutedPolicy(policy), JointForces(SWIMMER.dynamics.model)
    controls = controls or {
        stamp: driven.control(SWIMMER.observation(x), stamp, None) for stamp, x in states.items()
    }
    before = dict(zip([*states][1:], states, strict=False))

    def change(message):
        stamp = nanoseconds(message.header.stamp)
        if not len(message.position):
            if stamp:  # earlier policies answered the first state, too
                message.effort = controls[stamp]
            return
        n = len(message.position)
        message.position, message.velocity = states[stamp][:n], states[stamp][n:]
        if stamp:
            earlier = before[stamp]
            message.effort = forces(states[earlier], controls[earlier]).copy()

    return joints(change, STATES, COMMANDS)


def simulated(push_at=math.inf, force=(0.0, 3.0, 0.0)):
    """States by stamp of the same policy, with a push of 0.1 s on the robot's nose."""
    states, policy = recorded()
    driven, dynamics = ExecutedPolicy(policy), SWIMMER.dynamics
    bodies = BodyFrames(dynamics.model)
    found, x = {}, states[0]
    for stamp in states:
        found[stamp] = x
        control = driven.control(SWIMMER.observation(x), stamp, None)
        is_pushed = push_at <= stamp * 1e-9 < push_at + 0.1
        body = bodies.body("front")
        applied = bodies.applied(x, body, np.array(force), np.zeros(3)) if is_pushed else None
        x = dynamics.step(x, control, applied)
    return found


def with_push(messages, time):
    """Adds a push, as it was received with the state of a time [s]."""
    message = WrenchStamped()
    message.header.frame_id, message.wrench.force.y = "front", 3.0
    received = next(
        m.stamp
        for m in messages
        if m.topic == STATES and at(joint_state(m.data).header.stamp, time)
    )
    return [*messages, BagMessage("/push", PUSH, received, serialize_message(message))]


def root_times_ten():
    def change(message):
        message.position[list(message.name).index("root_x")] *= 10.0

    return joints(change, STATES)


def fabricated():
    return told({stamp: 1.1 * x for stamp, x in recorded()[0].items()})


def jumps():
    """The robot swims twice as far: each state follows from the one before, and is then moved."""
    far = {stamp: x * (1.0 + (np.arange(10) == 0)) for stamp, x in recorded()[0].items()}
    messages, before = [], far[0]
    for message in told(far):
        if message.topic == STATES:
            state = joint_state(message.data)
            x = far[nanoseconds(state.header.stamp)]
            if x is not before:
                follows = SWIMMER.dynamics.step(before, state.effort[-2:])
                state.position, state.velocity, before = follows[:5], follows[5:], x
                earlier = replace(message, stamp=message.stamp - 1, data=serialized(state))
                messages.append(earlier)
        messages.append(message)
    return messages


def creeping_times():
    def change(message):
        stamp = nanoseconds(message.header.stamp)
        put_stamp(message, stamp + 5 * round((stamp * 5e-8) ** 2))

    return joints(change, STATES, COMMANDS)


def cut_out(closed):
    """Five seconds are cut out, and the times of what follows are moved back where `closed`."""

    def keep(message):
        if message.topic not in (STATES, COMMANDS):
            return message
        content = joint_state(message.data)
        stamp = nanoseconds(content.header.stamp)
        if 4 * 10**9 < stamp <= 9 * 10**9:
            return None
        if closed and stamp > 4 * 10**9:
            put_stamp(content, stamp - 5 * 10**9)
        return replace(message, data=serialized(content))

    return [kept for message in messages_of() if (kept := keep(message))]


def policies(first, factor):
    """The parameters of the policies from an iteration on are scaled."""
    changed = []
    with BagReader(SAMPLE) as bag:
        for message in messages_of():
            data = message.data
            if message.topic == "/policy" and (told := bag.decode(message)).iteration in first:
                old = np.array(told.parameters)
                data = data.replace(old.tobytes(), (factor * old).tobytes())
                assert data != message.data
            changed.append(replace(message, data=data))
    return changed


def costs(name):
    changed = []
    with BagReader(SAMPLE) as bag:
        for message in messages_of():
            data = message.data
            if (
                message.topic == "/learning_progress"
                and (told := bag.decode(message)).iteration > 2
            ):
                value = getattr(told, name)
                data = data.replace(struct.pack("<d", value), struct.pack("<d", 0.9 * value))
                assert data != message.data
            changed.append(replace(message, data=data))
    return changed


def no_torque():
    """A torque is zero, the diagnostics of the time say that the safe action drove."""

    def change(message):
        if at(message.header.stamp, 4.0):
            message.effort = np.zeros(2)

    messages = joints(change, COMMANDS)
    diagnostics = [m for m in messages if m.topic == "/diagnostics"]
    is_said = {m: m.data.replace(b"\x06\0\0\0False\0", b"\x05\0\0\0True\0\0") for m in diagnostics}
    return [replace(m, data=is_said.get(m, m.data)) for m in messages]


def longer_link():
    """Another model, which the policies name too."""
    [text] = {
        deserialize_message(message.data, String).data
        for message in messages_of()
        if message.topic == "/mjcf_description"
    }
    longer = text.replace('fromto="0 0 0 -1 0 0"', 'fromto="0 0 0 -1.1 0 0"')
    assert longer != text
    old, new = (hashlib.sha256(each.encode()).hexdigest().encode() for each in (text, longer))
    description = serialize_message(String(data=longer))
    return [
        replace(m, data=description)
        if m.topic == "/mjcf_description"
        else replace(m, data=m.data.replace(old, new))
        for m in messages_of()
    ]


def other_efforts():
    def change(message):
        if at(message.header.stamp, 4.0):
            message.effort = 2.0 * message.effort

    return joints(change, STATES)


def no_efforts():
    def change(message):
        if at(message.header.stamp, 4.0):
            message.effort = np.empty(0)

    return joints(change, STATES)


def far_apart():
    """Each state comes 46 days after the one before."""

    def change(message):
        put_stamp(message, nanoseconds(message.header.stamp) * 80_000_000)

    return joints(change, STATES, COMMANDS)


def two_robots():
    """The same text with a space more, which somebody published as well."""
    found = list(messages_of())
    first = next(m for m in found if m.topic == "/mjcf_description")
    text = deserialize_message(first.data, String).data
    return [*found, replace(first, data=serialize_message(String(data=text + " ")))]


def noise_scaled():
    changed = []
    with BagReader(SAMPLE) as bag:
        for message in messages_of():
            data = message.data
            if message.topic == "/policy":
                old = np.array(bag.decode(message).noise_std)
                data = data.replace(old.tobytes(), (2.0 * old).tobytes())
                assert data != message.data
            changed.append(replace(message, data=data))
    return changed


def received_faster():
    first = min(m.stamp for m in messages_of())
    return [replace(m, stamp=first + (m.stamp - first) // 10) for m in messages_of()]


def twice():
    again = [m for m in messages_of() if m.topic in (STATES, COMMANDS)]
    return [*messages_of(), *again]


def stopped_amid_driving():
    received = next(
        m.stamp
        for m in messages_of()
        if m.topic == STATES and at(joint_state(m.data).header.stamp, 4.0)
    )
    data = serialize_message(Bool(data=True))
    return [*messages_of(), BagMessage("/emergency_stop", BOOL, received, data)]


def excused_by_a_push():
    def change(message):
        if at(message.header.stamp, 4.0):
            message.position[0] += 0.1  # which the policy does not read

    return with_push(joints(change, STATES), 4.0)


FOLLOW = "states do not follow from the state and the control before them"
POLICY = "controls are not what the policy gives"
COST = "costs without noise are not the policies'"
WRONG = {
    "root times ten": (root_times_ten, f"{FOLLOW}: at .* root_x/position is"),
    "states fabricated and controls recomputed": (fabricated, FOLLOW),
    "times that creep": (creeping_times, FOLLOW),
    "five seconds cut out and times closed": (lambda: cut_out(True), FOLLOW),
    "the policy that drove scaled": (lambda: policies({4}, 1.01), POLICY),
    "an earlier policy scaled": (lambda: policies({2}, 1.01), COST),
    "costs of policies changed": (lambda: costs("deterministic_cost"), COST),
    "a torque zeroed by a safe action": (no_torque, f"1 {FOLLOW}"),
    "a longer link": (longer_link, FOLLOW),
    "efforts changed": (other_efforts, "tell efforts that are not those of their controls"),
    "efforts left out": (no_efforts, "tell efforts that are not those of their controls"),
    "stamps far apart": (far_apart, "a state comes 4e\\+06 s too late|states do not follow"),
    "two robots": (two_robots, "2 different robots are on mjcf_description"),
    "a push that excuses": (excused_by_a_push, FOLLOW),
}
MISSING = {"five seconds cut out": (lambda: cut_out(False), "were not recorded, or were cut out")}
NOT_PROVED = {
    "other costs of noisy rollouts": (lambda: costs("stochastic_cost_mean"), "all else of the tra"),
    "each state put elsewhere": (jumps, "how 500 motions begin"),
    "noise of a policy that has none": (noise_scaled, "the noise of policies that drove without"),
    "received ten times faster": (received_faster, "when and how often each message came"),
    "messages twice": (twice, "when and how often each message came"),
    "an emergency stop amid driving": (stopped_amid_driving, "all other topics"),
    "simulated elsewhere": (lambda: told(simulated()), "a simulation that was computed elsewhere"),
}


def checked(tmp_path, messages) -> BagCheck:
    definitions = {kind: MessageDefinitions().find(kind) for kind in (PUSH, BOOL)}
    bag = rewritten(tmp_path / "bag", messages, definitions=definitions, texts=other_commit)
    return check_bag(bag)


def other_commit(text):
    return re.sub("commit: [0-9a-f]{4}", "commit: 0000", text)


@pytest.mark.parametrize("name", [*WRONG, *MISSING, *NOT_PROVED])
def test_a_forgery_is_found_or_what_is_missing_or_not_proved_is_named(tmp_path, name):
    forge, sentence = (WRONG | MISSING | NOT_PROVED)[name]
    found = checked(tmp_path, forge())
    places = [found.wrong, found.missing, [*found.unproved, UNPROVED]]
    place = [name in kind for kind in (WRONG, MISSING, NOT_PROVED)].index(True)
    assert not any(places[:place])
    assert any(re.search(sentence, words) for words in places[place]), found


def test_steps_under_a_push_that_the_bag_holds_are_proved(tmp_path):
    messages = told(simulated(push_at=4.0))
    found = checked(tmp_path, with_push(messages, 4.0))
    assert not found.wrong
    assert "500 of 500 steps from state to state" in found.proved
    without = checked(tmp_path / "without", messages).wrong
    assert any(words.startswith(f"5 {FOLLOW}") for words in without), without
