# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Splits a robot's state x into ROS messages of one stamp, and joins them to x again.

| topic | type | holds |
| --- | --- | --- |
| `odom` | nav_msgs/Odometry | the free base, the first free joint |
| `multi_dof_joint_states` | sensor_msgs/MultiDOFJointState | ball joints and further free bodies |
| `activations` | sensor_msgs/JointState | activations, as positions of their actuators |
| `joint_states` | sensor_msgs/JointState | hinges and slides |

A robot has only those topics for which it has something to say, and always `joint_states`. Where a
planar robot's `joint_states` lack the slides and the hinge of its base, `odom` tells them. For a
blind policy `imu` (sensor_msgs/Imu) may tell in place of `odom` how the free base is turned and
turns; the world's origin and zero stand for its place and its velocity then.

A body's pose is in the world, and its twist in the body's own axes, as in REP-105. A planar robot's
model hangs on the world by slides and a hinge without motors, which no encoder measures: a real one
has its base's pose and twist as odometry, from which they follow.

Joining what was split gives x bit for bit, but for the linear velocity of free bodies: MuJoCo has
it in the world's axes and ROS in the body's, and a rotation there and back rounds. Whoever joins
the same messages has the same x bit for bit, and the simulation itself goes on from what its
messages say.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Transform, Twist, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState, MultiDOFJointState

from vgps_ros.core.checks import finite_array, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import StateReadings
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import (
    name_order,
    nanoseconds,
    pack,
    stamp_of,
    state_from_msg,
    state_to_msg,
)
from vgps_ros.robot.bodies import BACK, BodyJoint, PlanarBase, StateLayout, product, rotate

TOPICS = ("odom", "multi_dof_joint_states", "activations", "joint_states")
ODOMETRY, BODIES, ACTIVATIONS, JOINTS = TOPICS
IMU = "imu"
_UNIT_TOLERANCE = 1e-3  # of a quaternion's length: a driver may compute in single precision
_MOST_WAITING = 1000  # incomplete states that are kept
_DRIVERS = 64  # sets of joints whose velocities are differences


