# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Short trainings learn their tasks: near DDP's cost, and for longer than they were trained."""

import dataclasses

import numpy as np
import pytest

from tests.learning.gates import GATES, converged_cost, score, settings_of, task_of, train


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", GATES)
def test_a_short_training_learns_its_task(name, seed):
    gate, task = GATES[name], task_of(name)
    last = train(task, settings_of(name, task), seed)[-1]
    converged = converged_cost(name, seed)
    assert score(name, task, last, last.policy, converged).failures(gate) == []
    # The gate can fail: it does not let through a policy that does nothing.
    idle = dataclasses.replace(last.policy, parameters=np.zeros_like(last.policy.parameters))
    assert score(name, task, last, idle, converged).failures(gate)


@pytest.mark.parametrize("name", [name for name, gate in GATES.items() if gate.fails_at_first])
def test_one_iteration_is_not_enough(name):
    task = task_of(name)
    (first,) = train(task, dataclasses.replace(settings_of(name, task), iterations=1), 0)
    assert score(name, task, first, first.policy, converged_cost(name, 0)).failures(GATES[name])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name, gate in GATES.items() for seed in gate.converged]
)
def test_the_cost_that_is_stated_is_that_of_converged_ddp(name, seed):
    found = converged_cost(name, seed, anew=True)
    assert found == pytest.approx(GATES[name].converged[seed], rel=0.02)
