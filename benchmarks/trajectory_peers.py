# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmark of whole solves against crocoddyl's, on problems that are alike to the last digits.

The robots are those of two tasks, without damping, limits of joints and contact: then MuJoCo's
Euler steps are the symplectic ones of crocoddyl, whose forward dynamics come from pinocchio with
analytic derivatives. The cost is quadratic in states and controls, and the last step has a larger
weight. Crocoddyl actuates each joint, so a joint without a motor gets one there that costs so much
that it is not used.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np

from benchmarks.problems import SEED
from benchmarks.timing import Comparison, compare, seconds
from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.ddp.solve import solve
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import control_range, state_names
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks import make_task
from vgps_ros.tasks.first_motion import smoothed_noise

_MOST = 300  # iterations
_CLOSE = 1.001  # a solve is done when its cost is within .1 % of the higher one of both ends
_LIMITS = {"cart_pole": 6.0, "arm": 45.0}  # [N], [N·m]: they hold in part of each motion
_PERIOD = 0.02  # [s]
_UNUSED = 1e6  # weight of the control of a joint that has no motor
_LAST = 100.0  # weight of the last state, as a multiple of that of others


@dataclass(frozen=True)
class Shared:
    """A control problem in both forms.

    Attributes:
        dynamics: x' = f(x, u), on one thread.
        cost: c(x, u).
        start: the motion from which both start.
        peer: crocoddyl's form of it.
    """

    dynamics: Dynamics
    cost: FeatureCost
    start: Trajectory
    peer: Any


@dataclass(frozen=True)
class _Weights:
    """Goal and weights of a state, shapes (n_x,), and the weight of controls, shape (n_u,)."""

    start: Array
    goal: Array
    states: Array
    controls: Array


def cart_pole(*, limit: float | None = None) -> Shared:
    """A pole that hangs is swung up; the force may be limited [N]."""
    weights = _Weights(
        start=np.array([0.0, np.pi, 0.0, 0.0]),
        goal=np.zeros(4),
        states=np.array([0.1, 1.0, 0.01, 0.01]),
        controls=np.array([5e-3]),
    )
    return _shared("cart_pole", weights, 150, 1.0, limit)


def arm(*, limit: float | None = None) -> Shared:
    """An arm that hangs against gravity moves to a pose; torques may be limited [N·m]."""
    pose = np.array([0.6, 0.8, -0.4, 1.0, 0.3, 0.5, 0.0])
    weights = _Weights(
        start=np.r_[0.0, 0.4, 0.0, 0.8, 0.0, 0.6, 0.0, np.zeros(7)],
        goal=np.r_[pose, np.zeros(7)],
        states=np.r_[np.full(7, 1.0), np.full(7, 0.01)],
        controls=np.full(7, 1e-4),
    )
    return _shared("arm", weights, 100, 0.1, limit)


def _shared(
    name: str, weights: _Weights, horizon: int, noise: float, limit: float | None
) -> Shared:
    model = _plain(make_task(name).dynamics.model, limit)
    dynamics = Dynamics(model, threads=1)
    importance = np.ones((horizon, 1))
    importance[-1] = _LAST
    cost = FeatureCost(
        features=Readings(dynamics.simulations, state_names(model)),
        targets=weights.goal,
        weights=importance * weights.states,
        smooth=np.zeros(len(weights.goal)),
        control_weights=weights.controls,
    )
    rng = np.random.default_rng(SEED)
    controls = smoothed_noise(rng, (horizon, model.nu), noise, 15.0) + _holding(
        model, weights.start
    )
    start = dynamics.rollout(weights.start, lambda t, _: controls[t], horizon)
    return Shared(dynamics, cost, start, _peer(model, weights, horizon))


def _holding(model: mujoco.MjModel, state: Array) -> Array:
    """Returns the controls that hold a state at rest, shape (n_u,), as far as motors can."""
    data = mujoco.MjData(model)
    data.qpos[:] = state[: model.nq]
    mujoco.mj_forward(model, data)
    held: Array = data.qfrc_bias[model.jnt_dofadr[model.actuator_trnid[:, 0]]].copy()
    return held


def _plain(model: mujoco.MjModel, limit: float | None) -> mujoco.MjModel:
    """Returns the model without what crocoddyl's dynamics lack."""
    model.dof_damping[:] = 0.0
    model.jnt_limited[:] = 0
    model.body_gravcomp[:] = 0.0
    model.opt.timestep = _PERIOD
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.actuator_ctrllimited[:] = limit is not None
    if limit is not None:
        model.actuator_ctrlrange[:] = [-limit, limit]
    return model


