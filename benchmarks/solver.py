# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmarks of trajectory optimisation."""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import cache, partial
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from benchmarks.problems import (
    OTHERS,
    TASKS,
    linear_quadratic,
    moving,
    optimize,
    standing,
    with_threads,
)
from benchmarks.timing import Comparison, compare, seconds
from vgps_ros.core.ddp.backward_pass import backward_pass
from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.records import Array, CostExpansion, LinearDynamics, Trajectory
from vgps_ros.search.mpc import MpcSettings, Planner
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.packages import package_folders
from vgps_ros.tasks import Task, make_task

SIZES = ((10, 2, 500), (18, 6, 460))
ROBOTS = ("swimmer", "walker", "quadruped", "hopper", "half_cheetah", "arm")
_PLANS = 50
CLOSE = 1.01  # a trajectory has converged whose cost is within 1 % of the last one


_FIRST_SOLVE = """
import sys, time
from benchmarks.problems import optimize
from vgps_ros.tasks import make_task
task = make_task("swimmer")
began = time.perf_counter()
optimize(task, 1)
print(time.perf_counter() - began)
"""


_WIDTH = 1e-6


class CentredDynamics(Dynamics):
    """The same dynamics, differentiated at every step by `mjd_transitionFD`, centred."""

    is_centred = True

    def linearize(
        self, trajectory: Trajectory, *, centred: bool = True
    ) -> tuple[LinearDynamics, int]:
        """Returns f_x, f_u along a trajectory, and how many simulator steps they took."""
        assert centred
        horizon, n_dx, n_u = trajectory.horizon, self.space.tangent_dim, self.control_dim
        f_x, f_u = np.tile(np.eye(n_dx), (horizon, 1, 1)), np.zeros((horizon, n_dx, n_u))
        a, b = np.empty((n_dx, n_dx)), np.empty((n_dx, n_u))
        data, ends = mujoco.MjData(self.model), [self.model.nq, self.model.nq + self.model.nv]
        for t in range(horizon):
            data.qpos[:], data.qvel[:], data.act[:] = np.split(trajectory.states[t], ends)
            data.ctrl[:] = trajectory.controls[t]
            data.qacc_warmstart[:] = 0.0
            for substep in range(self.substeps):
                if substep:
                    mujoco.mj_step(self.model, data)
                mujoco.mjd_transitionFD(self.model, data, _WIDTH, self.is_centred, a, b, None, None)
                f_x[t], f_u[t] = a @ f_x[t], a @ f_u[t] + b
        return LinearDynamics(f_x, f_u), horizon * self.substeps * (
            (1 + self.is_centred) * (n_dx + n_u) + 1
        )


class ForwardDynamics(CentredDynamics):
    """The same by forward differences, which take half as many steps and err more."""

    is_centred = False


def compilation() -> Iterator[Comparison]:
    """The first solve of a process with the machine code of an earlier one, against without."""
    with TemporaryDirectory() as cache:
        first, second = (
            float(
                subprocess.run(
                    [sys.executable, "-c", _FIRST_SOLVE],
                    env={**os.environ, "NUMBA_CACHE_DIR": cache},
                    capture_output=True,
                    text=True,
                    check=True,
                ).stdout
            )
            for _ in range(2)
        )
    yield Comparison(
        "first solve of a process, compiled before / compiled now", 1e3 * second, 1e3 * first, None
    )


def backward_passes() -> Iterator[Comparison]:
    """One backward pass against crocoddyl's, on the same linear-quadratic data."""
    for n_x, n_u, horizon in SIZES:
        dynamics, cost = linear_quadratic(n_x, n_u, horizon)
        peer = _crocoddyl(dynamics, cost)
        ours = backward_pass(dynamics, cost)
        peer.backwardPass()
        np.testing.assert_allclose(-np.array(peer.K), ours.gains, rtol=0, atol=1e-6)
        yield compare(
            f"backward pass ({n_x}, {n_u}, {horizon}) / crocoddyl's",
            partial(backward_pass, dynamics, cost),
            peer.backwardPass,
            0.8,
            repetitions=51,
        )


def _crocoddyl(dynamics: LinearDynamics, cost: CostExpansion):  # type: ignore[no-untyped-def]
    """Returns crocoddyl's solver, all derivatives computed, on the same problem."""
    import crocoddyl

    n_x = dynamics.f_x.shape[1]
    steps = zip(
        dynamics.f_x, dynamics.f_u, cost.c_xx, cost.c_uu, cost.c_ux, cost.c_x, cost.c_u, strict=True
    )
    models = [
        crocoddyl.ActionModelLQR(a, b, q, r, n.T, np.zeros(n_x), c_x, c_u)
        for a, b, q, r, n, c_x, c_u in steps
    ]
    end = crocoddyl.ActionModelLQR(
        dynamics.f_x[0], dynamics.f_u[0], 0 * cost.c_xx[0], cost.c_uu[0], 0 * cost.c_ux[0].T,
        np.zeros(n_x), np.zeros(n_x), cost.c_u[0],
    )  # fmt: skip
    solver = crocoddyl.SolverDDP(crocoddyl.ShootingProblem(np.zeros(n_x), models, end))
    controls = [np.zeros(dynamics.f_u.shape[2]) for _ in models]
    solver.setCandidate(solver.problem.rollout(controls), controls, True)
    solver.preg = solver.dreg = 0.0
    solver.computeDirection(True)
    return solver


