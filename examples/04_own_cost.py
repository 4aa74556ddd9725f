# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A cost of one's own: the arm reaches its target, but keeps its elbow straight while it does.

A cost is a sum of weights times norms of readings; a task is a record, so a changed one is a copy.
docs/reference/task_file.md has the same in YAML. A trained policy needs the task again:
`vgps train --task examples/04_own_cost.py:straight_arm`.

    python examples/04_own_cost.py
"""

from dataclasses import replace

import numpy as np

from vgps_ros.core.cost import FeatureCost
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.situations import Situation
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks import Task, make_task

WEIGHT = 20.0  # of the elbow's angle [1/rad²]


def straight_arm() -> Task:
    """Returns the built-in arm with one more term in its cost."""
    task = make_task("arm")
    elbow = f"{task.joint_names[3]}/position"
    names = (*task.cost_names, elbow)
    old = task.cost
    steps = (1,) if old.targets.ndim == 1 else (len(old.targets), 1)
    cost = FeatureCost(
        features=Readings(task.dynamics.simulations, names),
        targets=np.concatenate([old.targets, np.zeros(steps)], axis=-1),
        weights=np.concatenate([old.weights, np.full(steps, WEIGHT)], axis=-1),
        smooth=np.append(old.smooth, 0.0),
        control_weights=old.control_weights,
    )
    return replace(task, name="straight_arm", cost=cost)


def bent(task: Task) -> float:
    """Optimises a motion; returns how far its elbow is bent in the mean [rad]."""
    request = OptimizationRequest(
        trajectory_index=0, iteration=0, seed=0, cost_scale=1.0, max_iterations=40,
        situation=Situation.at_start(task),
    )  # fmt: skip
    states = optimize(task, request).distribution.mean.states
    return float(np.abs(states[:, 3]).mean())


if __name__ == "__main__":
    print(f"elbow of the built-in arm: {bent(make_task('arm')):.3f} rad")
    print(f"with the own cost:         {bent(straight_arm()):.3f} rad")
