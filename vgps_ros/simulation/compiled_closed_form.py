# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives of a simulator step in closed form, through contact.

At the acceleration a that a step has found, all forces balance,

    r(q, v, u, a) = M(q) a + c(q, v) − τ(q, v, u) − Jᵀ f(J a − a_ref) = 0,

and the new velocity is v' = v + h M̂⁻¹ M a, M̂ = M − h Q, where Q are the rates of the forces that
are integrated implicitly. So, with H = ∂r/∂a = M + Jᵀ C J,

    dv' = dv + h X + h M̂⁻¹ (h Q X + (∂M/∂q dq) (a − â)),   X = −H⁻¹ dr,   â = (v' − v)/h.

**Smooth forces.** Coordinate j moves all that it carries along the twist S_j. Seen from there,
bodies keep their inertia I, and the motion of what carries them changes, by ψ = V × S and
ζ = A × S + V × ψ, with velocity V and acceleration A (with −g) of the carrier. Forces
F = I A + V ×* I V change by

    D_j F = I ζ_j + B ψ_j,    B ψ = V ×* I ψ − I (V × ψ) + ψ ×* I V.

A force that holds part of a body's weight does not turn with it, as if that mass had no weight in
ζ: with its first moment P, mass p and the turn w of S_j, (P, p) takes away the motion w × (−g).

Sums over what joint i carries, Iᶜ and Bᶜ, give the force S_iᵀ F of joint i (Carpentier and Mansard
2018; Echeandia and Wensing 2021):

    ∂(S_iᵀ F)/∂q_j = S_iᵀ (Iᶜ_i ζ_j + Bᶜ_i ψ_j)                    if j moves i,
                     S_iᵀ (S_j ×* Fᶜ_j + Iᶜ_j ζ_j + Bᶜ_j ψ_j)       if i carries j.

B depends on the turn w of ψ = (w, ·) alone: B ψ = (N w, 2 w × l), with the momentum l.