class StateMessages:
    """Converts states of one robot.

    Attributes:
        topics: type of the message on each topic, in the order in which they are published.
        needed: those from which states are joined: the same, with `imu` in place of `odom` where
            it is blind.
        sources: those, and `odom` where it may tell what `joint_states` lack.
        joint_names: names of the hinges and slides, in the order of the state.
        base: the free base, or None.
        base_frame: name of the base's frame; of a robot that stands on a fixed base, its first
            body's.

    Args:
        layout: what the numbers of the robot's state are.
        is_blind: whether `imu` tells of the free base, and not `odom`.
        base_frame: name of the base's frame in messages; empty: the layout's.
        imu_frame: the site or body at which the IMU sits; empty: what its messages name.

    Raises:
        InvalidInputError: nothing that is fixed to the base has the name of the IMU's frame.
    """

    def __init__(
        self,
        layout: StateLayout,
        *,
        is_blind: bool = False,
        base_frame: str = "",
        imu_frame: str = "",
    ):
        self._layout = layout
        self.joint_names = list(layout.joints)
        self._joints = layout.joint_places
        activations = layout.names[layout.first_activation :]
        self._actuators = [name.rpartition("/")[0] for name in activations]
        self.base, self._planar = layout.base, layout.planar
        on_base = self._planar.joints if self._planar else ()
        self._limb_names = [name for name in self.joint_names if name not in on_base]
        self._limbs = layout.places(tuple(self._limb_names))
        self._bodies = [body for body in layout.bodies if body is not self.base]
        self.base_frame = base_frame or layout.base_frame
        needed = {
            ODOMETRY: (Odometry, self.base is not None),
            BODIES: (MultiDOFJointState, bool(self._bodies)),
            ACTIVATIONS: (JointState, bool(self._actuators)),
            JOINTS: (JointState, True),
        }
        self.topics = {topic: kind for topic, (kind, is_there) in needed.items() if is_there}
        self.is_blind = is_blind and self.base is not None
        replaced = {ODOMETRY: (IMU, Imu)} if self.is_blind else {}
        self.needed = dict(replaced.get(topic, (topic, k)) for topic, k in self.topics.items())
        self.sources = ({ODOMETRY: Odometry} if self._planar else {}) | self.needed
        self._imu_frame = imu_frame
        self._turn_of(imu_frame)  # which must be there

    def lacking_joints(self, names: Collection[str]) -> list[str]:
        """Returns the joints that lack beside these names; `odom` may tell those of a base."""
        on_base = self._planar.joints if self._planar else ()
        is_told = any(name in names for name in on_base)
        needed = self.joint_names if is_told else self._limb_names
        return [name for name in needed if name not in names]

    def lacks_base(self, joints: Any) -> bool:
        """Returns whether joint states have all joints but those that `odom` may tell."""
        names = set(joints.name)
        is_told = not self._planar or not names.isdisjoint(self._planar.joints)
        return not (is_told or self.lacking_joints(names))

    def missing_topics(self, messages: Mapping[str, Any]) -> list[str]:
        """Returns the topics from which a message lacks before these, by topic, make a state."""
        lacking = [topic for topic in self.needed if topic not in messages]
        if JOINTS in messages:
            if self.lacking_joints(set(messages[JOINTS].name)):
                lacking.append(JOINTS)
            elif ODOMETRY not in messages and self.lacks_base(messages[JOINTS]):
                lacking.append(ODOMETRY)
        return lacking

    def is_complete(self, messages: Mapping[str, Any]) -> bool:
        """Returns whether messages of one stamp, by topic, can be joined to a state."""
        return not self.missing_topics(messages)

    def subscribe(
        self,
        create_subscription: Callable[..., object],
        take: Callable[[dict[str, Any]], object],
        qos: Any,
    ) -> None:
        """Calls a function with the messages of each state by topic, once all of them are there."""
        collector = StateCollector(self.is_complete)

        def receive(topic: str, message: Any) -> None:
            if messages := collector.add(topic, message):
                take(messages)

        for topic, kind in self.sources.items():
            create_subscription(kind, topic, partial(receive, topic), qos)

    def split(self, x: Array, stamp: Time, efforts: Array | None = None) -> dict[str, Any]:
        """Returns the messages by topic, with efforts of the joints [N·m, N] where known."""
        messages = {topic: kind() for topic, kind in self.topics.items() if topic != JOINTS}
        messages[JOINTS] = state_to_msg(x[self._joints], self.joint_names, stamp, efforts)
        if self.base:
            odometry = messages[ODOMETRY]
            odometry.header.frame_id, odometry.child_frame_id = "odom", self.base.name
            pose, twist = odometry.pose.pose, odometry.twist.twist
            _write_body(self.base, x, pose.position, pose.orientation, twist)
        if self._bodies:
            several = messages[BODIES]
            several.joint_names = [body.name for body in self._bodies]
            several.transforms = [Transform() for _ in self._bodies]
            several.twist = [Twist() for _ in self._bodies]
            for i, body in enumerate(self._bodies):
                at = several.transforms[i]
                _write_body(body, x, at.translation, at.rotation, several.twist[i])
        if self._actuators:
            activations = messages[ACTIVATIONS]
            activations.name = self._actuators
            activations.position = pack(x[self._layout.first_activation :])
        for message in messages.values():
            message.header.stamp = stamp
        return messages

    def join(self, messages: Mapping[str, Any]) -> Array:
        """Returns x, shape (n_x,), whatever the order of names in each message.

        Args:
            messages: complete messages of rclpy or of a bag, by topic.

        Raises:
            InvalidInputError: a name is missing, or a value is missing, not finite, or no rotation.
        """
        x, joints = np.empty(len(self._layout.names)), messages[JOINTS]
        base: BodyJoint | PlanarBase | None = self.base
        if ODOMETRY in messages and self.lacks_base(joints):
            base = self._planar
            x[self._limbs] = state_from_msg(joints, self._limb_names)
        else:
            x[self._joints] = state_from_msg(joints, self.joint_names)
        if base and self.is_blind:
            self._read_imu(x, messages[IMU])
        elif base:
            odometry = messages[ODOMETRY]
            if odometry.child_frame_id != self.base_frame:
                raise InvalidInputError(
                    f"odom.child_frame_id is {quote(odometry.child_frame_id)}, but it must be "
                    f"the robot's base, '{self.base_frame}'; base_frame tells its name."
                )
            pose, twist = odometry.pose.pose, odometry.twist.twist
            parts = x, ODOMETRY, pose.position, pose.orientation, twist
            read_body(base, *parts) if isinstance(base, BodyJoint) else _read_planar(base, *parts)
        if self._bodies:
            several = messages[BODIES]
            names = tuple(several.joint_names)
            order = name_order(names, tuple(body.name for body in self._bodies)).tolist()
            if not len(several.transforms) == len(several.twist) == len(names):
                raise InvalidInputError(
                    f"{BODIES} has {len(names)} joints, {len(several.transforms)} transforms and "
                    f"{len(several.twist)} twists, but each joint needs one of both."
                )
            for body, i in zip(self._bodies, order, strict=True):
                at = several.transforms[i]
                read_body(body, x, BODIES, at.translation, at.rotation, several.twist[i])
        if self._actuators:
            activations = messages[ACTIVATIONS]
            names = tuple(activations.name)
            values = finite_array("activations.position", activations.position, (len(names),))
            x[self._layout.first_activation :] = values[name_order(names, tuple(self._actuators))]
        return finite_array("The state", x, x.shape) if base or self._bodies else x  # may overflow

    def _read_imu(self, x: Array, imu: Any) -> None:
        """Writes orientation and angular velocity of the base to x; its place is the origin."""
        assert self.base is not None
        for what in ("orientation", "angular_velocity"):
            if getattr(imu, f"{what}_covariance")[0] == -1.0:  # so says sensor_msgs/Imu
                raise InvalidInputError(
                    f"imu.{what}_covariance says that the IMU has no {what}, but the policy "
                    "reads it: let a filter, such as imu_filter_madgwick, publish it."
                )
        turn = self._turn_of(self._imu_frame or imu.header.frame_id)
        twist = SimpleNamespace(linear=Vector3(), angular=imu.angular_velocity)
        read_body(self.base, x, IMU, Vector3(), imu.orientation, twist)
        _, rotation, _, angular = self.base.parts(x)
        rotation[:] = product(rotation, turn * BACK)
        angular[:] = rotate(angular, turn)

    def _turn_of(self, frame: str) -> Array:
        """Returns how a site or body on the base is turned in it; no turn: the base's own frame."""
        if frame in ("", self.base_frame):
            return np.array([1.0, 0.0, 0.0, 0.0])
        mounts = self._layout.mounts
        if frame not in mounts:
            raise InvalidInputError(
                f"The frame of imu is {quote(frame)}, but it must be that of the robot's base, "
                f"'{self.base_frame}', or of what is fixed to it, {', '.join(mounts)}; set "
                "imu_frame to the one at which the IMU sits."
            )
        return self._layout.turns[mounts.index(frame)]


