# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Looks at a running robot in place of commanding it, and says in sentences what is wrong.

Each second it judges what came: rates, stamps and delays of the sensors; names, order, ranges and
velocities of the joints; where up is, by the base and by the accelerometer; whether anybody gives
the commands that the policy reads; and the policy's answers beside what drives the robot now.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Setting
from vgps_ros.messages.conversions import command_from_msg, nanoseconds
from vgps_ros.messages.names import CMD_VEL, COMMAND
from vgps_ros.messages.robot_state import IMU, JOINTS, StateMessages
from vgps_ros.robot.bodies import BACK, product, vertical
from vgps_ros.robot.controls import ControlKind
from vgps_ros.robot.deployment import Deployment
from vgps_ros.ros_runtime.command_sender import CommandSender
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.qos import COMMANDED
from vgps_ros.ros_runtime.services import steady_timer
from vgps_ros.ros_runtime.training_results import TrainingResults

SHADOW = Setting(
    "shadow",
    False,
    "whether to command nothing and to say what is wrong with a robot that runs: its "
    "sensors, its joints' order, and the policy's answers beside what drives it now",
)
_PERIOD = 1.0  # between two judgements [s]
_FEWEST = 10  # states and messages that are judged
_APART = 0.3  # deviation from the pose from which on another order of the joints is sought [rad]
_TURNED = 0.5  # angle between two measured verticals that are not the same [rad]
_MARGIN = 0.1  # beyond a joint's range that zeros of encoders may be off [rad, m]
_MOVES = 0.1  # rms rate of something that moves [rad/s, m/s]
_GRAVITY = 9.81  # [m/s²]


