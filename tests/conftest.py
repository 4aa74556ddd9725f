# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Fixtures that all unit tests share."""

import dataclasses
import os
import signal
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from vgps_ros.core.dynamics import StateSpace
from vgps_ros.core.observation import Observation
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import LinearDynamics, Trajectory, TrajectoryDistribution
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.tasks import Task, make_task

silence_mujoco()

# In a workspace `colcon test` runs the tests that need no processes of this checkout.
ROOT = Path(__file__).parents[1]
NEED_PROCESSES = ["nodes", "benchmarks", "programs/test_command.py", "docs/test_commands.py"]
collect_ignore = [] if (ROOT / "install" / "vgps_ros").is_dir() else NEED_PROCESSES

# The same examples in every run, and no database beside the tests.
settings.register_profile("vgps", derandomize=True, deadline=None, database=None, max_examples=50)
settings.load_profile("vgps")

# A run in the background of a script ignores INT, and programs that tests start would, too.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20131205)


@pytest.fixture(scope="session")
def swimmer() -> Task:
    return make_task("swimmer")


@pytest.fixture(scope="session")
def short_swimmer(swimmer: Task) -> Task:
    """The swimmer over 40 steps, 0.8 s."""
    return dataclasses.replace(swimmer, horizon=40)


@pytest.fixture(scope="session")
def finite_differences():
    """Returns a function that differentiates f at x by centred differences: (*f(x), *x)."""

    def differentiate(f, x, eps=1e-6):
        x = np.asarray(x, dtype=float)
        columns = []
        for i in range(x.size):
            step = np.zeros(x.size)
            step[i] = eps
            step = step.reshape(x.shape)
            columns.append((np.asarray(f(x + step)) - np.asarray(f(x - step))) / (2 * eps))
        derivative = np.stack(columns, axis=-1)
        return derivative.reshape(*derivative.shape[:-1], *x.shape)

    return differentiate


def _covariances(rng, count, n):
    roots = rng.standard_normal((count, n, n + 1))
    return roots @ np.swapaxes(roots, 1, 2) / n


@pytest.fixture
def random_covariances(rng):
    return lambda count, n: _covariances(rng, count, n)


@dataclass(frozen=True)
class Coordinates:
    """Reads some coordinates of a state that has no quaternion: readings without MuJoCo."""

    space: StateSpace
    indices: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"x{i}" for i in self.indices)

    def __call__(self, states):
        return states[..., self.indices]

    def pull_back(self, jacobians, states):
        return jacobians @ np.eye(self.space.state_dim)[list(self.indices)]


@pytest.fixture(scope="session")
def coordinates():
    """Returns a function that makes an observation of coordinates of states of four numbers."""
    return lambda *indices, n_x=4: Observation(Coordinates(StateSpace(n_x), indices))


@pytest.fixture
def random_policy(rng):
    """Returns a function that draws a policy of a given shape."""

    def make(observed=("x0", "x2", "x3"), hidden_units=(5,), control_dim=2, **options):
        architecture = Architecture(observed, hidden_units, control_dim, **options)
        parameters = rng.standard_normal(architecture.num_parameters)
        return GaussianPolicy(architecture, parameters, rng.uniform(0.5, 2.0, control_dim))

    return make


@pytest.fixture
def random_distribution(rng):
    """Returns a function that draws q(ζ) with unrelated, well-conditioned parts."""

    def make(horizon=6, n_x=4, n_u=2) -> TrajectoryDistribution:
        return TrajectoryDistribution(
            mean=Trajectory(
                rng.standard_normal((horizon + 1, n_x)), rng.standard_normal((horizon, n_u))
            ),
            gains=rng.standard_normal((horizon, n_u, n_x)),
            control_covariances=_covariances(rng, horizon, n_u),
            linear_dynamics=LinearDynamics(
                0.5 * rng.standard_normal((horizon, n_x, n_x)),
                rng.standard_normal((horizon, n_x, n_u)),
            ),
            state_covariances=_covariances(rng, horizon + 1, n_x),
            context=np.empty((horizon, 0)),
        )

    return make


@pytest.fixture
def gate(monkeypatch):
    """A disk that takes nothing until the gate is opened."""
    gate, write = threading.Event(), os.pwrite

    def slow(*arguments) -> int:
        gate.wait()
        return write(*arguments)

    monkeypatch.setattr(os, "pwrite", slow)
    gate.set()
    yield gate
    gate.set()
