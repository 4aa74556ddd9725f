# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The quadruped that is shipped stands where nothing is commanded, and steps where it must."""

from pathlib import Path

import numpy as np
import pytest

from vgps_ros.storage.run_folder import load_policy
from vgps_ros.tasks import make_task, registry
from vgps_ros.tasks.disturbance import DisturbanceSettings
from vgps_ros.tasks.disturbed_task import disturb_task, draw_disturbance

STEPS = 450  # of 0.02 s
JOINTS = slice(-12, None)  # velocities in a state
PUSHES = 12


@pytest.fixture(scope="module")
def quadruped():
    return make_task("quadruped")


def driven(task, size, seed):
    """The states of a rollout at rest with a push of a size [N*s] in the first second, (T, n_x)."""
    policy, _ = load_policy(Path(registry.__file__).parent / "quadruped" / "policy.json")
    rng, signals = np.random.default_rng(seed), task.signals
    push = draw_disturbance(task, DisturbanceSettings(push=size, push_before=1.0), rng)
    commands, phases = np.zeros((1, STEPS, 3)), signals.phases(STEPS, rng.uniform())[None]
    here = disturb_task(task, push)
    (states,), _ = here.dynamics.execute(
        policy,
        here.observation.within(signals.turning.context(commands, phases)),
        task.initial_state[None],
        np.zeros((1, STEPS, 12)),
        unrest=task.unrest,
        calm=signals.context(commands, phases),
    )
    return states


def test_it_stands_still_and_goes_nowhere(quadruped):
    states = driven(quadruped, 0.0, 0)
    assert np.abs(states[100:, JOINTS]).max() < 0.05  # [rad/s]
    assert np.abs(states[-1, :2] - states[100, :2]).max() < 0.01  # [m]


def test_a_small_push_makes_it_take_no_step(quadruped):
    for seed in range(4):
        assert not quadruped.unrest.restless(driven(quadruped, 4.0, seed)).any()


def test_it_steps_after_a_push_and_stands_still_again(quadruped):
    """Of pushes of 20 N*s, which it bears while it steps, a clock that stays still bears few."""
    motions = [driven(quadruped, 20.0, seed) for seed in range(PUSHES)]
    assert all(quadruped.unrest.restless(states).any() for states in motions)
    stands = [
        not quadruped.fallen(states).any() and np.abs(states[-75:, JOINTS]).max() < 0.3
        for states in motions
    ]
    assert sum(stands) >= PUSHES - 1