class StateCollector:
    """Collects messages until those of one stamp make a state, in any order.

    Messages on `joint_states` that name some of the joints each are joined by name. A state that is
    sent again is complete again once all of its messages came again.
    """

    def __init__(self, is_complete: Callable[[Mapping[str, Any]], bool]):
        self._is_complete = is_complete
        self._waiting: dict[int, dict[str, Any]] = {}  # by stamp [ns], the oldest first

    def add(self, topic: str, message: Any) -> dict[str, Any] | None:
        """Returns the messages of a state by topic, if this message completes it."""
        stamp = nanoseconds(message.header.stamp)
        messages = self._waiting.setdefault(stamp, {})
        parts = [messages[topic]] if topic == JOINTS and topic in messages else []
        messages[topic] = joined_joints([*parts, message]) if parts else message
        if not self._is_complete(messages):
            if len(self._waiting) > _MOST_WAITING:
                del self._waiting[next(iter(self._waiting))]
            return None
        # Messages from before belong to states whose other messages were lost: topics keep order.
        for earlier in list(self._waiting):
            del self._waiting[earlier]
            if earlier == stamp:
                break
        return messages


def joined_joints(parts: Sequence[Any]) -> Any:
    """Returns one message of parts on `joint_states`, with the stamp of the oldest of them.

    Of a joint in several parts the last one counts. A field that a part lacks is left empty.
    """
    if len(parts) == 1:
        return parts[0]
    places = {name: (part, i) for part in parts for i, name in enumerate(part.name)}
    joined = JointState(name=list(places))
    joined.header.stamp = stamp_of(min(nanoseconds(part.header.stamp) for part in parts))
    for field in ("position", "velocity", "effort"):
        if all(len(getattr(part, field)) == len(part.name) for part in parts):
            setattr(joined, field, [getattr(part, field)[i] for part, i in places.values()])
    return joined