def _peer(model: mujoco.MjModel, weights: _Weights, horizon: int) -> Any:
    """Returns crocoddyl's problem."""
    import crocoddyl

    state = crocoddyl.StateMultibody(_pinocchio(model))
    actuation = crocoddyl.ActuationModelFull(state)
    driven = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    controls, low, high = np.full(model.nv, _UNUSED), np.zeros(model.nv), np.zeros(model.nv)
    controls[driven] = weights.controls
    low[driven], high[driven] = control_range(model)

    def node(period: float, importance: float) -> Any:
        costs = crocoddyl.CostModelSum(state, model.nv)
        for part, residual, share in (
            ("state", crocoddyl.ResidualModelState(state, weights.goal, model.nv),
             importance * weights.states),
            ("control", crocoddyl.ResidualModelControl(state, model.nv), controls),
        ):  # fmt: skip
            # Crocoddyl halves the squares, and multiplies a step's cost by its period.
            activation = crocoddyl.ActivationModelWeightedQuad(2 * share / _PERIOD)
            costs.addCost(part, crocoddyl.CostModelResidual(state, activation, residual), 1.0)
        motion = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, costs)
        motion.armature = np.array(model.dof_armature)
        step = crocoddyl.IntegratedActionModelEuler(motion, period)
        if model.actuator_ctrllimited.all():
            step.u_lb, step.u_ub = low, high
        return step

    end = node(_PERIOD, 0.0)
    end.differential.costs.removeCost("state")
    end.differential.costs.removeCost("control")
    steps = [node(_PERIOD, 1.0)] * (horizon - 1) + [node(_PERIOD, _LAST)]
    problem = crocoddyl.ShootingProblem(weights.start, steps, end)
    problem.nthreads = 1
    return problem


def _pinocchio(model: mujoco.MjModel) -> Any:
    """Returns the same bodies and joints for pinocchio; each body has one hinge or slide."""
    import pinocchio

    found = pinocchio.Model()
    found.gravity.linear = np.array(model.opt.gravity)
    joints = {0: 0}  # of each body
    for body in range(1, model.nbody):
        joint = int(model.body_jntadr[body])
        axis = model.jnt_axis[joint]
        is_slide = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        kind = (
            pinocchio.JointModelPrismaticUnaligned
            if is_slide
            else pinocchio.JointModelRevoluteUnaligned
        )
        place = pinocchio.SE3(_rotation(model.body_quat[body]), np.array(model.body_pos[body]))
        parent = joints[int(model.body_parentid[body])]
        joints[body] = found.addJoint(parent, kind(np.array(axis)), place, model.joint(joint).name)
        turned = _rotation(model.body_iquat[body])
        inertia = turned @ np.diag(model.body_inertia[body]) @ turned.T
        solid = pinocchio.Inertia(
            float(model.body_mass[body]), np.array(model.body_ipos[body]), inertia
        )
        found.appendBodyToJoint(joints[body], solid, pinocchio.SE3.Identity())
    return found


def _rotation(quaternion: Array) -> Array:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def trajectory_peers() -> Iterator[Comparison]:
    """Time to equal cost, on one thread, with and without limits of the controls."""
    for name, problem in (("cart_pole", cart_pole), ("arm", arm)):
        for limit, peer in ((None, "FDDP"), (_LIMITS[name], "BoxFDDP")):
            shared = problem(limit=limit)
            ours, theirs = _our_costs(shared, _MOST), _their_costs(shared, peer, _MOST)
            goal = _CLOSE * max(ours[-1], theirs[-1])
            n, m = (int(np.argmax(np.array(costs) <= goal)) + 1 for costs in (ours, theirs))

            def mine(shared: Shared = shared, n: int = n) -> None:
                _our_costs(shared, n)

            def its(shared: Shared = shared, peer: str = peer, m: int = m) -> None:
                _their_costs(shared, peer, m)

            row = compare(
                f"{name}: solve to equal cost, one thread / crocoddyl's {peer}", mine, its, 0.8
            )
            a, b = (1e3 * n * each for each in _derivatives(shared))
            yield replace(
                row,
                remark=f"{n} iterations against {m}; ends {ours[-1]:.4g} and {theirs[-1]:.4g}; "
                f"f_x and f_u take {a:.3g} ms of ours, and would take {b:.3g} ms by pinocchio: "
                f"then {(row.ours - a + b) / row.peer:.2f}",
            )


def _derivatives(shared: Shared) -> tuple[float, float]:
    """Returns how long derivatives along a motion take us, and crocoddyl with the cost's [s]."""
    motion, problem = shared.start, shared.peer
    states, controls = list(motion.states), list(_all_controls(shared))
    problem.calc(states, controls)
    own, other = (
        min(seconds(work) for _ in range(31))
        for work in (
            partial(shared.dynamics.linearize, motion),
            partial(problem.calcDiff, states, controls),
        )
    )
    return own, other


def _all_controls(shared: Shared) -> Array:
    """Returns the start's controls with those of the joints that have no motor."""
    controls = np.zeros((shared.start.horizon, shared.peer.runningModels[0].nu))
    controls[:, : shared.dynamics.control_dim] = shared.start.controls
    return controls


def _our_costs(shared: Shared, iterations: int) -> list[float]:
    """Returns the cost after each iteration."""
    solution = solve(shared.dynamics, shared.cost, shared.start, DdpSettings(), iterations)
    return [iteration.cost for iteration in solution.iterations]


def _their_costs(shared: Shared, solver: str, iterations: int) -> list[float]:
    """Returns the cost after each iteration of one of crocoddyl's solvers."""
    import crocoddyl

    found: Any = getattr(crocoddyl, f"Solver{solver}")(shared.peer)
    logger = crocoddyl.CallbackLogger()
    found.setCallbacks([logger])
    found.solve(list(shared.start.states), list(_all_controls(shared)), iterations, True)
    return [float(cost) for cost in logger.costs]
