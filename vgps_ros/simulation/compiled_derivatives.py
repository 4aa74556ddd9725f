# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives of steps in a compiled loop, which calls MuJoCo's C functions without Python.

In a simulator step, all forces balance at the acceleration a = (v' − v)/h (before damping is
integrated implicitly), which MuJoCo searches by Newton's method:

    r(x, u, a) = M a − τ(x, u) − Jᵀ f(J a − a_ref) = 0.

Next to a point whose a is known, one step of that method finds the acceleration to first order,
with the inverse Hessian (∂r/∂a)⁻¹ of the point itself. So a difference needs no new search:

    for j in columns:
        moved = z ⊕ eps e_j
        a = a_0 − H⁻¹ (r(moved, a_0) − r_0)
        column[j] = (integrate(moved, a) ⊖ after) / eps

Velocities and controls need no difference of steps at all. At a given position r is linear in
them next to the point, and the new velocity is linear in a, so that

    ∂v'/∂v = 1 + K H⁻¹ (−∂r/∂v),    ∂v'/∂u = K H⁻¹ (−∂r/∂u),    K = ∂v'/∂a,

and new positions follow from new velocities. MuJoCo knows the derivatives of smooth forces by
velocities; those of the constraints' forces are differences of the forces alone.

Where all forces of a robot have derivatives by positions in closed form, too, as those of most
legged robots do, `compiled_closed_form` needs no differences at all.

Where a contact is about to open, close or slip, r has a kink at a_0 itself. The columns of ∂r/∂a
are then those of different contacts, and their inverse means nothing; since ∂r/∂a is symmetric away
from kinks, this is seen, and the neighbours of such a point are stepped in full.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compile_at_first_call, compiled_part
from vgps_ros.core.records import Array
from vgps_ros.simulation import mujoco_functions as mj
from vgps_ros.simulation.compiled_states import (
    NEVER,
    copy,
    get_state,
    move,
    push_at,
    put_state,
    subtract,
)

# Stages that a step may skip, because their results are still valid from the step before.
_NOTHING = np.int32(mujoco.mjtStage.mjSTAGE_NONE)
_OF_POSITIONS = np.int32(mujoco.mjtStage.mjSTAGE_POS)
_OF_VELOCITIES = np.int32(mujoco.mjtStage.mjSTAGE_VEL)
_KEPT = np.int32(1)  # of a factorisation that is still valid
# Difference of accelerations for ∂r/∂a [m/s², rad/s²]. In between its kinks, r is linear in a.
_ACCELERATION_EPS = 1e-3
# Difference of velocities for the constraints' forces [m/s, rad/s], which are linear in them, too:
# the stiffest contact turns it into a smaller acceleration than the one above.
_VELOCITY_EPS = 1e-6
_CONTROL_EPS = 1e-6  # of controls and activations, in which the motors' forces are linear, too
_ASYMMETRY = 1e-6  # of ∂r/∂a, at most, where r has no kink; rounding leaves 1e-10


class Balance(NamedTuple):
    """The balance of forces at a point, and memory to work in.

    Attributes:
        acceleration: a_0, shape (n_v,).
        residual: r_0, shape (n_v,).
        mass: M, shape (n_v, n_v).
        inverse_hessian: H⁻¹, shape (n_v, n_v).
        moved: memory for accelerations or forces.
        moved_residual: memory for the residual of a neighbour.
        is_pushed: whether constraints act, shape (1,).
        is_smooth: whether r has no kink at a_0, so that neighbours may be predicted, shape (1,).
    """

    acceleration: Array
    residual: Array
    mass: Array
    inverse_hessian: Array
    moved: Array
    moved_residual: Array
    is_pushed: NDArray[np.bool_]
    is_smooth: NDArray[np.bool_]


