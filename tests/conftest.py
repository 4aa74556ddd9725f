"""Fixtures that all unit tests share."""

import dataclasses
import signal

import numpy as np
import pytest
from hypothesis import settings

from vgps_ros.tasks import Task, make_task

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
    guess = swimmer.guess
    return dataclasses.replace(swimmer, horizon=40, guess=lambda rng: guess(rng)[:40])


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
