# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Control problems that benchmarks share."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from vgps_ros.core.ddp.solve import Iteration
from vgps_ros.core.records import CostExpansion, LinearDynamics, Trajectory
from vgps_ros.search import trajectory_optimization
from vgps_ros.search.optimization_request import OptimizationRequest, first_request
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import OptimizationResult
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.packages import package_folders
from vgps_ros.tasks import Task, make_task
from vgps_ros.tasks.disturbed_task import on_dynamics

SEED = 11
TASKS = ("swimmer", "walker")
# Robots that packages of others bring (`requirements/robots.txt`), by package and file.
OTHERS = {
    "Go1": ("mjlab", "asset_zoo/robots/unitree_go1/xmls/go1.xml"),
    "G1, 29 joints": ("mjlab", "asset_zoo/robots/unitree_g1/xmls/g1.xml"),
    "humanoid": ("gymnasium", "envs/mujoco/assets/humanoid.xml"),
}
_OPTIONS = {
    **{"timestep": 0.004, "iterations": 100, "ls_iterations": 50, "tolerance": 1e-10},
    "integrator": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "solver": mujoco.mjtSolver.mjSOL_NEWTON,
}


def with_threads(task: Task, threads: int, kind: type[Dynamics] = Dynamics) -> Task:
    """Returns the task with other dynamics of the same model."""
    like = task.dynamics
    return on_dynamics(task, kind(like.model, like.substeps, threads=threads))


def initial_request(task: Task, iterations: int | None = None) -> OptimizationRequest:
    """Returns the first solve of a search; without a number, with all its iterations."""
    steps = iterations or search_settings(task).initial_ddp_iterations
    return first_request(task, SEED, steps)


def optimize(
    task: Task,
    iterations: int | None = None,
    on_iteration: Callable[[Iteration], None] = lambda _: None,
) -> OptimizationResult:
    """Does the first solve of a search."""
    return trajectory_optimization.optimize(task, initial_request(task, iterations), on_iteration)


def moving(name: str) -> tuple[Task, Trajectory]:
    """Returns a task and a motion that a few iterations have found."""
    task = make_task(name)
    return task, optimize(task, 5).distribution.mean


def standing(package: str, file: str) -> tuple[Dynamics, Trajectory]:
    """Returns a robot of others, and 40 steps in which it stands on a floor with noisy motors.

    Joints of a robot that brings no motors get servos.
    """
    spec = mujoco.MjSpec.from_file(str(package_folders(package)[0] / file))
    if not any(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.geoms):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
    if not spec.actuators:
        for joint in spec.joints:
            if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
                spec.add_actuator(name=joint.name, target=joint.name).set_to_position(kp=60, kv=2)
                spec.actuators[-1].trntype = mujoco.mjtTrn.mjTRN_JOINT
    for name, value in _OPTIONS.items():
        setattr(spec.option, name, value)
    model = spec.compile()
    data, dynamics = mujoco.MjData(model), Dynamics(model, threads=1)
    mujoco.mj_forward(model, data)
    while not data.ncon:
        data.qpos[2] -= 0.001
        mujoco.mj_forward(model, data)
    low, high = dynamics.control_limits
    held = np.zeros(model.nu)
    for i, (joint, _) in enumerate(model.actuator_trnid):
        if model.actuator_biasprm[i, 1] < 0.0:
            held[i] = data.qpos[model.jnt_qposadr[joint]]
    noise = np.random.default_rng(SEED).normal(0.0, 0.05, (40, model.nu))
    start = np.r_[data.qpos, data.qvel, data.act]
    return dynamics, dynamics.rollout(start, lambda t, _: np.clip(held + noise[t], low, high), 40)


_CHAIN = """
model: chain.xml
control_period: 0.02
horizon: 2.0
start: {std: {position: 0.05, velocity: 0.05}}
sensors:
  end: {type: framepos, body: link}
cost:
  - {sensor: end, index: z, target: 0.1, weight: 100.0}
  - {control: all, weight: 0.01}
begin: {law: noise, std: 0.1}
"""


def chain(links: int) -> Task:
    """Returns a chain that hangs by one hinge and has a motor in each; n_dx is twice its links."""
    body = (
        '<body{} pos="{} 0 0"><joint name="hinge{}" axis="0 1 0" damping="0.1"/>'
        '<geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.02" contype="0" conaffinity="0"/>'
    )
    bodies = "".join(
        body.format(' name="link"' if i == links - 1 else "", 0.1 if i else 0, i)
        for i in range(links)
    )
    motors = "".join(f'<motor name="motor{i}" joint="hinge{i}"/>' for i in range(links))
    mjcf = (
        '<mujoco><option timestep="0.02" gravity="9.81 0 0" integrator="implicitfast"/><worldbody>'
        f"{bodies}{'</body>' * links}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    with TemporaryDirectory() as folder:
        Path(folder, "chain.xml").write_text(mjcf)
        Path(folder, "task.yaml").write_text(_CHAIN)
        return make_task(str(Path(folder, "task.yaml")))


def linear_quadratic(n_x: int, n_u: int, horizon: int) -> tuple[LinearDynamics, CostExpansion]:
    """Draws a stable linear-quadratic problem of a size."""
    rng = np.random.default_rng(SEED)
    f_x = 0.9 * np.eye(n_x) + 0.05 * rng.standard_normal((horizon, n_x, n_x))
    f_u = rng.standard_normal((horizon, n_x, n_u))
    return LinearDynamics(f_x, f_u), CostExpansion(
        c=np.zeros(horizon),
        c_x=rng.standard_normal((horizon, n_x)),
        c_u=rng.standard_normal((horizon, n_u)),
        c_xx=np.tile(np.eye(n_x), (horizon, 1, 1)),
        c_uu=np.tile(np.eye(n_u), (horizon, 1, 1)),
        c_ux=0.1 * rng.standard_normal((horizon, n_u, n_x)),
    )
