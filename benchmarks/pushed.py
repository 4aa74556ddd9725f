# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Pushes of a robot's base, and the arguments of the benchmarks that push it."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.tasks import Task


def push(task: Task, state: Any, size: float, rng: np.random.Generator) -> Any:
    """Returns the state after a push into a random direction, of a size in [m/s]."""
    change = np.zeros(task.dims["n_dx"])
    angle, first = rng.uniform(0, 2 * np.pi), task.velocities.start
    change[first : first + 2] = size * np.array([np.cos(angle), np.sin(angle)])
    return task.dynamics.space.add(state, change)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments that such benchmarks share."""
    parser.add_argument("--policy", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--push", type=float, default=0.0, help="change of velocity [m/s]")
    parser.add_argument("--every", type=float, default=2.0, help="between two pushes [s]")
    parser.add_argument("--horizon", type=float, default=0.5)
