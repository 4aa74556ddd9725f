# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Short trainings learn their tasks: near DDP's cost, and for longer than they were trained."""

import dataclasses

import numpy as np
import pytest

from tests.learning.gates import GATES, converged_cost, score, settings_of, task_of, train

LONG = {"hopper", "swimmer"}  # about a minute of processor time each


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in GATES]
)
def test_a_short_training_learns_its_task(name, seed):
    gate, task, converged = GATES[name], task_of(name), converged_cost(name, seed)
    *_, last = train(task, settings_of(name, task), seed)

    def failures(policy):
        return score(name, task, last, policy, converged).failures(gate)

    assert failures(last.policy) == []
    # The gate can fail: it lets through no policy that does nothing.
    idle = np.zeros_like(last.policy.parameters)
    assert failures(dataclasses.replace(last.policy, parameters=idle))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name, gate in GATES.items() for seed in gate.converged]
)
def test_the_cost_that_is_stated_is_that_of_converged_ddp(name, seed):
    found = converged_cost(name, seed, anew=True)
    assert found == pytest.approx(GATES[name].converged[seed], rel=0.02)