@compile_at_first_call
def differentiate(sim, columns, eps, kink, first, states, controls, f_x, f_u):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes f_x, f_u at N steps from the first on, by the chain rule over their simulator steps.

    Takes differences of width eps along the `columns` of (δx, u), of which positions alone are left
    where velocities and controls are known. Controls come first, positions last, so that the stages
    which a step skips stay valid. They are centred where a velocity is within `kink` of zero, and
    point inwards where a control is at its limit: beyond it nothing changes. Returns the number
    of simulator steps.
    """
    n_q, n_v, n_u = len(sim.qpos), len(sim.qvel), len(sim.ctrl)
    n_x, n_dx = states.shape[1], f_x.shape[1]
    z, moved, warm = np.empty(n_x + n_u), np.empty(n_x + n_u), np.empty(n_v)  # z = (x, u)
    after, plus, minus = np.empty(n_x), np.empty(n_x), np.empty(n_x)
    direction, column = np.zeros(n_v), np.empty(n_dx)
    square = np.empty((n_v, n_v)), np.empty((n_v, n_v))
    vectors = np.empty(n_v), np.empty(n_v), *square, np.empty(n_v), np.empty(n_v)
    flags = np.empty(2, np.bool_)
    balance = Balance(*vectors, flags[:1], flags[1:])
    rates, moves = np.empty((n_v, n_v)), np.empty((n_v, n_dx - n_v + n_u))
    a, b = np.eye(n_dx), np.empty((n_dx, n_u))  # the columns of cyclic positions stay as they are
    steps = 0
    for t in range(len(states)):
        copy(states[t], z[:n_x])
        copy(controls[t], z[n_x:])
        warm[:] = 0.0
        push_acts = push_at(sim, first + t)
        for substep in range(sim.substeps):
            step(sim, z, warm, _NOTHING, after)
            copy(sim.warmstart, warm)  # the constraint forces at the neighbours are close to these
            if sim.structure.may_predict and not push_acts:
                _find_balance(sim, balance)
            else:  # the balance of forces above has no push
                balance.is_smooth[0] = False
            known = 0  # columns at the front that need no differences of steps
            if sim.structure.knows_velocities and balance.is_smooth[0]:
                known = n_dx + n_u - n_v
                _differentiate_forces(sim, balance, z, after, rates, moves, a, b)
                _put_rates(sim, after, rates @ (balance.inverse_hessian @ moves), a, b)
            centred = _is_any_below(z[n_q : n_q + n_v], kink)
            for j in columns[known:]:
                skip = _OF_VELOCITIES if j >= 2 * n_v else _OF_POSITIONS if j >= n_v else _NOTHING
                width, is_centred = eps, centred
                if j >= n_dx:
                    u = j - n_dx
                    above, below = sim.high[u] - z[n_x + u], z[n_x + u] - sim.low[u]
                    is_centred = centred and min(above, below) >= eps
                    width = eps if above >= eps else -eps
                copy(z, moved)
                move(sim, moved, direction, j, width)
                _step_near(sim, balance, moved, warm, skip, plus)
                if is_centred:
                    copy(z, moved)
                    move(sim, moved, direction, j, -eps)
                    _step_near(sim, balance, moved, warm, skip, minus)
                    width = 2.0 * eps
                subtract(sim, plus, minus if is_centred else after, column)
                for i in range(n_dx):
                    if j < n_dx:
                        a[i, j] = column[i] / width
                    else:
                        b[i, j - n_dx] = column[i] / width
                steps += 2 if is_centred else 1
            steps += 1
            by_x, by_u = (a @ f_x[t], a @ f_u[t] + b) if substep else (a, b)
            copy(by_x.ravel(), f_x[t].ravel())
            copy(by_u.ravel(), f_u[t].ravel())
            copy(after, z[:n_x])
    push_at(sim, NEVER)
    return steps


@compiled_part
def step(sim, z, warm, skip, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Steps from z = (x, u); the results of skipped stages must be valid for z."""
    put_state(sim, z)
    copy(z[len(after) :], sim.ctrl)
    copy(warm, sim.warmstart)
    mj.mj_step_skip(sim.model, sim.data, skip, 1)
    get_state(sim, after)


