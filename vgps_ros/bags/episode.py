# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads the motions in a bag: their states, and the controls that led to them.

A motion ends where time goes back, as at a reset, where the robot was put elsewhere, and where
states are missing.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import mujoco
import numpy as np

from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.recorded_nodes import SLACK
from vgps_ros.core.checks import finite_array, list_names
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.messages.conversions import command_from_msg, efforts_from_msg, nanoseconds
from vgps_ros.messages.robot_state import (
    IMU,
    JOINTS,
    NewestMeasurements,
    StateCollector,
    StateMessages,
)
from vgps_ros.robot.controls import Controls
from vgps_ros.search.identification import MeasuredMotion
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.forces import controls_are_forces
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import actuated_joint_names
from vgps_ros.tasks.task import Task

_COMMANDS = ("joint_command", "commands")  # topics, as the executor names them
GAP = 1.5  # a longer step from state to state than so many usual ones is a gap


def recorded_states(bag: BagReader, states: StateMessages) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yields when each state was complete [ns], and its messages by topic.

    Raises:
        InvalidInputError: the bag lacks one of the topics, or a message fits no definition.
    """
    names = {bag.needed_topic(name): name for name in states.topics}
    names |= {bag.filled_topics[name]: name for name in states.sources if name in bag.filled_topics}
    collector = StateCollector(states.is_complete)
    for message in bag.messages(list(names)):
        if found := collector.add(names[message.topic], bag.decode(message)):
            yield message.stamp, found


class Stamped(NamedTuple):
    """A state x, a context z or a control u of a bag.

    Attributes:
        received: when it was received [ns].
        stamp: that of the state to which it belongs [ns].
        values: its numbers.
        joints: of a state, its message on joint_states.
    """

    received: int
    stamp: int
    values: Array
    joints: Any = None


def read_motions(bag: BagReader, robot: StateMessages, faults: list[str]) -> list[list[Stamped]]:
    """Reads the states of a robot and splits them into motions. Repeated states count once.

    Args:
        bag: the bag.
        robot: joins messages to states.
        faults: takes a sentence on each stretch without states, and on those that are none.

    Raises:
        InvalidInputError: the bag lacks a topic, or a message fits no definition.
    """
    states, unusable = list[Stamped](), 0
    for received, messages in recorded_states(bag, robot):
        joints = messages[JOINTS]
        try:
            x = robot.join(messages)
            states.append(Stamped(received, nanoseconds(joints.header.stamp), x, joints))
        except InvalidInputError:
            unusable += 1
    if unusable:
        faults.append(f"{unusable} states cannot be used")
    steps = [b.stamp - a.stamp for a, b in pairwise(states) if b.stamp > a.stamp]
    period = float(np.median(steps)) if steps else 0.0
    motions = [states[:1]] if states else []
    for before, state in pairwise(states):
        step = state.stamp - before.stamp
        if not step and np.array_equal(before.values, state.values):
            continue
        if not 0 < step <= GAP * period:
            motions.append([])
        if step > GAP * period:
            faults.append(
                f"{round(step / period) - 1} states from {before.stamp * 1e-9:.3f} to "
                f"{state.stamp * 1e-9:.3f} s are not in the bag: they were not recorded, or were "
                "cut out, so that a motion ends there"
            )
        motions[-1].append(state)
    return motions


@dataclass(frozen=True)
class Episode:
    """A recorded motion of N states.

    Attributes:
        model: the robot.
        start: stamp of the first state [s].
        time: time of each state, from 0 on, shape (N,) [s].
        states: states x, shape (N, n_x).
        controls: controls that led to each state, shape (N, n_u); NaN where they are not known.
            Efforts tell them if they are forces on joints, and otherwise joint_command does.
    """

    model: mujoco.MjModel
    start: float
    time: Array
    states: Array
    controls: Array

    @property
    def time_step(self) -> float:
        """Time between two states [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def trajectory(self) -> Trajectory:
        """The states, and the control in each but the last."""
        return Trajectory(self.states, self.controls[1:])


def episodes(
    bag: BagReader, model: mujoco.MjModel, faults: list[str] | None = None
) -> list[Episode]:
    """Reads the motions of a robot but those of fewer than two states.

    Args:
        bag: the bag.
        model: the robot.
        faults: takes a sentence on each part of the bag that has no states.
    """
    faults = [] if faults is None else faults
    motions = read_motions(bag, StateMessages(state_layout(model)), faults)
    ends = [motion[0].received for motion in motions[1:]]
    controls = _controls(bag, model)
    found = []
    for motion, end in zip(motions, [*ends, sys.maxsize], strict=False):
        if len(motion) > 1:
            stamps = np.array([state.stamp for state in motion])
            states = np.array([state.values for state in motion])
            time, answers = (stamps - stamps[0]) * 1e-9, controls(motion, end)
            found.append(Episode(model, motion[0].stamp * 1e-9, time, states, answers))
    return found


def driven_episodes(bag: BagReader, model: mujoco.MjModel, faults: list[str]) -> list[Episode]:
    """Reads the motions as `episodes` does; they end, too, where a control is not known.

    Raises:
        InvalidInputError: there is none.
    """
    read, found, unknown = episodes(bag, model, faults), list[Episode](), 0
    for each in read:
        known = np.isfinite(each.controls[1:]).all(axis=1)
        unknown += int((~known).sum())
        for i, j in np.flatnonzero(np.diff(np.r_[0, known, 0])).reshape(-1, 2):
            part = slice(i, j + 1)
            start, time = each.start + each.time[i], each.time[part] - each.time[i]
            found.append(Episode(model, start, time, each.states[part], each.controls[part]))
    if unknown and found:
        faults.append(f"{unknown} states lack the control that answers them: a motion ends there")
    if not read:
        raise InvalidInputError(f"'{bag.path}' has no motion: it needs two states at least.")
    if not found:
        raise InvalidInputError(
            "The recorded joint_states have no efforts, but the torques are needed: record a "
            "simulation or a robot that publishes them."
            if controls_are_forces(model)
            else "None of the recorded states has a joint_command that answers it, but all "
            "controls are needed: record the robot in lock-step."
        )
    return found


def _controls(bag: BagReader, model: mujoco.MjModel) -> Callable[[list[Stamped], int], Array]:
    """Returns a function that finds the controls that led to the states of a motion, (N, n_u).

    The next motion begins at a time of receipt [ns]: stamps come again after a reset. The topics
    reach a recorder independently.
    """
    controls, unknown = controls_of(model), np.full(model.nu, np.nan)
    names, is_told = actuated_joint_names(model), controls_are_forces(model)
    topic = None if is_told else bag.filled_topics.get("joint_command")
    recorded = list(bag.decoded(topic)) if topic else []

    def find(motion: list[Stamped], end: int) -> Array:
        if is_told:
            said = [state.joints for state in motion]
            return np.array(
                [efforts_from_msg(m, names) if len(m.effort) else unknown for m in said]
            )
        answers = {
            nanoseconds(message.header.stamp): command_from_msg(message, controls)
            for received, message in recorded
            if motion[0].received - SLACK <= received < end
        }
        return np.array([unknown, *(answers.get(state.stamp, unknown) for state in motion[:-1])])

    return find


def measured_motions(
    bag: BagReader, task: Task, imu_frame: str = "", base_frame: str = ""
) -> list[MeasuredMotion]:
    """Reads what a robot measured and was told: `joint_states`, `imu` or else `odom`, and commands.

    Sensors may have stamps of their own. A command counts from the stamp of the state that it
    answers; one without a stamp counts from its receipt, as the stamps of states tell it. A motion
    ends where stamps go back.

    Args:
        bag: the bag.
        task: the robot.
        imu_frame: the site or body at which the IMU sits; empty: what its messages name.
        base_frame: name of the base's frame in messages; empty: the model's.

    Raises:
        InvalidInputError: the bag lacks a topic, or the joints or the sensors are another robot's.
    """
    layout, controls = state_layout(task.dynamics.model), task.controls
    is_blind = layout.base is not None and IMU in bag.filled_topics
    robot = StateMessages(layout, is_blind=is_blind, base_frame=base_frame, imu_frame=imu_frame)
    joints = next(bag.decoded(bag.needed_topic(JOINTS)))[1].name
    if set(robot.joint_names).isdisjoint(joints):
        raise InvalidInputError(
            f"{JOINTS} of '{bag.path}' has {list_names(joints)}, but the task {task.name} has "
            f"{list_names(robot.joint_names)}; name the task of the robot that was recorded."
        )
    told = next((name for name in _COMMANDS if name in bag.filled_topics), _COMMANDS[0])
    read = [name for name in robot.sources if name in bag.filled_topics or name in robot.needed]
    names = {bag.needed_topic(name): name for name in (*read, told)}
    measured, refused = (
        NewestMeasurements(robot, task.dynamics.time_step / 4, task.dynamics.time_step),
        "",
    )
    states, commands = list[list[Stamped]](), list[list[Stamped]]()
    for message in bag.messages(list(names)):
        name, content = names[message.topic], bag.decode(message)
        try:
            if name == told and commands:
                stamp = nanoseconds(content.header.stamp) if told == _COMMANDS[0] else 0
                values = _control(content, controls)
                commands[-1].append(Stamped(message.stamp, stamp, values))
            elif name != told and (parts := measured.add(name, content)):
                stamp = nanoseconds(parts[JOINTS].header.stamp) or message.stamp
                state = Stamped(message.stamp, stamp, robot.join(parts))
                if not states or stamp < states[-1][-1].stamp:
                    states.append([])
                    commands.append([])
                elif stamp == states[-1][-1].stamp:
                    continue
                states[-1].append(state)
        except InvalidInputError as error:
            refused = str(error)
    if refused and not (any(states) and any(commands)):
        raise InvalidInputError(refused)
    if not states:
        raise InvalidInputError(
            f"'{bag.path}' has no whole state of the task {task.name}: {measured.missing()} is not "
            "there; record it, or name the task of the robot that was recorded."
        )
    return [_measured(*parts, is_blind=is_blind) for parts in zip(states, commands, strict=True)]


def _control(message: Any, controls: Controls) -> Array:
    """Returns u, shape (n_u,), of a message on one of `_COMMANDS`."""
    if hasattr(message, "header"):
        return command_from_msg(message, controls)
    return controls.from_joints(finite_array("commands", message.data, (len(controls.names),)))


def _measured(states: list[Stamped], commands: list[Stamped], *, is_blind: bool) -> MeasuredMotion:
    """Returns a motion, in which a command without a stamp has one by its receipt."""
    late = round(np.median([state.received - state.stamp for state in states]))
    counts = sorted((u.stamp or u.received - late, i) for i, u in enumerate(commands))
    return MeasuredMotion(
        np.array([state.stamp for state in states]) * 1e-9,
        np.array([state.values for state in states]),
        np.array([stamp for stamp, _ in counts]) * 1e-9,
        np.array([commands[i].values for _, i in counts]),
        is_blind,
    )