Forces of constraints are those of `compiled_contacts`.
"""

from typing import NamedTuple

import numpy as np

from vgps_ros.core.compilation import compiled_part
from vgps_ros.core.records import Array
from vgps_ros.simulation import mujoco_functions as mj
from vgps_ros.simulation.compiled_contacts import ContactMemory, add_constraints
from vgps_ros.simulation.compiled_spatial import (
    add_cross_force,
    add_curl,
    add_to_row,
    cross,
    dot,
    dot3,
    inertia_of,
    put_inertia,
    row,
    row3,
)
from vgps_ros.simulation.compiled_states import copy, put_state

_EPS = 1e-6  # of what actuators read; their forces are linear in it, or nearly


class Tangents(NamedTuple):
    """Memory for derivatives: rows for degrees of freedom, one more for none, and for bodies.

    Twists and wrenches are (turn or torque, shift or force), about their tree's centre of mass.

    Attributes:
        acceleration: a, (n,).
        pull: a − â, (n,).
        velocity: V up to each degree of freedom, (n+1, 6).
        total: A, with −g, (n+1, 6).
        plain: Σ S a, (n+1, 6).
        excess: Σ S (a − â), (n+1, 6).
        psi: ψ, (n, 6).
        zeta: ζ, (n, 6).
        xi: ζ of a − â alone, (n, 6).
        chi: ∂A/∂v, but for V × S of what is carried, (n, 6).
        force: F, then Fᶜ, of bodies, (n_b, 6).
        pulled: the same of a − â.
        linear: l, (n_b, 3).
        turning: N, (n_b, 9).
        held: P and p of what gravity compensation holds, then of all that each carries, (n_b, 4).
        lift: p s + w × P of S = (w, s), (n, 3).
        fall: w × (−g), (n, 3).
        inertial: Iᶜ S, (n, 6).
        curling: the turn of Bᶜᵀ S, (n, 3).
        column: (4, 6).
        hessian: H, then its factors, (n, n).
        moves: −∂r, then derivatives of v', (n, n_dx + n_u).
        other: of the same shape.
        excess_rates: (∂M/∂q) (a − â), (n, n).
        actuated: forces of actuators, (n_u,).
        pushed: forces of actuators at joints, (n,).
        activations: derivatives of new activations by old ones and by controls, (2, n_a).
        contact: memory for a contact.
    """

    acceleration: Array
    pull: Array
    velocity: Array
    total: Array
    plain: Array
    excess: Array
    psi: Array
    zeta: Array
    xi: Array
    chi: Array
    force: Array
    pulled: Array
    linear: Array
    turning: Array
    held: Array
    lift: Array
    fall: Array
    inertial: Array
    curling: Array
    column: Array
    hessian: Array
    moves: Array
    other: Array
    excess_rates: Array
    actuated: Array
    pushed: Array
    activations: Array
    contact: ContactMemory


def tangents(n: int, n_b: int, n_a: int, n_u: int) -> Tangents:
    """Returns memory for n degrees of freedom, bodies, activations and controls."""
    m = 2 * n + n_a + n_u
    shapes: tuple[tuple[int, ...], ...] = (
        *((n, 6), (n, 6), (n, 6), (n, 4), (n, 3), (3, 3), (3,), (6, 6), (6, 6), (6,), (6,)),
        *((10, 6), (4, 6), (2, 6), (6,), (8, 6)),
    )
    contact = ContactMemory._make([np.zeros(n, np.int64), *(np.zeros(shape) for shape in shapes)])
    shapes = (
        *(2 * ((n,),) + 4 * ((n + 1, 6),) + 4 * ((n, 6),)),
        *((n_b, 6), (n_b, 6), (n_b, 3), (n_b, 9), (n_b, 4), (n, 3), (n, 3)),
        *((n, 6), (n, 3), (4, 6)),
        *((n, n), (n, m), (n, m), (n, n), (n_u,), (n,), (2, n_a)),
    )
    return Tangents._make([*(np.zeros(shape) for shape in shapes), contact])


@compiled_part
def find_moves(sim, mech, z, after, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes H and −∂r/∂(q, v, act, u) at the point z from which the simulation has stepped.

    Returns whether all of it has a closed form. The simulation must hold what the step left.
    """
    tree = mech.tree
    n, n_q = len(sim.qvel), len(sim.qpos)
    moves, hessian, rates = work.moves, work.hessian, work.excess_rates
    moves[:] = 0.0
    hessian[:] = 0.0
    h = sim.structure.time_step
    for i in range(n):
        work.acceleration[i] = sim.qacc[i]
        work.pull[i] = sim.qacc[i] - (after[n_q + i] - z[n_q + i]) / h
        for k in range(mech.mass_starts[i], mech.mass_starts[i] + mech.mass_lengths[i]):
            hessian[i, mech.mass_columns[k]] = mech.mass[k]
    _follow_motion(mech, z, n_q, work)
    if not add_constraints(mech, sim.data, work):
        return False
    _add_up_carried(tree, work)
    cdof, y, curl, column = tree.cdof, work.inertial, work.curling, work.column
    for j in range(n):
        b = tree.body[j]
        put_inertia(tree.crb, b, work.zeta, j, column, 0)
        add_curl(work.turning, work.linear, b, work.psi, j, column, 0)
        add_cross_force(cdof, j, work.force, b, 1.0, column, 0)
        p, q, r = row3(work.fall, j)
        x, o, w = row3(work.held, b)
        m = work.held[b, 3]
        add_to_row(column, 0, 1.0, o * r - w * q, w * p - x * r, x * q - o * p, m * p, m * q, m * r)
        put_inertia(tree.crb, b, work.chi, j, column, 1)
        add_curl(work.turning, work.linear, b, cdof, j, column, 1)
        put_inertia(tree.crb, b, work.xi, j, column, 2)
        add_cross_force(cdof, j, work.pulled, b, 1.0, column, 2)
        up = np.int64(j)
        while up < n:
            if tree.base[up] == tree.base[j]:
                moves[up, j] -= dot(y, up, work.zeta, j) + dot3(curl, up, work.psi, j)
                moves[up, j] -= dot3(work.lift, up, work.fall, j)
                rates[up, j] = dot(y, up, work.xi, j)
            else:
                moves[up, j] -= dot(cdof, up, column, 0)
                rates[up, j] = dot(cdof, up, column, 2)
            moves[up, n + j] -= dot(cdof, up, column, 1)
            if up != j:
                moves[j, up] -= dot(y, j, work.zeta, up) + dot3(curl, j, work.psi, up)
                moves[j, up] -= dot3(work.lift, j, work.fall, up)
                rates[j, up] = dot(y, j, work.xi, up)
                moves[j, n + up] -= dot(y, j, work.chi, up) + dot3(curl, j, cdof, up)
            up = np.int64(tree.parent[up])
    for i in range(n):
        moves[i, i] -= mech.stiffness[i]
    _add_rates(sim, mech, z, after, work)
    return True