class _JointParts:
    """Joins messages on `joint_states`, of which each may name some of the joints only.

    The newest parts are one message once each joint is among them, and again when the oldest part
    is newer. What names none of the joints is left out, as that of another driver's gripper.

    Args:
        states: tells which joints there are.
        tolerance: largest difference between the stamps of two parts [ns].
        smoothing: time constant of the filter of velocities that are differences of positions,
            which count where a message has none; 0: none are made [s].
        tell: called before the first of these.
    """

    def __init__(
        self,
        states: StateMessages,
        tolerance: int,
        smoothing: float = 0.0,
        tell: Callable[[], object] = lambda: None,
    ):
        self._states, self._tolerance = states, tolerance
        self._smoothing, self._tell = smoothing, tell
        self._parts: list[Any] = []
        self._last = 0  # stamp of the newest message that was made of several parts [ns]
        self._strange: list[str] = []  # names in the newest message that was left out
        # Stamp [ns], positions and velocities of the newest message that had none, by its names.
        self._moving: dict[tuple[str, ...], tuple[int, Array, Array | None]] = {}

    def add(self, message: Any) -> Any | None:
        """Returns a message with all joints, if this one completes it."""
        names, stamp = set(message.name), nanoseconds(message.header.stamp)
        if self._states.joint_names and names.isdisjoint(self._states.joint_names):
            self._strange = list(message.name)
            return None
        if self._smoothing and not np.isfinite(message.velocity).any():
            message = self._with_velocities(message, stamp)
            if message is None:
                return None
        self._parts = [
            part
            for part in self._parts
            if abs(nanoseconds(part.header.stamp) - stamp) <= self._tolerance
            and not names.issuperset(part.name)
        ]
        self._parts.append(message)
        if self._states.lacking_joints({name for part in self._parts for name in part.name}):
            return None
        joined = joined_joints(self._parts)
        if len(self._parts) > 1:
            before, self._last = self._last, nanoseconds(joined.header.stamp)
            return None if self._last == before > 0 else joined
        return joined

    def missing(self) -> str:
        """Returns the joints that lack to the newest parts, in words; empty where none do."""
        lacking = self._states.lacking_joints({name for part in self._parts for name in part.name})
        if not (lacking and (self._parts or self._strange)):
            return ""
        strange = f" (one came with {quote(self._strange)})" if self._strange else ""
        return f"{JOINTS} with {', '.join(lacking)}{strange}"

    def _with_velocities(self, message: Any, stamp: int) -> Any | None:
        """Returns a message with velocities; None for the first one of some joints."""
        names, here = tuple(message.name), np.array(message.position)
        if len(here) != len(names) or not np.isfinite(here).all():
            return message  # which is refused, and tells the filter nothing
        if not self._moving:
            self._tell()
        before, there, velocity = self._moving.get(names, (stamp, here, None))
        passed = (stamp - before) * 1e-9
        if passed > 0.0:
            rate = (here - there) / passed
            kept = math.exp(-passed / self._smoothing)
            velocity = rate if velocity is None else rate + kept * (velocity - rate)
        elif passed < 0.0:  # time was set back
            velocity = None
        if len(self._moving) >= _DRIVERS and names not in self._moving:
            del self._moving[next(iter(self._moving))]
        self._moving[names] = stamp, here, velocity
        if velocity is None:
            return None
        filled = JointState(header=message.header, name=message.name, position=message.position)
        filled.velocity = pack(velocity)
        return filled


