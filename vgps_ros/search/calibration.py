# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Calibrates the commands of a policy, so that its mean speed is the one that is commanded.

The policy was taught by motions that keep the commanded speed, but its small errors add up to
another one, and one that reads no velocity cannot tell. So at the end of a training it is rolled
out on its model under each command c of a grid, and a line is fitted to what it reaches, r:

    r ≈ (I + E) c + b.

The policy then reads c' = (I + E)⁻¹ (c − b) where c is commanded. That is a linear map, which joins
the first layer of the network, so that whoever runs the policy has nothing more to do. Of a policy
that does less than half of what it is told no more than half is made good in one pass, since far
beyond the commands that it has learned nobody knows what it does.
"""

from dataclasses import replace

import numpy as np

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search.judgement import (
    CALIBRATION,
    LATE,
    SETTLING,
    CommandReadings,
    Trial,
    behaviour,
    command_grid,
    first_phases,
)
from vgps_ros.tasks import Task

_ROLLOUTS = 2  # at each command of the grid
_SECONDS = SETTLING + 2.0 * LATE
_PASSES = 2  # since what is reached is not quite linear
_LEAST = 0.5  # share of the rollouts that must stay up, since the others tell nothing
_LARGEST = 0.5  # of the singular values of E that a pass makes good


def calibrate(task: Task, seed: int, policy: GaussianPolicy) -> GaussianPolicy:
    """Returns the policy with calibrated commands; itself where that cannot be done.

    That is where no reading achieves a command, where the first layer has no bias, or where the
    policy falls.
    """
    columns = _columns(task, policy)
    if not (columns and policy.architecture.biased[0]):
        return policy
    for _ in range(_PASSES):
        found = _errors(task, seed, policy)
        if found is None:
            return policy
        policy = _with_commands(policy, columns, *found)
    return policy


def _columns(task: Task, policy: GaussianPolicy) -> list[int]:
    """Returns where the policy reads the commands that a reading achieves; empty if it does not."""
    names = [task.signals.names[i] for i in CommandReadings.of(task).commands]
    observed = policy.architecture.observed
    return [observed.index(name) for name in names] if {*names} <= {*observed} else []


def _errors(task: Task, seed: int, policy: GaussianPolicy) -> tuple[Array, Array] | None:
    """Returns E (n_a, n_a) and b (n_a,) by least squares; None where the policy falls."""
    rng = generator(seed, Stream.JUDGEMENT, CALIBRATION)
    achieved = list(CommandReadings.of(task).commands)
    told = np.repeat(command_grid(task.signals), _ROLLOUTS, axis=0)
    count, steps = len(told), round(_SECONDS / task.dynamics.time_step)
    space = task.dynamics.space
    starts = task.initial_std * rng.standard_normal((count, space.tangent_dim))
    trial = Trial(
        space.add(task.initial_state, starts),
        np.repeat(told[:, None], steps, axis=1),
        np.zeros((count, steps, task.dynamics.control_dim)),
        phases=first_phases(count),
    )
    found = behaviour(task, Driver.of(task.observation, policy), trial, (_SECONDS,))
    up = found.up[:, -1]
    if up.mean() < _LEAST:
        return None
    regressors = np.column_stack([told[up][:, achieved], np.ones(up.sum())])
    line = np.linalg.lstsq(regressors, found.errors[up], rcond=None)[0]
    slopes, offset = line[:-1].T, line[-1]
    left, sizes, right = np.linalg.svd(slopes)
    if sizes[0] > _LARGEST:
        slopes = (left * np.minimum(sizes, _LARGEST)) @ right
    return slopes, offset


def _with_commands(
    policy: GaussianPolicy, columns: list[int], slopes: Array, offset: Array
) -> GaussianPolicy:
    """Returns the policy that does under the commands c what it did under (I + E)⁻¹ (c − b)."""
    parameters = policy.parameters.copy()
    weights, bias = policy.architecture.unpack(parameters)[0]  # views of the parameters
    inverse = np.linalg.inv(np.eye(len(columns)) + slopes)
    of_commands = weights[:, columns] @ inverse
    weights[:, columns] = of_commands
    bias -= of_commands @ offset
    return replace(policy, parameters=parameters)
