"""Reads the last motion in a bag: the states since time last went back, and their torques."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vgps_ros.bags import BagReader
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import command_from_msg, nanoseconds, state_from_msg
from vgps_ros.simulation.model import actuated_joint_names, compile_model, joint_names


@dataclass(frozen=True)
class Episode:
    """A recorded motion of N states.

    Attributes:
        time: time of each state, from 0 on, shape (N,) [s].
        states: states x, shape (N, n_x).
        efforts: torques of the actuated joints that led to each state, shape (N, n_u) [N·m]. They
            are NaN where the bag has none.
        joint_names: names of the joints, in the order of the state.
        actuated_joint_names: names of the actuated joints, in the order of the efforts.
    """

    time: Array
    states: Array
    efforts: Array
    joint_names: list[str]
    actuated_joint_names: list[str]

    @property
    def time_step(self) -> float:
        """Time between two states [s]."""
        return float(np.median(np.diff(self.time)))


def last_episode(bag: BagReader, topic: str, mjcf: str) -> Episode | None:
    """Reads the last motion from a topic of joint states. Repeated states count once.

    Returns:
        The motion, or None if there are fewer than two states.
    """
    model = compile_model(mjcf)
    names, actuated = joint_names(model), actuated_joint_names(model)
    rows: dict[int, tuple[Array, Array]] = {}
    for _, message in bag.decoded(topic):
        stamp = nanoseconds(message.header.stamp)
        if rows and stamp < max(rows):
            rows = {}
        known = len(message.effort) > 0
        efforts = command_from_msg(message, actuated) if known else np.full(model.nu, np.nan)
        rows[stamp] = state_from_msg(message, names), efforts
    if len(rows) < 2:
        return None
    time = (np.array(list(rows)) - next(iter(rows))) * 1e-9
    states, efforts = (np.array(column) for column in zip(*rows.values(), strict=True))
    return Episode(time, states, efforts, names, actuated)


def write_table(episode: Episode, path: Path) -> None:
    """Writes a motion as a table that `vgps train --demonstration` reads.

    Raises:
        InvalidInputError: the file exists, or the motion has no efforts.
    """
    if not np.isfinite(episode.efforts[1:]).all():
        raise InvalidInputError(
            "The recorded joint_states have no efforts, but a demonstration needs the torques: "
            "record a simulation or a robot that publishes them."
        )
    # In the table, the efforts of a row act until the next row.
    following = np.vstack([episode.efforts[1:], np.zeros_like(episode.efforts[:1])])
    header = [
        "time",
        *(f"{name}/{kind}" for kind in ("position", "velocity") for name in episode.joint_names),
        *(f"{name}/effort" for name in episode.actuated_joint_names),
    ]
    try:
        with path.open("x", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            writer.writerows(np.column_stack([episode.time, episode.states, following]).tolist())
    except FileExistsError as error:
        raise InvalidInputError(f"'{path}' exists already; name another file.") from error