class NewestMeasurements:
    """Joins the newest message of each topic to states, where each sensor has stamps of its own.

    A message on `joint_states` makes one state, with what is within the tolerance of its stamp; it
    waits for what is not there yet.

    Attributes:
        takes_all: whether states count that come earlier than the period says.

    Args:
        states: tells the topics and the joints that lack to a state.
        tolerance: largest difference between the stamp of `joint_states` and another one [s].
        period: time of a control step, in which one state is made of a robot that measures more
            often, so that no policy runs faster than it learned [s].
        is_simulated: whether each message is used once, since a state of a simulation may come
            again with other values.
        smoothing: see `_JointParts`, as `tell`.
        tell: called before the first velocities that are differences.
    """

    def __init__(
        self,
        states: StateMessages,
        tolerance: float,
        period: float,
        smoothing: float = 0.0,
        tell: Callable[[], object] = lambda: None,
        *,
        is_simulated: bool = False,
    ):
        self._lacking, self._is_simulated = states.missing_topics, is_simulated
        self._tolerance, self._period = round(tolerance * 1e9), round(period * 1e9)  # [ns]
        self._joints = _JointParts(states, self._tolerance, smoothing, tell)
        self._newest: dict[str, Any] = {}
        self._due, self._last = 0, 0  # stamps of the next state that is wanted, and of the last
        self._is_new = False  # whether the newest joint states have made no state yet
        self.takes_all = False

    def add(self, topic: str, message: Any) -> dict[str, Any] | None:
        """Returns the messages of a state by topic, if this message completes it."""
        if topic == JOINTS and not (message := self._joints.add(message)):
            return None
        self._newest[topic] = message
        self._is_new |= topic == JOINTS
        if not self._is_new:
            return None
        stamp = nanoseconds(self._newest[JOINTS].header.stamp)
        # Measured too early for the next control; of a robot, or overtaken by a later message.
        back = self._period * (1 if self._is_simulated else 2)
        is_early = 0.1 * self._period < self._due - stamp < back
        if is_early and not self.takes_all and stamp not in (0, self._last):
            return None
        near = self._near(stamp)
        if self._lacking(near):
            return None
        self._is_new, self._last = False, stamp
        is_regular = abs(stamp - self._due) < self._period
        self._due = (self._due if is_regular else stamp) + self._period
        if self._is_simulated:
            self._newest = {}
        return near

    def missing(self) -> str:
        """Returns what the newest joint states lack to a state, in words; empty where nothing."""
        if (lacking := self._joints.missing()) or JOINTS not in self._newest:
            return lacking or JOINTS
        stamp = nanoseconds(self._newest[JOINTS].header.stamp)
        said = []
        for topic in self._lacking(self._near(stamp)):
            if topic in self._newest:
                late = (stamp - nanoseconds(self._newest[topic].header.stamp)) * 1e-9
                side = "before" if late > 0 else "after"
                said.append(
                    f"{topic} within {self._tolerance * 1e-9:g} s of the stamp of {JOINTS} (the "
                    f"newest one is {abs(late):.3g} s {side} it)"
                )
            else:
                said.append(topic)
        return " and ".join(said)

    def _near(self, stamp: int) -> dict[str, Any]:
        return {
            topic: message
            for topic, message in self._newest.items()
            if abs(nanoseconds(message.header.stamp) - stamp) <= self._tolerance
        }


