"""Prints what the walker's demonstration does in 30 s, and what 45 iterations of DDP make of it."""

import numpy as np

from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import OptimizationRequest, optimize
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.tasks import make_task
from vgps_ros.tasks.simbicon import GAIT, walk

silence_mujoco()
task = make_task("walker")
walking = walk(task.dynamics, GAIT, round(30.0 / task.dynamics.time_step))
x, hips, pitch = (walking.states[:, i] for i in (0, 1, 2))
print(
    f"demonstration, 30 s: fell {bool(task.fallen(walking.states).any())}, "
    f"{(x[-1] - x[0]) / 30.0:.3f} m/s, hips at least {hips.min():.3f} m, "
    f"pitch at most {np.abs(pitch).max():.3f} rad"
)

steps = search_settings(task).initial_ddp_iterations
request = OptimizationRequest(0, 0, 0, 1.0, steps, task.initial_state)
result = optimize(task, request)
demonstrated = task.trajectory_cost(task.demonstration.first(task.horizon)) / task.horizon
optimised = result.cost / task.horizon
states = result.distribution.mean.first(task.horizon).states
print(
    f"DDP, {len(result.iterations)} iterations: cost per step {demonstrated:.4f} to "
    f"{optimised:.4f} ({100 * optimised / demonstrated:.1f} %), "
    f"hips at least {states[:, 1].min():.3f} m, pitch at most {np.abs(states[:, 2]).max():.3f} rad"
)