class Look:
    """What is known of a robot that runs.

    Args:
        node: the controller.
        health: its diagnostics, which get the figures and the sentences.
        robot: what is known of the task.
        states: the robot's topics and joints.
        sender: what would send the commands.
        training: the policy that would drive.
    """

    def __init__(
        self,
        node: Node,
        health: Health,
        robot: Deployment,
        states: StateMessages,
        sender: CommandSender,
        training: TrainingResults,
    ):
        self._node, self._health, self._robot, self._states = node, health, robot, states
        self._controls, self._training = training.controls, training
        self._found: dict[str, str] = {}  # sentences, by what they are about
        self._other: Array | None = None  # the newest command of another controller
        if len(sender.topics) == 1:
            node.create_subscription(sender.kind, sender.topics[0], self._take_other, COMMANDED)
        self._timer = steady_timer(node, _PERIOD, self._judge)
        self._timer.cancel()
        self._forget()

    def begin(self) -> None:
        """Begins to judge what comes."""
        self._forget()
        self._timer.reset()

    def _forget(self) -> None:
        self._heard: dict[str, list[tuple[int, Any]]] = {t: [] for t in self._states.sources}
        self._seen: list[tuple[int, Array]] = []  # stamps [ns] and states
        self._answers: list[tuple[Array, Array, Array]] = []  # ours, another's, measured positions

    def end(self) -> None:
        """Judges no more."""
        self._timer.cancel()
        self._health.clear(*self._found)

    def hear(self, topic: str, message: Any) -> None:
        """Notes a message of a sensor."""
        self._heard[topic].append((self._node.get_clock().now().nanoseconds, message))

    def see(self, state: Array, stamp: int) -> None:
        """Notes a state (n_x,) that the messages make, and its stamp [ns]."""
        self._seen.append((stamp, state))

    def compare(self, control: Array) -> None:
        """Notes the control (n_u,) that would be sent, beside the newest one of who drives."""
        if self._other is not None and self._seen:
            ours, others = map(self._controls.at_joints, (control, self._other))
            self._answers.append((ours, others, self._controls.positions @ self._seen[-1][1]))

    def _take_other(self, message: Any) -> None:
        try:
            if isinstance(message, Float64MultiArray):
                values = np.array(message.data)
                is_whole = len(values) == len(self._controls.names)
                self._other = self._controls.from_joints(values) if is_whole else None
            else:
                self._other = command_from_msg(message, self._controls)
        except InvalidInputError as error:
            self._other = None
            self._health.set_value("commands of another controller", f"not comparable: {error}")

    def _judge(self) -> None:
        before, self._found = self._found, {}
        for topic, heard in self._heard.items():
            if topic in self._states.needed or heard:
                self._judge_stamps(topic, heard)
        if self._heard[JOINTS]:
            self._judge_names({name for _, m in self._heard[JOINTS] for name in m.name})
        if len(self._seen) >= _FEWEST:
            stamps, states = map(np.array, zip(*self._seen, strict=True))
            self._judge_joints(stamps * 1e-9, states)
            self._judge_base(stamps * 1e-9, states)
        if self._answers:
            self._judge_answers(*map(np.array, zip(*self._answers, strict=True)))
        self._judge_reads()
        well = "nothing is wrong" if self._seen else "there is no state yet"
        self._health.set_value("look", f"{len(self._found)} sentences" if self._found else well)
        self._health.clear(*(about for about in before if about not in self._found))
        # What stays wrong keeps its first sentence, since its figures change each second.
        self._found |= {about: words for about, words in before.items() if about in self._found}
        for about, words in self._found.items():
            self._health.report(about, warning=words)
        self._forget()

    def _judge_stamps(self, topic: str, heard: Sequence[tuple[int, Any]]) -> None:
        name, period = self._node.resolve_topic_name(topic), self._robot.time_step
        if not heard:
            kind = self._states.sources[topic].__name__
            found = self._node.get_topic_names_and_types()
            like = [t for t, kinds in found if any(k.endswith(f"/{kind}") for k in kinds)]
            also = "".join(f", or give it by -r {topic}:={t}" for t in like if t != name)
            self._found[topic] = f"Nothing comes on {name}: start the driver that sends it{also}."
            return
        stamps = np.array([nanoseconds(message.header.stamp) for _, message in heard]) * 1e-9
        steps, ages = np.diff(stamps), np.array([at for at, _ in heard]) * 1e-9 - stamps
        parts = len({tuple(m.name) for _, m in heard}) if topic == JOINTS else 1
        rate = len(steps) / (stamps[-1] - stamps[0]) / parts if stamps[-1] > stamps[0] else 0.0
        self._health.set_value(
            topic,
            f"{rate:.1f} Hz, longest step {1e3 * max(steps, default=0.0):.1f} ms, delay "
            f"{1e3 * np.median(ages):.2f} ms, at most {1e3 * ages.max():.2f} ms",
        )
        if (stamps == 0.0).any():
            said = "has the stamp 0: let its driver set the time of the measurement."
        elif rate < 0.9 / period:
            said = (
                f"comes {rate:.3g} times a second, but the policy learned {1.0 / period:.3g} "
                "controls a second: raise the rate of its driver."
            )
        elif parts == 1 and (back := int((steps <= 0.0).sum())):
            said = (
                f"has {back} messages of {len(heard)} that are no newer than the one before: let "
                "one node alone publish it, with the time of each measurement."
            )
        elif not abs(np.median(ages)) <= max(2.0 * period, 0.05):
            said = (
                f"comes {np.median(ages):.3g} s after its stamps: synchronise the clocks, set "
                "use_sim_time, or find what delays it."
            )
        else:
            return
        self._found[topic] = f"{name} {said}"

    def _judge_names(self, names: set[str]) -> None:
        self._health.set_value("joints", f"{len(names & {*self._states.joint_names})} known")
        if lacking := self._states.lacking_joints(names):
            strange = sorted(names - {*self._states.joint_names})
            came = f", while {quote(strange)} came" if strange else ""
            self._found["joints"] = (
                f"{JOINTS} lack {', '.join(lacking)}{came}: let the driver name all joints, as the "
                "model does."
            )

    def _judge_joints(self, times: Array, states: Array) -> None:
        from scipy.optimize import linear_sum_assignment  # only a shadow needs it

        layout = self._robot.layout
        positions, velocities = np.split(states[:, layout.joint_places], 2, axis=1)
        beyond = (positions < layout.ranges[0] - _MARGIN) | (positions > layout.ranges[1] + _MARGIN)
        if beyond.any():
            said = [
                f"{joint} at {values[np.argmax(far)]:.3g} (its range is {low:.3g} to {high:.3g})"
                for joint, values, far, low, high in zip(
                    layout.joints, positions.T, beyond.T, *layout.ranges, strict=True
                )
                if far.any()
            ]
            self._found["ranges"] = (
                f"Measured beyond its range is {', '.join(said)}: check zeros, signs, units and "
                "order of the driver's joints."
            )
        self._judge_rates("velocity", layout.joints, times, positions, velocities)
        poses = np.array([self._robot.initial_state, *self._robot.keyframes.values()])
        poses = poses[:, layout.joint_places[: len(layout.joints)]]
        # Cost of reading joint j where the pose has joint i.
        costs = np.abs(poses[..., None] - np.median(positions, axis=0))
        cost = costs[np.trace(costs, axis1=1, axis2=2).argmin()]
        _, order = linear_sum_assignment(cost)
        here, best = np.diag(cost), cost[np.arange(len(cost)), order]
        apart = here.max(initial=0.0)
        self._health.set_value("farthest joint from the pose", f"{apart:.3f}")
        if apart > _APART and best.max() < 0.3 * apart:
            pairs = zip(layout.joints, order, here, strict=True)
            moved = [f"{name} as {layout.joints[j]}" for name, j, far in pairs if far > _APART]
            self._found["order"] = (
                f"A joint is {apart:.2g} away from the pose in which the robot stands, but in "
                f"another order none is more than {best.max():.2g} away: if it stands so, the "
                f"driver's order is not that of its names; it sends {', '.join(moved)}."
            )

    def _judge_base(self, times: Array, states: Array) -> None:
        base = self._robot.layout.base
        if base is None:
            return
        rotations, rates = (np.array([base.parts(x)[i] for x in states]) for i in (1, 3))
        up, start = vertical(rotations).mean(axis=0), base.parts(self._robot.initial_state)[1]
        self._health.set_value("up in the axes of the base", " ".join(f"{n:.2f}" for n in up))
        if (tilt := _angle(up, vertical(start))) > _TURNED:
            self._found["tilt"] = (
                f"The base is measured {tilt:.2g} rad tilted from how the robot starts: if it "
                "stands upright, the sensor is mounted otherwise than the model says; turn its "
                "site in the model, or name another one by imu_frame."
            )
        turns = np.array([product(a * BACK, b) for a, b in pairwise(rotations)])
        angles = np.cumsum(2.0 * np.sign(turns[:, :1]) * turns[:, 1:], axis=0)
        axes = [f"the base about {axis}" for axis in "xyz"]
        self._judge_rates("angular velocity", axes, times[1:], angles, rates[1:])
        if felt := [(m.linear_acceleration, m.orientation) for _, m in self._heard.get(IMU, [])]:
            force = np.mean([(a.x, a.y, a.z) for a, _ in felt], axis=0)
            level = vertical(np.array([(q.w, q.x, q.y, q.z) for _, q in felt])).mean(axis=0)
            is_felt = 0.7 < np.linalg.norm(force) / _GRAVITY < 1.3
            if is_felt and (apart := _angle(force, level)) > _TURNED:
                self._found["gravity"] = (
                    f"The accelerometer of imu and its orientation differ by {apart:.2g} rad on "
                    "where up is: its driver must give both in the axes of one frame, with an "
                    "acceleration of +9.81 m/s² upwards at rest."
                )

    def _judge_rates(
        self, what: str, names: Sequence[str], times: Array, positions: Array, rates: Array
    ) -> None:
        """Judges whether measured rates (n, m) are those of positions (n, m) at times (n,) [s]."""
        steps = np.diff(times)
        is_short = (steps > 0.0) & (steps < 0.1)
        found = np.diff(positions, axis=0)[is_short] / steps[is_short, None]
        told = 0.5 * (rates[1:] + rates[:-1])[is_short]
        if len(found) < _FEWEST:
            return
        power = np.square(found).mean(axis=0)
        shares = (told * found).mean(axis=0) / np.maximum(power, _MOVES**2)
        wrong = (power > _MOVES**2) & (np.abs(shares - 1.0) > 0.5)
        said = [f"{n} ({s:.2g} times)" for n, s, w in zip(names, shares, wrong, strict=True) if w]
        if said:
            self._found[what] = (
                f"The {what} of {', '.join(said)} is not the rate at which it moves: check its "
                "sign, unit and axes in the driver."
            )

    def _judge_answers(self, ours: Array, others: Array, measured: Array) -> None:
        """Judges n answers, the commands beside them, and measured positions, shapes (n, n_u)."""
        controls, apart = self._controls, np.sqrt(np.square(ours - others).mean(axis=0))
        worst = int(np.argmax(apart))
        figures = f"{np.sqrt(np.square(apart).mean()):.3g}, most of {controls.names[worst]}"
        unit = f"{apart[worst]:.3g} {controls.units[worst]}"
        self._health.set_value("rms of answers − commands", f"{figures}, {unit}")
        moves = (others.std(axis=0) > 0.02) & (measured.std(axis=0) > 0.01)
        moving = np.flatnonzero(controls.are(ControlKind.POSITION) & moves)
        if len(moving) < 2 or len(others) < _FEWEST:
            return
        count, names = len(moving), [controls.names[i] for i in moving]
        alike = np.corrcoef(measured[:, moving].T, others[:, moving].T)[:count, count:]
        for i, j in enumerate(np.abs(alike).argmax(axis=1)):
            if abs(alike[i, j]) > 0.9 and alike[i, i] < 0.5:
                self._found["follows"] = (
                    f"{names[i]} moves {'as' if alike[i, j] > 0.0 else 'against what'} {names[j]} "
                    "is commanded: the driver's order or signs of the joints differ between what "
                    "it measures and what it is commanded."
                )

    def _judge_reads(self) -> None:
        """Shows what the policy reads, and judges whether somebody gives its commands."""
        if driven := self._training.policy:
            contract, read = getattr(driven.policy, "contract", None), self._training.observation
            of_joints = [n for n in read.names if n.rpartition("/")[0] in self._states.joint_names]
            rest = ", ".join(name for name in read.names if name not in of_joints)
            said = contract.sizes if contract else f"{len(of_joints)} of {JOINTS}; {rest}"
            self._health.set_value("policy reads", said)
        commands = self._robot.signals.commands
        topics = [CMD_VEL] * any(command.source for command in commands) + [COMMAND]
        if commands and not any(map(self._node.count_publishers, topics)):
            names = ", ".join(command.name for command in commands)
            words = f"Nobody publishes {' or '.join(topics)}, so that {names} rest."
            self._found["commands"] = words


def _angle(a: Array, b: Array) -> float:
    """Returns the angle between two vectors (3,) [rad]."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
