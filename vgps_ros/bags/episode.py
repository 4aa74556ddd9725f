# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads the motions in a bag: their states, and the controls that led to them.

A motion ends where time goes back, as at a reset, and where states are missing.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.recorded_nodes import SLACK
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.messages.conversions import command_from_msg, efforts_from_msg, nanoseconds
from vgps_ros.messages.robot_state import JOINTS, StateCollector, StateMessages
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.forces import controls_are_forces
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import actuated_joint_names
from vgps_ros.tasks.motion_table import write_motion

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


def episodes(bag: BagReader, model: mujoco.MjModel) -> list[Episode]:
    """Reads the motions of a robot. Repeated states count once.

    Motions of fewer than two states are left out.
    """
    robot_states = StateMessages(state_layout(model))
    states = [
        (received, nanoseconds(messages[JOINTS].header.stamp), messages)
        for received, messages in recorded_states(bag, robot_states)
    ]
    steps = [b - a for (_, a, _), (_, b, _) in pairwise(states) if b > a]
    longest = GAP * float(np.median(steps)) if steps else 0.0
    motions: list[_Motion] = []
    newest = sys.maxsize
    for received, stamp, messages in states:
        if not newest <= stamp <= newest + longest:
            motions.append(_Motion(received, {}, {}))
        newest = stamp
        motions[-1].states[stamp] = robot_states.join(messages)
        motions[-1].joints[stamp] = messages[JOINTS]
    ends = [motion.begin for motion in motions[1:]]
    controls = _efforts if controls_are_forces(model) else _answers(bag, model)
    return [
        Episode(
            model,
            min(motion.states) * 1e-9,
            (np.array([*motion.states]) - min(motion.states)) * 1e-9,
            np.array([*motion.states.values()]),
            controls(motion, end, model),
        )
        for motion, end in zip(motions, [*ends, sys.maxsize], strict=False)
        if len(motion.states) > 1
    ]


def holes(motions: Sequence[Episode]) -> list[str]:
    """Returns a sentence on each stretch between two motions in which states are missing."""
    return [
        f"no states from {end:.3f} to {after.start:.3f} s, so that a motion ends there"
        for before, after in pairwise(motions)
        if after.start > (end := before.start + float(before.time[-1]))
    ]


class _Motion(NamedTuple):
    begin: int  # time at which the first state was received [ns]
    states: dict[int, Array]  # by stamp [ns]
    joints: dict[int, Any]  # the messages on joint_states


def _efforts(motion: _Motion, _end: int, model: mujoco.MjModel) -> Array:
    """Returns the recorded efforts of the driven joints, shape (N, n_u)."""
    names, unknown = actuated_joint_names(model), np.full(model.nu, np.nan)
    joints = motion.joints.values()
    return np.array([efforts_from_msg(m, names) if len(m.effort) else unknown for m in joints])


def _answers(bag: BagReader, model: mujoco.MjModel) -> Callable[..., Array]:
    """Returns a function that finds the joint_command that answers the state before each."""
    controls, unknown = controls_of(model), np.full(model.nu, np.nan)
    topic = bag.filled_topics.get("joint_command")
    recorded = list(bag.decoded(topic)) if topic else []

    def find(motion: _Motion, end: int, _model: mujoco.MjModel) -> Array:
        # Stamps come again after a reset; the topics reach a recorder independently.
        answers = {
            nanoseconds(message.header.stamp): command_from_msg(message, controls)
            for received, message in recorded
            if motion.begin - SLACK <= received < end
        }
        return np.array(
            [unknown, *(answers.get(stamp, unknown) for stamp in [*motion.states][:-1])]
        )

    return find


def motion_of(episode: Episode) -> Trajectory:
    """Returns the states of a motion, and the control in each but the last.

    Raises:
        InvalidInputError: some controls are not known.
    """
    if not np.isfinite(episode.controls[1:]).all():
        raise InvalidInputError(
            "The recorded joint_states have no efforts, but the torques are needed: record a "
            "simulation or a robot that publishes them."
            if controls_are_forces(episode.model)
            else "Some of the recorded states have no joint_command that answers them, but all "
            "controls are needed: record the robot in lock-step."
        )
    return Trajectory(episode.states, episode.controls[1:])


def write_table(episode: Episode, path: Path) -> None:
    """Writes a motion as a table that `vgps train --demonstration` reads.

    Raises:
        InvalidInputError: the file exists, or some controls of the motion are not known.
    """
    try:
        write_motion(path, episode.model, episode.time, motion_of(episode))
    except FileExistsError as error:
        raise InvalidInputError(f"'{path}' exists already; name another file.") from error
