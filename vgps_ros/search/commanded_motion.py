# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compares what a robot did with what it was told: commands, and the paths that they lead to."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.records import Array, Trajectory
from vgps_ros.robot.signals import Command
from vgps_ros.search.judgement import SETTLING, CommandReadings, settled_steps
from vgps_ros.tasks import Task
from vgps_ros.tasks.course import asked_path

_PLANAR = ("cmd_vel/linear/x", "cmd_vel/linear/y", "cmd_vel/angular/z")


@dataclass(frozen=True)
class CommandedMotion:
    """A motion of T steps that was commanded, of n_a commands that the cost follows.

    Attributes:
        time_step: between two states [s].
        frequency: of the clock [Hz]; 0: there is none.
        commands: the commands.
        asked: their values in each step, shape (T, n_a), in their units.
        done: what was achieved, shape (T, n_a).
        counts: whether the errors of a step count: as in a judgement, only those from `SETTLING`
            after a change on do, shape (T,).
        asked_path: x, y and yaw of a robot that had done exactly what it was told, from where this
            one began, shape (T+1, 3), [m, rad]; None of a robot without a free base, or without
            commands from cmd_vel.
        driven_path: those of the robot, shape (T+1, 3).
    """

    time_step: float
    frequency: float
    commands: tuple[Command, ...]
    asked: Array
    done: Array
    counts: NDArray[np.bool_]
    asked_path: Array | None = None
    driven_path: Array | None = None

    @classmethod
    def of(cls, task: Task, motion: Trajectory, context: Array) -> "CommandedMotion | None":
        """Returns what a motion did of what it was told, or None if no command is achieved.

        Args:
            task: commands, and the cost that follows them.
            motion: the states and controls.
            context: commands and clock in each step, shape (T, n_z).
        """
        signals, achieved = task.signals, CommandReadings.of(task)
        if not achieved.commands:
            return None
        told = context[:, : len(signals.commands)]
        asked = told[:, achieved.commands]
        errors = achieved.errors(motion.states[None], motion.controls[None], context[None])[0]
        period = task.dynamics.time_step
        sources = [command.source for command in signals.commands]
        model, paths = task.dynamics.model, dict[str, Array]()
        if set(_PLANAR) & set(sources) and model.jnt_type[:1] == mujoco.mjtJoint.mjJNT_FREE:
            silent = np.zeros(len(told))
            velocities = [
                told[:, sources.index(name)] if name in sources else silent for name in _PLANAR
            ]
            driven = planar_path(motion.states)
            asked_way = asked_path(np.stack(velocities, axis=1), period, driven[0])
            paths = {"asked_path": asked_way, "driven_path": driven}
        return cls(
            period,
            signals.frequency,
            tuple(signals.commands[i] for i in achieved.commands),
            asked,
            asked + errors,
            settled_steps(told[None], round(SETTLING / period))[0],
            **paths,
        )

    @property
    def errors(self) -> dict[str, float]:
        """Root mean square error of each command, by its name; NaN where no step counts."""
        squares = (self.done - self.asked)[self.counts] ** 2
        rms = np.sqrt(squares.mean(axis=0)) if len(squares) else np.full(squares.shape[1], np.nan)
        return dict(zip((command.name for command in self.commands), rms.tolist(), strict=True))

    @property
    def drift(self) -> float | None:
        """Distance of the end from where the commands led to [m]; None if the paths are unknown."""
        if self.asked_path is None or self.driven_path is None:
            return None
        return float(np.linalg.norm((self.driven_path - self.asked_path)[-1, :2]))


def planar_path(states: Array) -> Array:
    """Returns x, y and yaw of a robot that begins with a free joint, shape (..., 3), [m, rad].

    Args:
        states: shape (T, n_x); the yaw goes on without jumps from one to the next.
    """
    w, x, y, z = np.moveaxis(states[:, 3:7], -1, 0)
    yaw = np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2)))
    return np.column_stack([states[:, :2], yaw])