def ddp_iteration() -> Iterator[Comparison]:
    """One iteration on one thread against the simulator steps that centred differences need."""
    for name in TASKS:
        task, motion = moving(name)
        single = with_threads(task, 1)
        n_dx, n_u = single.dims["n_dx"], single.dims["n_u"]
        steps = motion.horizon * (2 * (n_dx + n_u) + 2)
        settings = task.optimizer.ddp
        linear, _ = single.dynamics.linearize(motion)
        gains = np.zeros((motion.horizon, n_u, n_dx))

        def iterate(task=single, motion=motion, linear=linear, settings=settings) -> None:  # type: ignore[no-untyped-def]
            solve(task.dynamics, task.cost, motion, settings, 1, linear_dynamics=linear)

        def floor(task=single, motion=motion, gains=gains, steps=steps) -> None:  # type: ignore[no-untyped-def]
            for _ in range(steps // motion.horizon):
                next(iter(task.dynamics.follow_each(motion.states[0], [motion], gains)))

        yield compare(
            f"{name}: DDP iteration, one thread / simulator steps of centred differences",
            iterate,
            floor,
            1.15,
            remark=f"floor: {steps * task.dynamics.substeps} steps",
        )


def derivatives() -> Iterator[Comparison]:
    """Derivatives on one thread against two."""
    for name in TASKS:
        one, motion = _single(name)
        two = with_threads(make_task(name), 2).dynamics
        yield compare(
            f"{name}: derivatives, two threads / one",
            partial(two.linearize, motion),
            partial(one.linearize, motion),
            1 / 1.7,
            repetitions=41,
        )


def derivatives_by_robot() -> Iterator[Comparison]:
    """Derivatives on one thread against MuJoCo's plain differences, with the errors of both."""
    robots = {name: partial(_single, name) for name in ROBOTS}
    robots |= {
        name: partial(standing, *where)
        for name, where in OTHERS.items()
        if package_folders(where[0])
    }
    for name, make in robots.items():
        ours, motion = make()
        centred, forward = (
            kind(ours.model, ours.substeps, threads=1)
            for kind in (CentredDynamics, ForwardDynamics)
        )
        exact = centred.linearize(motion)[0]
        errors = [_error(each.linearize(motion)[0], exact) for each in (ours, forward)]
        for peer, kind in ((centred, "centred"), (forward, "forward")):
            yield compare(
                f"{name}: derivatives, one thread / mjd_transitionFD, {kind}",
                partial(ours.linearize, motion),
                partial(peer.linearize, motion),
                None,
                remark=f"error {errors[0]}, forward differences' {errors[1]}",
            )


@cache
def _single(name: str) -> tuple[Dynamics, Trajectory]:
    """Returns a task's dynamics for one thread, and a motion of it."""
    task, motion = moving(name)
    return with_threads(task, 1).dynamics, motion


def _error(found: LinearDynamics, expected: LinearDynamics) -> str:
    """Says how far derivatives are from others, relative to the largest entry of a step."""
    errors: Array = np.maximum.reduce(
        [
            np.abs(a - b).max(axis=(1, 2)) / np.abs(expected.f_x).max(axis=(1, 2))
            for a, b in ((found.f_x, expected.f_x), (found.f_u, expected.f_u))
        ]
    )
    median, most, worst = np.quantile(errors, [0.5, 0.9, 1.0])
    return f"{median:.1e} (median over steps), {most:.1e} (90 %), {worst:.1e} (worst)"


def plans() -> Iterator[Comparison]:
    """Plans of half a second that mpc makes in a second, without a graph, against 100."""
    for name in ("quadruped", *reversed(TASKS)):
        task = make_task(name)
        planner = Planner(task, MpcSettings())
        plan = planner.first_plan()
        states = plan.trajectory.states

        def next_plan(planner=planner, plan=plan, states=states) -> None:  # type: ignore[no-untyped-def]
            planner.next_plan(plan, states[2], 2)

        next_plan()
        took = statistics.median(seconds(next_plan) for _ in range(_PLANS))
        yield Comparison(f"{name}: plans a second / 100", 1.0 / took, 100.0, 1.0, unit="/s")


def convergence() -> Iterator[Comparison]:
    """Time to a cost within 1 % of the final one, against plain centred differences."""
    for name in TASKS:
        task = make_task(name)
        for threads, target in ((1, 0.6), (2, 0.35)):
            pairs = [
                [_until_converged(with_threads(task, n, kind)) for n, kind in runs]
                for runs in 3 * [((threads, type(task.dynamics)), (1, CentredDynamics))]
            ]
            (ours, cost), (peer, peer_cost) = (min(column) for column in zip(*pairs, strict=True))
            yield Comparison(
                f"{name}: to a converged trajectory, {threads} threads / plain centred, one thread",
                1e3 * ours,
                1e3 * peer,
                target,
                remark=f"final cost {cost:.2f}, the peer's {peer_cost:.2f}",
            )


def _until_converged(task: Task) -> tuple[float, float]:
    """Returns the seconds until the cost stays close to the last one, and that one."""
    times: list[tuple[float, float]] = []
    began = time.perf_counter()
    result = optimize(task, on_iteration=lambda i: times.append((time.perf_counter(), i.cost)))
    reached = next(t for t, cost in times if cost <= CLOSE * result.modified_cost)
    return reached - began, result.cost