def readings_of_place(base: BodyJoint, start: Array, *read: StateReadings) -> list[str]:
    """Returns the names of the readings that change with a free base's place or linear velocity.

    They are tried near a state, shape (n_x,).
    """
    rng, found = np.random.default_rng(0), []
    for readings in read:
        here = start + rng.standard_normal((8, len(start)))
        for first in readings.space.quaternions:
            turns = here[:, first : first + 4]
            turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        there = here.copy()
        place, _, velocity, _ = base.parts(there)
        place += rng.uniform(-1.0, 1.0, place.shape)
        velocity += rng.uniform(-1.0, 1.0, velocity.shape)
        for name, before, after in zip(
            readings.names, readings(here).T, readings(there).T, strict=True
        ):
            if not np.allclose(before, after, rtol=1e-9, atol=1e-9):
                found.append(name)
    return found


def _write_body(body: BodyJoint, x: Array, position: Any, orientation: Any, twist: Any) -> None:
    """Writes what x says of a body to the parts of a message; the twist is in the body's axes."""
    at, rotation, linear, angular = body.parts(x)
    put(orientation, "wxyz", rotation)
    put(twist.angular, "xyz", angular)
    if body.is_free:
        put(position, "xyz", at)
        put(twist.linear, "xyz", rotate(linear, rotation * BACK))


def read_body(
    body: BodyJoint, x: Array, topic: str, position: Any, orientation: Any, twist: Any
) -> None:
    """Writes what the parts of a message say of a body to x.

    Raises:
        InvalidInputError: a number is not finite, or the orientation is no unit quaternion.
    """
    at, rotation, linear, angular = body.parts(x)
    rotation[:] = _get(f"{topic}: orientation of {body.name}", orientation, "wxyz")
    if abs((length := float(np.linalg.norm(rotation))) - 1.0) > _UNIT_TOLERANCE:
        raise InvalidInputError(
            f"{topic}: orientation of {body.name} has the length {length:g}, but that of a "
            "quaternion must be 1."
        )
    angular[:] = _get(f"{topic}: angular velocity of {body.name}", twist.angular, "xyz")
    if body.is_free:
        at[:] = _get(f"{topic}: position of {body.name}", position, "xyz")
        along = _get(f"{topic}: linear velocity of {body.name}", twist.linear, "xyz")
        linear[:] = rotate(along, rotation)


def _read_planar(
    base: PlanarBase, x: Array, topic: str, position: Any, orientation: Any, twist: Any
) -> None:
    """Writes what the parts of a message of odometry say of a planar base's joints to x.

    The hinge's angle is within half a turn of its initial one. What the joints cannot follow,
    such as a tilt out of the plane, is left out.
    """
    free, moved = BodyJoint(base.name, True, 0, 7), np.empty(13)
    read_body(free, moved, topic, position, orientation, twist)
    at, rotation, linear, angular = free.parts(moved)
    to_world = base.rotation * BACK
    turned = product(to_world, rotation)
    angle = math.remainder(2.0 * math.atan2(base.axis @ turned[1:], turned[0]), 2.0 * math.pi)
    rate = base.axis @ angular
    arm = rotate(base.anchor, turned)  # from the body's origin to the anchor
    slid = rotate(at - base.position, to_world) + arm - base.anchor
    speed = rotate(linear, to_world) + rate * np.cross(base.axis, arm)
    along = np.linalg.pinv(base.axes)
    x[list(base.positions)] = base.initial + np.r_[along @ slid, angle]
    x[list(base.velocities)] = np.r_[along @ speed, rate]


def put(target: Any, names: str, values: Array) -> None:
    """Writes values to the fields of a message that the letters of a word name, such as xyz."""
    for name, value in zip(names, values.tolist(), strict=True):
        setattr(target, name, value)


def _get(what: str, source: Any, names: str) -> Array:
    return finite_array(what, [getattr(source, name) for name in names], (len(names),))
