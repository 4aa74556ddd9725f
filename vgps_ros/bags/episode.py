# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads the last motion in a bag: the states since time last went back, and their controls."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from vgps_ros.bags import BagReader
from vgps_ros.bags.states import recorded_states
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.messages.conversions import command_from_msg, nanoseconds
from vgps_ros.messages.robot_state import JOINTS, StateMessages
from vgps_ros.simulation.joint_forces import controls_are_forces
from vgps_ros.simulation.model import actuated_joint_names
from vgps_ros.tasks.motion_file import write_motion


@dataclass(frozen=True)
class Episode:
    """A recorded motion of N states.

    Attributes:
        model: the robot.
        time: time of each state, from 0 on, shape (N,) [s].
        states: states x, shape (N, n_x).
        controls: controls that led to each state, shape (N, n_u); NaN where they are not known.
            Efforts tell them if they are forces on joints, and otherwise joint_command does.
    """

    model: mujoco.MjModel
    time: Array
    states: Array
    controls: Array

    @property
    def time_step(self) -> float:
        """Time between two states [s]."""
        return float(np.median(np.diff(self.time)))


def last_episode(bag: BagReader, model: mujoco.MjModel) -> Episode | None:
    """Reads the last motion of a robot. Repeated states count once.

    Returns:
        The motion, or None if there are fewer than two states.
    """
    robot_states = StateMessages(model)
    rows: dict[int, tuple[Array, Any]] = {}  # state and joint_states by stamp
    for _, messages in recorded_states(bag, robot_states):
        stamp = nanoseconds(messages[JOINTS].header.stamp)
        if rows and stamp < max(rows):
            rows = {}
        rows[stamp] = robot_states.join(messages), messages[JOINTS]
    if len(rows) < 2:
        return None
    stamps = list(rows)
    states, joints = zip(*rows.values(), strict=True)
    controls = (
        _efforts(joints, model) if controls_are_forces(model) else _answers(bag, stamps, model)
    )
    return Episode(model, (np.array(stamps) - stamps[0]) * 1e-9, np.array(states), controls)


def _efforts(joints: Sequence[Any], model: mujoco.MjModel) -> Array:
    """Returns the recorded efforts of the driven joints, shape (N, n_u)."""
    names, unknown = actuated_joint_names(model), np.full(model.nu, np.nan)
    return np.array([command_from_msg(m, names) if len(m.effort) else unknown for m in joints])


def _answers(bag: BagReader, stamps: Sequence[int], model: mujoco.MjModel) -> Array:
    """Returns the recorded joint_command that answers the state before each, shape (N, n_u)."""
    names, unknown = actuated_joint_names(model), np.full(model.nu, np.nan)
    topic = bag.filled_topics.get("joint_command")
    recorded = [message for _, message in bag.decoded(topic)] if topic else []
    commands = {nanoseconds(m.header.stamp): command_from_msg(m, names) for m in recorded}
    return np.array([unknown, *(commands.get(stamp, unknown) for stamp in stamps[:-1])])


def write_table(episode: Episode, path: Path) -> None:
    """Writes a motion as a table that `vgps train --demonstration` reads.

    Raises:
        InvalidInputError: the file exists, or some controls of the motion are not known.
    """
    if not np.isfinite(episode.controls[1:]).all():
        raise InvalidInputError(
            "The recorded joint_states have no efforts, but a demonstration needs the torques: "
            "record a simulation or a robot that publishes them."
            if controls_are_forces(episode.model)
            else "Some of the recorded states have no joint_command that answers them, but a "
            "demonstration needs all controls: record the robot in lock-step."
        )
    motion = Trajectory(episode.states, episode.controls[1:])
    try:
        write_motion(path, episode.model, episode.time, motion)
    except FileExistsError as error:
        raise InvalidInputError(f"'{path}' exists already; name another file.") from error
