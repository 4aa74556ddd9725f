# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a run from its bag."""

from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.bags import BagReader
from vgps_ros.bags.episode import Episode, episodes
from vgps_ros.bags.recorded_nodes import RecordedExecutor, learned_policy
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Trajectory
from vgps_ros.messages.conversions import (
    distribution_from_msg,
    nanoseconds,
    result_from_msgs,
    signals_from_msg,
)
from vgps_ros.messages.names import CONTEXT
from vgps_ros.messages.robot_state import JOINTS
from vgps_ros.search.commanded_motion import CommandedMotion
from vgps_ros.search.run_record import RunRecord
from vgps_ros.simulation.model import compile_model
from vgps_ros.storage.run_folder import RunFolder


def read_run(path: Path, namespace: str | None = None) -> RunRecord:
    """Reads a run from the folder of a bag, or from the folder of a run that has one.

    Args:
        path: the folder.
        namespace: of the robot that is meant, for a bag of several.

    Raises:
        InvalidInputError: the folder is neither of these, or cannot be read.
    """
    folder = RunFolder(path)
    if folder.bag.is_dir():
        return _read_bag(folder.bag, namespace)
    if folder.result.is_file():
        raise InvalidInputError(
            f"'{path}' has costs but no motion, which is in {folder.bag.name}/ or in "
            f"{folder.trajectories.name}: name the folder of a run that has finished."
        )
    return _read_bag(path, namespace)


def _read_bag(path: Path, namespace: str | None) -> RunRecord:
    with BagReader(path, namespace) as bag:
        mjcf = bag.mjcf()
        topics = bag.filled_topics

        def decoded(name: str) -> list[Any]:
            return [message for _, message in bag.decoded(topics[name])] if name in topics else []

        distributions = [m for m in decoded("trajectory_distribution") if m.trajectory_index == 0]
        faults = list[str]()
        motions = episodes(bag, compile_model(mjcf), faults) if JOINTS in topics else []
        episode = motions[-1] if motions else None
        time_step = episode.time_step if episode else 0.0
        if distributions:
            time_step = float(distributions[-1].time_step)
        initial = next((message for message in distributions if message.iteration == 0), None)
        last = distribution_from_msg(distributions[-1]) if distributions else None
        return RunRecord(
            mjcf,
            time_step,
            result=_result(decoded("learning_progress"), decoded("policy")),
            initial_states=distribution_from_msg(initial).mean.states if initial else None,
            mean_states=last.mean.states if last else None,
            state_covariances=last.state_covariances if last else None,
            executed_states=episode.states if episode else None,
            driven=_commanded_motion(bag, episode) if episode and CONTEXT in topics else None,
            faults=tuple(faults),
        )


def _commanded_motion(bag: BagReader, episode: Episode) -> CommandedMotion | None:
    """Reads what the robot was told in the last motion; what is not recorded stays as before."""
    executor = RecordedExecutor(bag, episode.model)
    if executor.task is None:
        return None
    told = {
        nanoseconds(message.header.stamp): list(signals_from_msg(message).values())
        for _, message in bag.decoded(bag.filled_topics[CONTEXT])
        if tuple(message.names) == executor.signals.names
    }
    stamps = np.array(sorted(told))
    if not stamps.size:
        return None
    asked = np.round((episode.start + episode.time[:-1]) * 1e9)
    latest = np.searchsorted(stamps, asked + 0.5, side="right") - 1
    context = np.array([told[stamp] for stamp in stamps[np.maximum(latest, 0)].tolist()])
    motion = Trajectory(episode.states, np.nan_to_num(episode.controls[1:]))
    return CommandedMotion.of(executor.task, motion, context)


def _result(progress: list[Any], policies: list[Any]) -> dict[str, Any] | None:
    """Returns the content of result.json for the last training in the bag."""
    if not progress:
        return None
    begin = max(i for i, message in enumerate(progress) if i == 0 or message.iteration == 1)
    # A learner that was started again repeats the iteration that it goes on from.
    history = {message.iteration: message for message in progress[begin:]}
    policy = learned_policy(policies[-1]) if policies else None
    return result_from_msgs(list(history.values()), policy)