@compiled_part
def _step_near(sim, balance, z, warm, skip, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Does the same next to a point whose balance is known."""
    if not sim.structure.may_skip:
        step(sim, z, warm, _NOTHING, after)
        return
    if not balance.is_smooth[0]:
        step(sim, z, warm, skip, after)
        return
    put_state(sim, z)
    copy(z[len(after) :], sim.ctrl)
    if skip < _OF_POSITIONS:
        mj.mj_fwd_kinematics(sim.model, sim.data)
        mj.mj_make_m(sim.model, sim.data)
        if balance.is_pushed[0]:
            mj.mj_collision(sim.model, sim.data)
            mj.mj_make_constraint(sim.model, sim.data)
        mj.mj_transmission(sim.model, sim.data)
    if skip < _OF_VELOCITIES:
        mj.mj_fwd_velocity(sim.model, sim.data)
    mj.mj_fwd_actuation(sim.model, sim.data)
    residual = balance.moved_residual
    _write_residual(sim, balance.acceleration, residual)
    for i in range(len(residual)):
        for j in range(len(residual)):
            sim.qacc[i] -= balance.inverse_hessian[i, j] * (residual[j] - balance.residual[j])
    # The constraints' force is what is missing to M a, but for r_0: the search left that there too.
    mj.mj_mul_m(sim.model, sim.data, residual.ctypes.data, sim.qacc.ctypes.data)
    for i in range(len(residual)):
        sim.qfrc_smooth[i] = sim.qfrc_passive[i] + sim.qfrc_actuator[i] - sim.qfrc_bias[i]
        sim.qfrc_constraint[i] = residual[i] - sim.qfrc_smooth[i] - balance.residual[i]
    integrate(sim, np.int32(skip >= _OF_POSITIONS))
    get_state(sim, after)


@compiled_part
def integrate(sim, keeps_system):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Advances the state by the accelerations and forces that the simulation holds."""
    if sim.structure.is_implicit:
        mj.mj_implicit_skip(sim.model, sim.data, keeps_system)
    else:
        mj.mj_euler_skip(sim.model, sim.data, keeps_system)


@compiled_part
def _find_balance(sim, balance):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the balance of forces at the point from which the simulation has stepped."""
    acceleration, residual, hessian = (
        balance.acceleration,
        balance.residual,
        balance.inverse_hessian,
    )
    product, force = balance.moved, balance.moved_residual
    mass, is_pushed, is_smooth = balance.mass, balance.is_pushed, balance.is_smooth
    copy(sim.qacc, acceleration)
    is_pushed[0] = not sim.structure.is_one_sided
    for pushes in sim.qfrc_constraint:
        is_pushed[0] |= pushes != 0.0
    _write_residual(sim, acceleration, residual)
    copy(sim.qfrc_constraint, force)
    for j in range(len(acceleration)):
        sim.qacc[:] = 0.0
        sim.qacc[j] = 1.0
        mj.mj_mul_m(sim.model, sim.data, product.ctypes.data, sim.qacc.ctypes.data)
        copy(acceleration, sim.qacc)
        if is_pushed[0]:
            sim.qacc[j] += _ACCELERATION_EPS
            mj.mj_inv_constraint(sim.model, sim.data)
        for i in range(len(acceleration)):
            mass[i, j] = product[i]
            hessian[i, j] = product[i] - (sim.qfrc_constraint[i] - force[i]) / _ACCELERATION_EPS
    is_smooth[0] = _is_symmetric(hessian)
    if is_smooth[0]:
        _invert(hessian)


@compiled_part
def _differentiate_forces(sim, balance, z, after, rates, moves, a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes ∂v'/∂a and −∂r/∂(v, u) by the balance at z, which a step brought to after.

    Activations do not follow velocities, and their rows of a and b are differences.
    """
    n_q, n_v, n_a, n_u = len(sim.qpos), len(sim.qvel), len(sim.act), len(sim.ctrl)
    before = balance.moved
    moves[:] = 0.0
    put_state(sim, z)
    copy(z[len(after) :], sim.ctrl)
    mj.mjd_smooth_vel(sim.model, sim.data, 1)
    for i in range(n_v):
        for k in range(sim.row_starts[i], sim.row_starts[i] + sim.row_lengths[i]):
            moves[i, sim.row_columns[k]] = sim.smooth_rates[k]
    if balance.is_pushed[0]:
        copy(balance.acceleration, sim.qacc)
        mj.mj_inv_constraint(sim.model, sim.data)
        copy(sim.qfrc_constraint, before)
        for j in range(n_v):
            sim.qvel[j] += _VELOCITY_EPS
            mj.mj_reference_constraint(sim.model, sim.data)
            mj.mj_inv_constraint(sim.model, sim.data)
            sim.qvel[j] = z[n_q + j]
            for i in range(n_v):
                moves[i, j] += (sim.qfrc_constraint[i] - before[i]) / _VELOCITY_EPS
    a[2 * n_v :, n_v : 2 * n_v] = 0.0
    copy(sim.qfrc_actuator, before)
    for j in range(n_v, n_v + n_a + n_u):
        u, width = j - n_v - n_a, _CONTROL_EPS
        if u < 0:
            sim.act[j - n_v] += width
        else:
            width = width if sim.high[u] - sim.ctrl[u] >= width else -width
            sim.ctrl[u] += width
        mj.mj_fwd_actuation(sim.model, sim.data)
        for i in range(n_v):
            moves[i, j] = (sim.qfrc_actuator[i] - before[i]) / width
        if n_a:
            integrate(sim, _KEPT)
            for i in range(n_a):
                change = (sim.act[i] - after[n_q + n_v + i]) / width
                if u < 0:
                    a[2 * n_v + i, n_v + j] = change
                else:
                    b[2 * n_v + i, u] = change
            put_state(sim, z)
        if u >= 0:
            sim.ctrl[u] = z[len(after) + u]
    for j in range(n_v):
        put_state(sim, z)
        for i in range(n_v):
            sim.qacc[i] = 1.0 if i == j else 0.0
            sim.qfrc_smooth[i] = 0.0
            sim.qfrc_constraint[i] = balance.mass[i, j]
        integrate(sim, _KEPT)
        for i in range(n_v):
            rates[i, j] = sim.qvel[i] - z[n_q + i]


@compiled_part
def _put_rates(sim, after, moves, a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the rows of velocities and positions by K H⁻¹ (−∂r/∂(v, u)), which it overwrites."""
    n_v, n_a, n_u = len(sim.qvel), len(sim.act), len(sim.ctrl)
    for j in range(n_v):
        moves[j, j] += 1.0
    for first in (n_v, 0):  # rows of velocities, then those of positions
        if first == 0:
            turn(sim, after, moves)
        for i in range(n_v):
            for j in range(n_v + n_a):
                a[first + i, n_v + j] = moves[i, j]
            for j in range(n_u):
                b[first + i, j] = moves[i, n_v + n_a + j]


@compiled_part
def turn(sim, after, rows):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Turns derivatives of new velocities, (n_v, n), into those of the positions they lead to.

    A quaternion q' = q exp(h ω') moves by δ = h J(h ω') δω', with the right Jacobian of SO(3),
    J(θ) = 1 − c [θ]ₓ + s [θ]ₓ², c = (1 − cos|θ|)/|θ|², s = (|θ| − sin|θ|)/|θ|³.
    """
    h, n_q = sim.structure.time_step, len(sim.qpos)
    for i in range(len(rows)):
        for j in range(rows.shape[1]):
            rows[i, j] *= h
    for first in sim.structure.quaternions:
        x, y, w = h * after[n_q + first], h * after[n_q + first + 1], h * after[n_q + first + 2]
        angle = np.sqrt(x * x + y * y + w * w)
        c, s = 0.5, 1.0 / 6.0
        if angle > 1e-4:
            c, s = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
        for j in range(rows.shape[1]):
            p, q, r = rows[first, j], rows[first + 1, j], rows[first + 2, j]
            u, v, t = y * r - w * q, w * p - x * r, x * q - y * p  # θ × δ
            rows[first, j] += s * (y * t - w * v) - c * u
            rows[first + 1, j] += s * (w * u - x * t) - c * v
            rows[first + 2, j] += s * (x * v - y * u) - c * t


@compiled_part
def _is_any_below(values, limit):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns whether the size of any value is below a limit."""
    for value in values:  # noqa: SIM110 - numba compiles a loop sooner
        if abs(value) < limit:
            return True
    return False


@compiled_part
def _is_symmetric(a):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns whether a matrix is symmetric, measured by its diagonal, which must be positive."""
    for i in range(len(a)):
        if not a[i, i] > 0.0:
            return False
        for j in range(i):
            if not abs(a[i, j] - a[j, i]) <= _ASYMMETRY * np.sqrt(a[i, i] * a[j, j]):
                return False
    return True


@compiled_part
def _invert(a):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Replaces a positive definite matrix by its inverse, by Gauss-Jordan elimination.

    It needs no search for pivots: ∂r/∂a is the mass matrix plus a term of the constraints that is
    positive semidefinite, since their forces descend a convex cost, so that each pivot is positive
    and none is lost to cancellation. If rounding makes one zero, the result is NaN, which `Problem`
    refuses as a derivative that is not finite.
    """
    n = len(a)
    for k in range(n):
        pivot = 1.0 / a[k, k] if a[k, k] else np.nan
        a[k, k] = 1.0
        for j in range(n):
            a[k, j] *= pivot
        for i in range(n):
            if i != k:
                factor = a[i, k]
                a[i, k] = 0.0
                for j in range(n):
                    a[i, j] -= factor * a[k, j]


@compiled_part
def _write_residual(sim, acceleration, residual):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes r at the simulation's state and control, and an acceleration."""
    copy(acceleration, sim.qacc)
    mj.mj_inv_constraint(sim.model, sim.data)
    mj.mj_mul_m(sim.model, sim.data, residual.ctypes.data, sim.qacc.ctypes.data)
    for i in range(len(residual)):
        residual[i] += sim.qfrc_bias[i] - sim.qfrc_passive[i]
        residual[i] -= sim.qfrc_actuator[i] + sim.qfrc_constraint[i]