@compiled_part
def _add_up_carried(tree, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Sums up what each body carries, and writes what of it acts along each degree of freedom."""
    n, n_b = len(tree.parent), len(tree.body_parent)
    for b in range(n_b - 1, 0, -1):
        p = tree.body_parent[b]
        if p == 0 or tree.body_end[p] == n:
            continue
        for k in range(6):
            work.force[p, k] += work.force[b, k]
            work.pulled[p, k] += work.pulled[b, k]
        for k in range(3):
            work.linear[p, k] += work.linear[b, k]
        for k in range(9):
            work.turning[p, k] += work.turning[b, k]
        for k in range(4):
            work.held[p, k] += work.held[b, k]
    cdof, y, curl = tree.cdof, work.inertial, work.curling
    for i in range(n):
        b = tree.body[i]
        put_inertia(tree.crb, b, cdof, i, y, i)
        p, q, r, s, t, u = row(cdof, i)
        x, o, w = row3(work.linear, b)
        curl[i, 0] = 2.0 * (o * u - w * t)
        curl[i, 1] = 2.0 * (w * s - x * u)
        curl[i, 2] = 2.0 * (x * t - o * s)
        for k in range(3):
            turn = work.turning
            curl[i, k] += turn[b, k] * p + turn[b, 3 + k] * q + turn[b, 6 + k] * r
        x, o, w = row3(work.held, b)
        held, lift = work.held[b, 3], work.lift
        lift[i, 0] = held * s + q * w - r * o
        lift[i, 1] = held * t + r * x - p * w
        lift[i, 2] = held * u + p * o - q * x


@compiled_part
def _follow_motion(mech, z, n_q, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes motions up to each degree of freedom, and each body's forces."""
    tree, (f, g, h) = mech.tree, mech.gravity
    n, n_b = len(tree.parent), len(tree.body_parent)
    cdof, velocity, total = tree.cdof, work.velocity, work.total
    plain, excess, psi, zeta = work.plain, work.excess, work.psi, work.zeta
    for k in range(6):
        velocity[n, k] = plain[n, k] = excess[n, k] = total[n, k] = 0.0
    total[n, 3], total[n, 4], total[n, 5] = -f, -g, -h
    column = work.column
    for i in range(n):
        base, before = tree.base[i], tree.parent[i]
        cross(velocity, base, cdof, i, psi, i)
        cross(total, base, cdof, i, zeta, i)
        cross(velocity, base, psi, i, column, 0)
        cross(excess, base, cdof, i, work.xi, i)
        v, a, w = z[n_q + i], work.acceleration[i], work.pull[i]
        for k in range(6):
            zeta[i, k] += column[0, k]
            velocity[i, k] = velocity[before, k] + cdof[i, k] * v
            total[i, k] = total[before, k] + cdof[i, k] * a + psi[i, k] * v
            plain[i, k] = plain[before, k] + cdof[i, k] * a
            excess[i, k] = excess[before, k] + cdof[i, k] * w
    for i in range(n):
        cross(velocity, tree.end[i], cdof, i, work.chi, i)
        for k in range(6):
            work.chi[i, k] += psi[i, k]
        p, q, r = row3(cdof, i)
        fall = work.fall
        fall[i, 0], fall[i, 1], fall[i, 2] = r * g - q * h, p * h - r * f, q * f - p * g
    inertia = tree.cinert
    for b in range(1, n_b):
        e = tree.body_end[b]
        if e == n:
            continue
        put_inertia(inertia, b, velocity, e, column, 0)
        put_inertia(inertia, b, total, e, work.force, b)
        add_cross_force(velocity, e, column, 0, 1.0, work.force, b)
        put_inertia(inertia, b, excess, e, work.pulled, b)
        for k in range(3):
            work.linear[b, k] = column[0, 3 + k]
        # N = X + Xᵀ − [I_w ω]ₓ + 2 ((m c · v) 1 − v (m c)ᵀ), X = [ω]ₓ I_w
        p, q, r, s, t, u = row(velocity, e)
        xx, yy, zz, xy, xz, yz, x, y, o, m = inertia_of(inertia, b)
        a0, a1, a2 = q * xz - r * xy, q * yz - r * yy, q * zz - r * yz
        b0, b1, b2 = r * xx - p * xz, r * xy - p * yz, r * xz - p * zz
        c0, c1, c2 = p * xy - q * xx, p * yy - q * xy, p * yz - q * xz
        k0 = xx * p + xy * q + xz * r
        k1 = xy * p + yy * q + yz * r
        k2 = xz * p + yz * q + zz * r
        along = 2.0 * (x * s + y * t + o * u)
        turn = work.turning
        turn[b, 0] = 2.0 * a0 + along - 2.0 * s * x
        turn[b, 1] = a1 + b0 + k2 - 2.0 * s * y
        turn[b, 2] = a2 + c0 - k1 - 2.0 * s * o
        turn[b, 3] = a1 + b0 - k2 - 2.0 * t * x
        turn[b, 4] = 2.0 * b1 + along - 2.0 * t * y
        turn[b, 5] = b2 + c1 + k0 - 2.0 * t * o
        turn[b, 6] = a2 + c0 + k1 - 2.0 * u * x
        turn[b, 7] = b2 + c1 - k0 - 2.0 * u * y
        turn[b, 8] = 2.0 * c2 + along - 2.0 * u * o
        share, held = mech.held[b], work.held
        held[b, 0], held[b, 1], held[b, 2], held[b, 3] = share * x, share * y, share * o, share * m
        fx, fy, fz = y * h - o * g, o * f - x * h, x * g - y * f
        add_to_row(work.force, b, share, fx, fy, fz, m * f, m * g, m * h)


@compiled_part
def _add_rates(sim, mech, z, after, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds the derivatives of forces of dampers and actuators.

    An actuator's force follows its own length, velocity, activation and control alone, so that each
    of them is moved for all actuators at once.
    """
    moves = work.moves
    n, n_a, n_u, n_x = len(sim.qvel), len(sim.act), len(sim.ctrl), len(after)
    for i in range(n):
        moves[i, n + i] -= mech.damping[i]
    if n_u == 0:
        return
    put_state(sim, z)
    copy(mech.actuator_force, work.actuated)
    copy(sim.qfrc_actuator, work.pushed)
    for kind in range(4):  # lengths, velocities, activations, controls
        first = 0 if kind == 0 else n if kind == 1 else 2 * n if kind == 2 else 2 * n + n_a
        count = n_a if kind == 2 else n_u
        if count == 0:
            continue
        for c in range(count):
            if kind == 0:
                mech.actuator_length[c] += _EPS
            elif kind == 1:
                mech.actuator_velocity[c] += _EPS
            elif kind == 2:
                sim.act[c] += _EPS
            else:
                sim.ctrl[c] += _EPS if sim.high[c] - sim.ctrl[c] >= _EPS else -_EPS
        mj.mj_fwd_actuation(sim.model, sim.data)
        for c in range(count):
            u = np.int64(mech.actuator_of_act[c]) if kind == 2 else c
            width = _EPS
            if kind == 3 and sim.ctrl[c] < z[n_x + c]:
                width = -_EPS
            rate = (mech.actuator_force[u] - work.actuated[u]) / width
            if kind == 0:
                mech.actuator_length[c] -= _EPS
            elif kind == 1:
                mech.actuator_velocity[c] -= _EPS
            if rate == 0.0:
                continue
            start, end = mech.moment_starts[u], mech.moment_starts[u] + mech.moment_lengths[u]
            for k in range(start, end):
                i = mech.moment_columns[k]
                if not mech.lowest[i] < work.pushed[i] < mech.highest[i]:
                    continue
                if kind >= 2:
                    moves[i, first + c] += mech.moment[k] * rate
                    continue
                for m in range(start, end):
                    j = first + mech.moment_columns[m]
                    moves[i, j] += mech.moment[k] * rate * mech.moment[m]
        if kind >= 2 and n_a:
            integrate(sim, np.int32(1))
            for i in range(n_a):
                u = np.int64(mech.actuator_of_act[i])
                width = _EPS
                if kind == 3 and sim.ctrl[u] < z[n_x + u]:
                    width = -_EPS
                change = (sim.act[i] - after[len(sim.qpos) + n + i]) / width
                work.activations[kind - 2, i] = change
            put_state(sim, z)
        if kind == 3:
            for u in range(n_u):
                sim.ctrl[u] = z[n_x + u]


@compiled_part
def put_moves(sim, mech, after, work, columns, a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes `columns` of the derivatives of a step by H and −∂r, which it overwrites."""
    h = sim.structure.time_step
    moves, other = work.moves, work.other
    n, n_a = len(sim.qvel), len(sim.act)
    n_dx, count = 2 * n + n_a, moves.shape[1]
    _factor(work.hessian)
    _solve(work.hessian, moves)
    if mech.is_damped:
        other[:] = 0.0
        for i in range(n):
            for j in range(n):
                other[i, j] = work.excess_rates[i, j]
            if not sim.structure.is_implicit:
                rate = -h * mech.damping[i]
                for c in range(count):
                    other[i, c] += rate * moves[i, c]
                continue
            for k in range(sim.row_starts[i], sim.row_starts[i] + sim.row_lengths[i]):
                j, rate = sim.row_columns[k], h * sim.smooth_rates[k]
                if j > i or rate == 0.0:
                    continue
                for c in range(count):
                    other[i, c] += rate * moves[j, c]
                if j < i:
                    for c in range(count):
                        other[j, c] += rate * moves[i, c]
        _solve_system(mech, other)
        for i in range(n):
            for c in range(count):
                moves[i, c] += other[i, c]
    for i in range(n):
        for c in range(count):
            moves[i, c] *= h
        moves[i, n + i] += 1.0
    a[2 * n :] = 0.0
    b[2 * n :] = 0.0
    for i in range(n_a):
        a[2 * n + i, 2 * n + i] = work.activations[0, i]
        b[2 * n + i, mech.actuator_of_act[i]] = work.activations[1, i]
    for first in (n, 0):  # rows of velocities, then those of positions
        if first == 0:
            _turn(sim, after, moves)
            _add_own(sim, after, moves)
        for i in range(n):
            for j in columns:
                if j < n_dx:
                    a[first + i, j] = moves[i, j]
                else:
                    b[first + i, j - n_dx] = moves[i, j]


@compiled_part
def _factor(matrix):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Replaces the lower half of a positive definite matrix by L and D of Lᵀ D L.

    From the last row up, zeros between joints of different branches stay zeros.
    """
    for k in range(len(matrix) - 1, -1, -1):
        inverse = 1.0 / matrix[k, k] if matrix[k, k] else np.nan
        for i in range(k - 1, -1, -1):
            if matrix[k, i] == 0.0:
                continue
            size = matrix[k, i] * inverse
            for j in range(i + 1):
                matrix[i, j] -= size * matrix[k, j]
            matrix[k, i] = size


@compiled_part
def _solve(factors, rows):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Replaces many right-hand sides, (n, m), by solutions of Lᵀ D L x = b."""
    n, m = rows.shape
    for k in range(n - 1, -1, -1):
        for i in range(k):
            size = factors[k, i]
            if size != 0.0:
                for c in range(m):
                    rows[i, c] -= size * rows[k, c]
    for k in range(n):
        inverse = 1.0 / factors[k, k] if factors[k, k] else np.nan
        for c in range(m):
            rows[k, c] *= inverse
        for i in range(k):
            size = factors[k, i]
            if size != 0.0:
                for c in range(m):
                    rows[k, c] -= size * rows[i, c]


@compiled_part
def _solve_system(mech, rows):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Does so by the factors of M̂ that MuJoCo's integration has left."""
    n, m = rows.shape
    for k in range(n - 1, -1, -1):
        start = mech.mass_starts[k]
        for e in range(start, start + mech.mass_lengths[k] - 1):
            i, size = mech.mass_columns[e], mech.system[e]
            for c in range(m):
                rows[i, c] -= size * rows[k, c]
    for k in range(n):
        start, inverse = mech.mass_starts[k], mech.system_inverse_diagonal[k]
        for c in range(m):
            rows[k, c] *= inverse
        for e in range(start, start + mech.mass_lengths[k] - 1):
            i, size = mech.mass_columns[e], mech.system[e]
            for c in range(m):
                rows[k, c] -= size * rows[i, c]


@compiled_part
def _turn(sim, after, rows):  # type: ignore[no-untyped-def]  # pragma: no cover
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
def _add_own(sim, after, rows):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds what new positions keep of old ones: all, but q exp(δ) exp(θ) turns δ by exp(−θ)."""
    h, n_q = sim.structure.time_step, len(sim.qpos)
    for i in range(len(rows)):
        rows[i, i] += 1.0
    for first in sim.structure.quaternions:
        x, y, w = h * after[n_q + first], h * after[n_q + first + 1], h * after[n_q + first + 2]
        angle = np.sqrt(x * x + y * y + w * w)
        s, c = 1.0, 0.5
        if angle > 1e-4:
            s, c = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
        i, j, k = first, first + 1, first + 2
        rows[i, i] -= c * (y * y + w * w)
        rows[j, j] -= c * (x * x + w * w)
        rows[k, k] -= c * (x * x + y * y)
        rows[i, j] += c * x * y + s * w
        rows[j, i] += c * x * y - s * w
        rows[i, k] += c * x * w - s * y
        rows[k, i] += c * x * w + s * y
        rows[j, k] += c * y * w + s * x
        rows[k, j] += c * y * w - s * x


@compiled_part
def integrate(sim, keeps_system):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Advances the state by the accelerations and forces that the simulation holds."""
    if sim.structure.is_implicit:
        mj.mj_implicit_skip(sim.model, sim.data, keeps_system)
    else:
        mj.mj_euler_skip(sim.model, sim.data, keeps_system)
