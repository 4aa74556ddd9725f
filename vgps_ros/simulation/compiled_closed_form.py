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

Sums over what joint i carries, Iᶜ and Bᶜ, give the force S_iᵀ F of joint i (Carpentier and Mansard
2018; Echeandia and Wensing 2021):

    ∂(S_iᵀ F)/∂q_j = S_iᵀ (Iᶜ_i ζ_j + Bᶜ_i ψ_j)                    if j moves i,
                     S_iᵀ (S_j ×* Fᶜ_j + Iᶜ_j ζ_j + Bᶜ_j ψ_j)       if i carries j.

B depends on the turn w of ψ = (w, ·) alone: B ψ = (N w, 2 w × l), with the momentum l.

**Contacts.** The point p, the normal n and the distance of a contact between a plane and a sphere,
a capsule's end or a corner, or between two of spheres and capsules, move with their bodies. So do
the relative motions J a and J v, the forces f, and the wrench W at p. Steps with a contact of other
shapes are left to differences.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compile_at_first_call, compiled_part
from vgps_ros.core.records import Array
from vgps_ros.simulation import mujoco_functions as mj
from vgps_ros.simulation.compiled_derivatives import integrate, step, turn
from vgps_ros.simulation.compiled_states import NEVER, copy, push_at, put_state

_FIRST_FRICTION = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
_LAST_FRICTION = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON)
_FIRST_CONTACT = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_FRICTIONLESS)
_PYRAMIDAL = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_PYRAMIDAL)
_ELLIPTIC = int(mujoco.mjtConstraint.mjCNSTR_CONTACT_ELLIPTIC)
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_SPHERE, _CAPSULE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_BOX, _MESH = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_MESH)
# Numbers of a contact's record, by their order: doubles, and whole numbers of four bytes.
_DISTANCE, _POSITION, _FRAME, _FRICTION, _MU, _GEOMS = 0, 1, 4, 14, 32, 141
_NOTHING = np.int32(mujoco.mjtStage.mjSTAGE_NONE)  # no stage of a step is skipped
_EPS = 1e-6  # of what actuators read; their forces are linear in it, or nearly
_STRAIGHT = 1e-9  # of two capsules' angle, squared, below which they are parallel


class ContactMemory(NamedTuple):
    """Memory for a contact; vectors at it are along its axes, the normal first.

    Attributes:
        chain: the degrees of freedom that move it, (n,).
        first: their twists if they move its first body, (n, 6).
        second: the same of the second.
        relative: the difference.
        spot: how they move its point and its distance, (n, 4).
        turn: how they turn its axes, (n, 3).
        axis: its axes, (3, 3).
        point: its place, (3,).
        basis: its force by relative accelerations, (6, 6).
        by_velocity: by relative velocities, (6, 6).
        by_distance: by the distance, (6,).
        force_of_contact: (6,).
        edges: its constraints' rows, (10, 6).
        wrench: its wrench, the change of it, and those changes as seen from either body, (4, 6).
        change: of relative accelerations and velocities, (2, 6).
        rates: (6,).
        small: (8, 6).
    """

    chain: NDArray[np.int64]
    first: Array
    second: Array
    relative: Array
    spot: Array
    turn: Array
    axis: Array
    point: Array
    basis: Array
    by_velocity: Array
    by_distance: Array
    force_of_contact: Array
    edges: Array
    wrench: Array
    change: Array
    rates: Array
    small: Array


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
        *((n_b, 6), (n_b, 6), (n_b, 3), (n_b, 9), (n, 6), (n, 3), (4, 6)),
        *((n, n), (n, m), (n, m), (n, n), (n_u,), (n,), (2, n_a)),
    )
    return Tangents._make([*(np.zeros(shape) for shape in shapes), contact])


@compile_at_first_call
def differentiate(  # type: ignore[no-untyped-def]  # pragma: no cover
    sim, mech, work, positions, first, states, controls, f_x, f_u, is_known
):
    """Writes f_x, f_u at N steps from the first on, by the chain rule over their simulator steps.

    Columns of positions that are not among `positions` stay those of the identity. Writes into
    `is_known`, shape (N,), which steps have derivatives in closed form; a step in which a push acts
    has none. Returns the number of simulator steps.
    """
    n_v, n_u, n_x, n_dx = len(sim.qvel), len(sim.ctrl), states.shape[1], f_x.shape[1]
    z, warm, after = np.empty(n_x + n_u), np.empty(n_v), np.empty(n_x)  # z = (x, u)
    a, b = np.eye(n_dx), np.empty((n_dx, n_u))
    steps = 0
    for t in range(len(states)):
        copy(states[t], z[:n_x])
        copy(controls[t], z[n_x:])
        warm[:] = 0.0
        is_known[t] = not push_at(sim, first + t)
        for substep in range(sim.substeps):
            if not is_known[t]:
                break
            step(sim, z, warm, _NOTHING, after)
            copy(sim.warmstart, warm)
            steps += 1
            is_known[t] = find_moves(sim, mech, z, after, work)
            if is_known[t]:
                put_moves(sim, mech, after, work, positions, a, b)
                by_x, by_u = (a @ f_x[t], a @ f_u[t] + b) if substep else (a, b)
                copy(by_x.ravel(), f_x[t].ravel())
                copy(by_u.ravel(), f_u[t].ravel())
                copy(after, z[:n_x])
    push_at(sim, NEVER)
    return steps


# Numba takes a tenth of a second to compile each access to a matrix, so rows are read at once.


@compiled_part
def _row3(a, i):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns the first three numbers of a row."""
    return a[i, 0], a[i, 1], a[i, 2]


@compiled_part
def _row(a, i):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns six numbers of a row."""
    return a[i, 0], a[i, 1], a[i, 2], a[i, 3], a[i, 4], a[i, 5]


@compiled_part
def _put(out, k, p, q, r, s, t, u):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes six numbers of a row."""
    out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4], out[k, 5] = p, q, r, s, t, u


@compiled_part
def _add(out, k, size, p, q, r, s, t, u):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds `size` times six numbers to a row."""
    x, y, z, d, e, f = _row(out, k)
    x, y, z, d, e, f = (
        x + size * p,
        y + size * q,
        z + size * r,
        d + size * s,
        e + size * t,
        f + size * u,
    )
    _put(out, k, x, y, z, d, e, f)


@compiled_part
def _cross(a, i, b, j, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the motion a_i × b_j."""
    p, q, r, s, t, u = _row(a, i)
    x, y, z, d, e, f = _row(b, j)
    first, second, third = (
        q * f - r * e + t * z - u * y,
        r * d - p * f + u * x - s * z,
        p * e - q * d,
    )
    _put(out, k, q * z - r * y, r * x - p * z, p * y - q * x, first, second, third + s * y - t * x)


@compiled_part
def _add_cross_force(a, i, b, j, size, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds `size` times the change a_i ×* b_j of a wrench b_j that moves along a_i."""
    p, q, r, s, t, u = _row(a, i)
    x, y, z, d, e, f = _row(b, j)
    first, second, third = (
        q * z - r * y + t * f - u * e,
        r * x - p * z + u * d - s * f,
        p * y - q * x,
    )
    third += s * e - t * d
    _add(out, k, size, first, second, third, q * f - r * e, r * d - p * f, p * e - q * d)


@compiled_part
def _inertia(inertia, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns I_b: xx, yy, zz, xy, xz, yz, m c and m."""
    xx, yy, zz, xy, xz, yz = _row(inertia, b)
    return xx, yy, zz, xy, xz, yz, inertia[b, 6], inertia[b, 7], inertia[b, 8], inertia[b, 9]


@compiled_part
def _put_inertia(inertia, b, a, i, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes I_b a_i."""
    p, q, r, s, t, u = _row(a, i)
    xx, yy, zz, xy, xz, yz, x, y, z, m = _inertia(inertia, b)
    first, second = (
        xx * p + xy * q + xz * r + y * u - z * t,
        xy * p + yy * q + yz * r + z * s - x * u,
    )
    third = xz * p + yz * q + zz * r + x * t - y * s
    fourth, fifth, sixth = m * s + q * z - r * y, m * t + r * x - p * z, m * u + p * y - q * x
    _put(out, k, first, second, third, fourth, fifth, sixth)


@compiled_part
def _add_curl(n, l, b, a, i, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds B_b a_i = (N w, 2 w × l)."""
    p, q, r = _row3(a, i)
    x, y, z = _row3(l, b)
    for m in range(3):
        out[k, m] += n[b, 3 * m] * p + n[b, 3 * m + 1] * q + n[b, 3 * m + 2] * r
    first, second, third = q * z - r * y, r * x - p * z, p * y - q * x
    _add(out, k, 2.0, 0.0, 0.0, 0.0, first, second, third)


@compiled_part
def _dot(a, i, b, j):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns a_i · b_j."""
    total = 0.0
    for k in range(6):
        total += a[i, k] * b[j, k]
    return total


@compiled_part
def _dot3(a, i, b, j):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns a_i · b_j of their first three numbers."""
    total = 0.0
    for k in range(3):
        total += a[i, k] * b[j, k]
    return total


@compiled_part
def find_moves(sim, mech, z, after, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes H and −∂r/∂(q, v, act, u) at the point z from which the simulation has stepped.

    Returns whether all of it has a closed form. The simulation must hold what the step left.
    """
    tree = mech.tree
    n, n_q, n_b = len(sim.qvel), len(sim.qpos), len(tree.body_parent)
    moves, hessian, rates = work.moves, work.hessian, work.excess_rates
    moves[:] = 0.0
    hessian[:] = 0.0
    h = sim.structure.time_step
    for i in range(n):
        work.acceleration[i] = sim.qacc[i]
        work.pull[i] = sim.qacc[i] - (after[n_q + i] - z[n_q + i]) / h
        for k in range(mech.mass_starts[i], mech.mass_starts[i] + mech.mass_lengths[i]):
            hessian[i, mech.mass_columns[k]] = mech.mass[k]
    _follow_motion(tree, mech.gravity, z, n_q, work)
    if not _add_constraints(mech, sim.data, work):
        return False
    # Forces that bodies carry.
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
    cdof, y, curl, column = tree.cdof, work.inertial, work.curling, work.column
    for i in range(n):
        b = tree.body[i]
        _put_inertia(tree.crb, b, cdof, i, y, i)
        p, q, r, s, t, u = _row(cdof, i)
        x, o, w = _row3(work.linear, b)
        curl[i, 0] = 2.0 * (o * u - w * t)
        curl[i, 1] = 2.0 * (w * s - x * u)
        curl[i, 2] = 2.0 * (x * t - o * s)
        for k in range(3):
            turn = work.turning
            curl[i, k] += turn[b, k] * p + turn[b, 3 + k] * q + turn[b, 6 + k] * r
    for j in range(n):
        b = tree.body[j]
        _put_inertia(tree.crb, b, work.zeta, j, column, 0)
        _add_curl(work.turning, work.linear, b, work.psi, j, column, 0)
        _add_cross_force(cdof, j, work.force, b, 1.0, column, 0)
        _put_inertia(tree.crb, b, work.chi, j, column, 1)
        _add_curl(work.turning, work.linear, b, cdof, j, column, 1)
        _put_inertia(tree.crb, b, work.xi, j, column, 2)
        _add_cross_force(cdof, j, work.pulled, b, 1.0, column, 2)
        up = np.int64(j)
        while up < n:
            if tree.base[up] == tree.base[j]:
                moves[up, j] -= _dot(y, up, work.zeta, j) + _dot3(curl, up, work.psi, j)
                rates[up, j] = _dot(y, up, work.xi, j)
            else:
                moves[up, j] -= _dot(cdof, up, column, 0)
                rates[up, j] = _dot(cdof, up, column, 2)
            moves[up, n + j] -= _dot(cdof, up, column, 1)
            if up != j:
                moves[j, up] -= _dot(y, j, work.zeta, up) + _dot3(curl, j, work.psi, up)
                rates[j, up] = _dot(y, j, work.xi, up)
                moves[j, n + up] -= _dot(y, j, work.chi, up) + _dot3(curl, j, cdof, up)
            up = np.int64(tree.parent[up])
    for i in range(n):
        moves[i, i] -= mech.stiffness[i]
    _add_rates(sim, mech, z, after, work)
    return True


@compiled_part
def _follow_motion(tree, gravity, z, n_q, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes motions up to each degree of freedom, and each body's forces."""
    n, n_b = len(tree.parent), len(tree.body_parent)
    cdof, velocity, total = tree.cdof, work.velocity, work.total
    plain, excess, psi, zeta = work.plain, work.excess, work.psi, work.zeta
    for k in range(6):
        velocity[n, k] = plain[n, k] = excess[n, k] = total[n, k] = 0.0
    for k in range(3):
        total[n, 3 + k] = -gravity[k]
    column = work.column
    for i in range(n):
        base, before = tree.base[i], tree.parent[i]
        _cross(velocity, base, cdof, i, psi, i)
        _cross(total, base, cdof, i, zeta, i)
        _cross(velocity, base, psi, i, column, 0)
        _cross(excess, base, cdof, i, work.xi, i)
        v, a, w = z[n_q + i], work.acceleration[i], work.pull[i]
        for k in range(6):
            zeta[i, k] += column[0, k]
            velocity[i, k] = velocity[before, k] + cdof[i, k] * v
            total[i, k] = total[before, k] + cdof[i, k] * a + psi[i, k] * v
            plain[i, k] = plain[before, k] + cdof[i, k] * a
            excess[i, k] = excess[before, k] + cdof[i, k] * w
    for i in range(n):
        _cross(velocity, tree.end[i], cdof, i, work.chi, i)
        for k in range(6):
            work.chi[i, k] += psi[i, k]
    inertia = tree.cinert
    for b in range(1, n_b):
        e = tree.body_end[b]
        if e == n:
            continue
        _put_inertia(inertia, b, velocity, e, column, 0)
        _put_inertia(inertia, b, total, e, work.force, b)
        _add_cross_force(velocity, e, column, 0, 1.0, work.force, b)
        _put_inertia(inertia, b, excess, e, work.pulled, b)
        for k in range(3):
            work.linear[b, k] = column[0, 3 + k]
        # N = X + Xᵀ − [I_w ω]ₓ + 2 ((m c · v) 1 − v (m c)ᵀ), X = [ω]ₓ I_w
        p, q, r, s, t, u = _row(velocity, e)
        xx, yy, zz, xy, xz, yz, x, y, o, _ = _inertia(inertia, b)
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


class Rows(NamedTuple):
    """The constraints of a step: their number, and where MuJoCo keeps their numbers.

    Attributes:
        count: rows of all constraints.
        contacts: address of the contacts' records.
        size: of such a record [B].
        kind: address of the rows' kinds; the others are those of the fields of this name.
    """

    count: int
    contacts: int
    size: int
    kind: int
    id: int
    length: int
    start: int
    column: int
    jacobian: int
    pos: int
    margin: int
    weight: int
    kbip: int
    reference: int
    loss: int
    force: int


@compiled_part
def _find_rows(touch, data):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns the constraints of a step."""
    p = touch.places
    contacts = mj.address_at(data + touch.contact_places[0], 0)
    count = np.int64(mj.int32_at(data + touch.contact_places[1], 0))
    size = touch.contact_places[2]
    kind, name = mj.address_at(data + p[0], 0), mj.address_at(data + p[1], 0)
    length, start = mj.address_at(data + p[2], 0), mj.address_at(data + p[3], 0)
    column, jacobian = mj.address_at(data + p[4], 0), mj.address_at(data + p[5], 0)
    pos, margin = mj.address_at(data + p[6], 0), mj.address_at(data + p[7], 0)
    weight, kbip = mj.address_at(data + p[8], 0), mj.address_at(data + p[9], 0)
    reference, loss = mj.address_at(data + p[10], 0), mj.address_at(data + p[11], 0)
    force = mj.address_at(data + p[12], 0)
    places = kind, name, length, start, column, jacobian, pos, margin, weight, kbip
    return Rows(count, contacts, size, *places, reference, loss, force)


@compiled_part
def _add_constraints(mech, data, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds constraints to H, to −∂r and to the forces on bodies; returns whether all are known."""
    rows = _find_rows(mech.touch, data)
    e = np.int64(0)
    while e < rows.count:
        if mj.int32_at(rows.kind, e) < _FIRST_CONTACT:
            _add_row(rows, e, mech.is_sparse, work.hessian, work.moves)
            e += 1
            continue
        count, acts = _count_rows(rows, e)
        if acts:
            own, motions = work.contact, (work.plain, work.velocity)
            if not _add_contact(
                mech.tree,
                mech.touch,
                rows,
                e,
                count,
                own,
                motions,
                work.force,
                work.moves,
                work.hessian,
            ):
                return False
        e += count
    return True


@compiled_part
def _add_row(rows, e, is_sparse, hessian, moves):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds a constraint of joints, whose Jacobian does not vary."""
    n = len(hessian)
    size = mj.int32_at(rows.length, e) if is_sparse else n
    start = mj.int32_at(rows.start, e) if is_sparse else e * n
    f, kind = mj.double_at(rows.force, e), mj.int32_at(rows.kind, e)
    acts = f != 0.0
    if _FIRST_FRICTION <= kind <= _LAST_FRICTION:
        acts = abs(f) < mj.double_at(rows.loss, e)
    d = mj.double_at(rows.weight, e) if acts or kind < _FIRST_FRICTION else 0.0
    damping = mj.double_at(rows.kbip, 4 * e + 1)
    pull, harder = _pull(rows, e)
    by_position = f * harder - d * pull
    if d == 0.0 and by_position == 0.0:
        return
    for one in range(size):
        left = mj.double_at(rows.jacobian, start + one)
        if left == 0.0:
            continue
        row = mj.int32_at(rows.column, start + one) if is_sparse else one
        for other in range(size):
            product = left * mj.double_at(rows.jacobian, start + other)
            if product == 0.0:
                continue
            column = mj.int32_at(rows.column, start + other) if is_sparse else other
            hessian[row, column] += product * d
            moves[row, column] += product * by_position
            moves[row, n + column] -= product * d * damping


@compiled_part
def _pull(rows, e):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns how −a_ref of a row, and relatively its weight D, change by its distance."""
    k, i = mj.double_at(rows.kbip, 4 * e), mj.double_at(rows.kbip, 4 * e + 2)
    p = mj.double_at(rows.kbip, 4 * e + 3)
    gap = mj.double_at(rows.pos, e) - mj.double_at(rows.margin, e)
    return k * (i + p * gap), p / (i * (1.0 - i))


@compiled_part
def _count_rows(rows, first):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns how many rows a contact has from its first row on, and whether one has a force."""
    kind, name = mj.int32_at(rows.kind, first), mj.int32_at(rows.id, first)
    e, acts = first, False
    while e < rows.count and mj.int32_at(rows.kind, e) == kind and mj.int32_at(rows.id, e) == name:
        acts |= mj.double_at(rows.force, e) != 0.0
        e += 1
    return e - first, acts


@compiled_part
def _put_in_frame(axis, origin, a, i, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes a twist a_i at a contact, along its axes; the offset from the twist's origin."""
    p, q, r, s, t, u = _row(a, i)
    x, y, z = origin
    s, t, u = s + q * z - r * y, t + r * x - p * z, u + p * y - q * x
    for m in range(3):
        x, y, z = _row3(axis, m)
        out[k, m] = x * p + y * q + z * r
        out[k, 3 + m] = x * s + y * t + z * u


@compiled_part
def _add_contact(  # type: ignore[no-untyped-def]  # pragma: no cover
    tree, touch, rows, first, count, work, motions, forces_of_bodies, moves, hessian
):
    """Adds a contact, whose first row is given; returns whether it is known."""
    contact = rows.contacts + rows.size * mj.int32_at(rows.id, first)
    g1, g2 = mj.int32_at(contact, _GEOMS), mj.int32_at(contact, _GEOMS + 1)
    if g1 < 0 or g2 < 0:
        return False
    b1, b2 = touch.geom_body[g1], touch.geom_body[g2]
    axis, point, com = work.axis, work.point, tree.subtree_com
    for m in range(3):
        point[m] = mj.double_at(contact, _POSITION + m)
        for k in range(3):
            axis[m, k] = mj.double_at(contact, _FRAME + 3 * m + k)
    r1, r2 = tree.body_root[b1], tree.body_root[b2]
    o1 = point[0] - com[r1, 0], point[1] - com[r1, 1], point[2] - com[r1, 2]
    o2 = point[0] - com[r2, 0], point[1] - com[r2, 1], point[2] - com[r2, 2]
    size = _find_chain(tree, work, o1, o2, b1, b2)
    if not _describe_motion(touch, work, contact, g1, g2, size):
        return False

    # Motions at the contact: J a and J v of each body, and their difference, at rows 0 to 5.
    plain, velocity = motions
    small = work.small
    e1, e2 = tree.body_end[b1], tree.body_end[b2]
    _put_in_frame(axis, o2, plain, e2, small, 0)
    _put_in_frame(axis, o1, plain, e1, small, 1)
    _put_in_frame(axis, o2, velocity, e2, small, 2)
    _put_in_frame(axis, o1, velocity, e1, small, 3)
    for k in range(6):
        small[4, k] = small[0, k] - small[1, k]
        small[5, k] = small[2, k] - small[3, k]

    dim = _find_law(rows, first, count, contact, work)
    wrench, force = work.wrench, work.force_of_contact
    for k in range(3):
        wrench[0, k] = force[3 + k]
        wrench[0, 3 + k] = force[k]
    for c in range(size):
        base = np.int64(tree.base[work.chain[c]])
        _change_motion(work, o1, o2, plain, 0, base, c)
        _change_motion(work, o1, o2, velocity, 1, base, c)
        _add_column(work, dim, size, c, moves, hessian)
    n = len(hessian)
    if e2 < n:
        _put_wrench(wrench, axis, o2, -1.0, forces_of_bodies, b2)
    if e1 < n:
        _put_wrench(wrench, axis, o1, 1.0, forces_of_bodies, b1)
    return True


@compiled_part
def _find_chain(tree, work, o1, o2, b1, b2):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the degrees of freedom that move a contact, the last one first, and their twists.

    Returns how many they are.
    """
    n = len(tree.parent)
    axis, chain, one, two, both = work.axis, work.chain, work.first, work.second, work.relative
    size, i, j = 0, np.int64(tree.body_end[b2]), np.int64(tree.body_end[b1])
    while i < n or j < n:
        last = i if j == n else j if i == n else max(i, j)
        chain[size] = last
        for k in range(6):
            one[size, k] = two[size, k] = 0.0
        if i == last:
            _put_in_frame(axis, o2, tree.cdof, last, two, size)
            i = np.int64(tree.parent[last])
        if j == last:
            _put_in_frame(axis, o1, tree.cdof, last, one, size)
            j = np.int64(tree.parent[last])
        for k in range(6):
            both[size, k] = two[size, k] - one[size, k]
        size += 1
    return size


@compiled_part
def _find_law(rows, first, count, contact, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes a contact's force along its axes, and how it follows relative motions and distance.

    Returns the dimension of the force.
    """
    force, by_distance = work.force_of_contact, work.by_distance
    for k in range(6):
        force[k] = by_distance[k] = 0.0
        for m in range(6):
            work.basis[k, m] = work.by_velocity[k, m] = 0.0
    is_pyramid = mj.int32_at(rows.kind, first) == _PYRAMIDAL
    is_ellipse = mj.int32_at(rows.kind, first) == _ELLIPTIC
    dim = count // 2 + 1 if is_pyramid else count
    if not (is_ellipse and _follow_cone(rows, first, dim, contact, work)):
        for e in range(count):
            _follow_edge(rows, first, e, dim, is_pyramid, is_ellipse, contact, work)
    _, harder = _pull(rows, first)
    for k in range(dim):
        by_distance[k] += harder * force[k]
    return dim


@compiled_part
def _follow_cone(rows, first, dim, contact, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Does that where an elliptic cone bounds the force; returns whether one does."""
    small, edges, basis = work.small, work.edges, work.basis
    mu, t = mj.double_at(contact, _MU), 0.0
    for k in range(dim):
        moved = small[4, 3 + k] if k < 3 else small[4, k - 3]
        edges[0, k] = mu if k == 0 else mj.double_at(contact, _FRICTION + k - 1)
        edges[1, k] = (moved - mj.double_at(rows.reference, first + k)) * edges[0, k]
        t += edges[1, k] * edges[1, k] if k else 0.0
    t = np.sqrt(t)
    if not (mu * edges[1, 0] + t > 0.0 and t > 0.0):
        return False
    d = mj.double_at(rows.weight, first) / (mu * mu * (1.0 + mu * mu))
    pull, _ = _pull(rows, first)
    for k in range(dim):
        for m in range(dim):
            if k == 0 or m == 0:
                c = 1.0 if k == m else -mu / t * edges[1, k + m]
            else:
                c = mu * edges[1, 0] / (t * t * t) * edges[1, k] * edges[1, m]
                if k == m:
                    c += mu * mu - mu * edges[1, 0] / t
            basis[k, m] = c * d * edges[0, k] * edges[0, m]
            damping = mj.double_at(rows.kbip, 4 * (first + m) + 1)
            work.by_velocity[k, m] = basis[k, m] * damping
        work.force_of_contact[k] = mj.double_at(rows.force, first + k)
        work.by_distance[k] = -basis[k, 0] * pull
    return True


@compiled_part
def _follow_edge(  # type: ignore[no-untyped-def]  # pragma: no cover
    rows, first, e, dim, is_pyramid, is_ellipse, contact, work
):
    """Does that for one edge of a pyramid, or one direction of a force that no cone bounds."""
    edge, edges = first + e, work.edges
    for k in range(dim):
        edges[e, k] = 0.0
    if is_pyramid:
        k = e // 2
        slip = mj.double_at(contact, _FRICTION + k)
        edges[e, 0], edges[e, k + 1] = 1.0, -slip if e % 2 else slip
    else:
        edges[e, e] = 1.0
    f = mj.double_at(rows.force, edge)
    d = mj.double_at(rows.weight, edge) if f != 0.0 or is_ellipse else 0.0
    damping = mj.double_at(rows.kbip, 4 * edge + 1)
    pull, _ = _pull(rows, edge)
    for k in range(dim):
        if edges[e, k] == 0.0:
            continue
        work.force_of_contact[k] += f * edges[e, k]
        if is_pyramid or e == 0:
            work.by_distance[k] -= d * pull * edges[e, k]
        for m in range(dim):
            work.basis[k, m] += d * edges[e, k] * edges[e, m]
            work.by_velocity[k, m] += d * damping * edges[e, k] * edges[e, m]


@compiled_part
def _change_motion(  # type: ignore[no-untyped-def]  # pragma: no cover
    work, o1, o2, up, part, base, c
):
    """Writes how column c changes the relative a (part 0) or v (part 1) at the contact."""
    change, small = work.change, work.small
    for k in range(6):
        change[part, k] = 0.0
    for side in range(2):
        twists = work.second if side == 0 else work.first
        if _dot(twists, c, twists, c) == 0.0:
            continue
        _put_in_frame(work.axis, o2 if side == 0 else o1, up, base, small, 6)
        for k in range(6):
            small[6, k] = small[2 * part + side, k] - small[6, k]
        _cross(twists, c, small, 6, small, 7)
        sign = 1.0 if side == 0 else -1.0
        for k in range(6):
            change[part, k] += sign * small[7, k]
    # the point moves by `spot`, the axes turn by `turn`
    x, y, o = _row3(work.spot, c)
    p, q, r = _row3(work.turn, c)
    wx, wy, wz, vx, vy, vz = _row(small, 4 + part)
    lx = wy * o - wz * y - (q * vz - r * vy)
    ly = wz * x - wx * o - (r * vx - p * vz)
    lz = wx * y - wy * x - (p * vy - q * vx)
    ax, ay, az = q * wz - r * wy, r * wx - p * wz, p * wy - q * wx
    _add(change, part, 1.0, -ax, -ay, -az, lx, ly, lz)


@compiled_part
def _add_column(work, dim, size, c, moves, hessian):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds the column of a degree of freedom that moves the contact to H and to −∂r."""
    basis, by_velocity, change, rates = work.basis, work.by_velocity, work.change, work.rates
    wrench, small, both, chain = work.wrench, work.small, work.relative, work.chain
    n, j = len(hessian), chain[c]
    for k in range(6):
        rates[k] = 0.0
    for k in range(dim):
        rates[k] = work.by_distance[k] * work.spot[c, 3]
        for m in range(dim):
            at = 3 + m if m < 3 else m - 3
            rates[k] -= basis[k, m] * change[0, at] + by_velocity[k, m] * change[1, at]
    # the wrench's change at a fixed point: R δg + Ω × F, and its torque with δp × F
    p, q, r = _row3(work.turn, c)
    x, y, o = _row3(work.spot, c)
    tx, ty, tz, fx, fy, fz = _row(wrench, 0)
    ax, ay, az = q * tz - r * ty + y * fz - o * fy, r * tx - p * tz + o * fx - x * fz, x * fy
    az += p * ty - q * tx - y * fx
    lx, ly, lz = q * fz - r * fy, r * fx - p * fz, p * fy - q * fx
    _put(wrench, 1, ax, ay, az, lx, ly, lz)
    for k in range(6):
        wrench[1, k] += rates[k + 3 if k < 3 else k - 3]
    for k in range(6):
        wrench[2, k] = wrench[3, k] = wrench[1, k]
    _add_cross_force(work.second, c, wrench, 0, -1.0, wrench, 2)
    _add_cross_force(work.first, c, wrench, 0, -1.0, wrench, 3)
    for k in range(dim):  # forces by J a, and by J v
        rates[k] = small[6, k] = 0.0
        for m in range(dim):
            at = 3 + m if m < 3 else m - 3
            rates[k] += basis[k, m] * both[c, at]
            small[6, k] += by_velocity[k, m] * both[c, at]
    for d in range(size):
        i = chain[d]
        moves[i, j] += _dot(work.second, d, wrench, 2) - _dot(work.first, d, wrench, 3)
        for k in range(dim):
            at = 3 + k if k < 3 else k - 3
            hessian[i, j] += both[d, at] * rates[k]
            moves[i, n + j] -= both[d, at] * small[6, k]


@compiled_part
def _put_wrench(w, axis, offset, sign, force, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds the wrench of a contact to the forces of a body."""
    x, y, z = offset
    t0 = t1 = t2 = f0 = f1 = f2 = 0.0
    for m in range(3):
        p, q, r = _row3(axis, m)
        t, f = w[0, m], w[0, 3 + m]
        t0, t1, t2 = t0 + p * t, t1 + q * t, t2 + r * t
        f0, f1, f2 = f0 + p * f, f1 + q * f, f2 + r * f
    t0, t1, t2 = t0 + y * f2 - z * f1, t1 + z * f0 - x * f2, t2 + x * f1 - y * f0
    _add(force, b, sign, t0, t1, t2, f0, f1, f2)


@compiled_part
def _describe_motion(touch, work, contact, g1, g2, size):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes how each column moves a contact's point, distance and axes; returns if it is known.

    All of it is along the contact's axes: `spot` is the point's and the distance's, `turn` the
    axes'.
    """
    axis, spot, turn = work.axis, work.spot, work.turn
    one, two = work.first, work.second
    t1, t2 = touch.geom_type[g1], touch.geom_type[g2]
    gap = mj.double_at(contact, _DISTANCE)
    # The tangent is the part across the normal of a capsule's axis, or of an axis of the world.
    x, y, z = 0.0, 0.0, 0.0
    is_laid = t1 == _PLANE and t2 == _CAPSULE
    if is_laid:
        x, y, z = touch.geom_xmat[g2, 2], touch.geom_xmat[g2, 5], touch.geom_xmat[g2, 8]
    elif -0.5 < axis[0, 1] < 0.5:
        y = 1.0
    else:
        z = 1.0
    along = axis[0, 0] * x + axis[0, 1] * y + axis[0, 2] * z
    across = axis[1, 0] * x + axis[1, 1] * y + axis[1, 2] * z
    if not across > 1e-9:
        return False
    if t1 == _PLANE and (t2 <= _CAPSULE or _BOX <= t2 <= _MESH):
        radius = touch.geom_size[g2, 0] if t2 <= _CAPSULE else 0.0
        reach = radius + gap / 2.0
        for c in range(size):
            _, q, r, s, t, u = _row(two, c)
            _, y1, z1, d, _, _ = _row(one, c)
            # s × n = (0, s_2, −s_1)
            spot[c, 0], spot[c, 3] = s - (s - d) / 2.0, s - d
            spot[c, 1], spot[c, 2] = t + (r - z1) * reach, u - (q - y1) * reach
            turn[c, 1], turn[c, 2] = y1, z1
    elif t1 >= _SPHERE and t2 <= _CAPSULE:
        if not _roll(touch, work, gap, g1, g2, size):
            return False
    else:
        return False
    for c in range(size):
        # δn = Ω × n = (0, Ω_2, −Ω_1); a capsule's axis e turns by ω × e.
        turned = 0.0
        if is_laid:
            turned = two[c, 0] * across - two[c, 1] * along
        turn[c, 0] = (turned + along * turn[c, 1]) / across
    return True


@compiled_part
def _roll(touch, work, gap, g1, g2, size):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Does that for two of spheres and capsules: the nearest points of their axes may slide."""
    axis, point = work.axis, work.point
    spot, turn, one, two = work.spot, work.turn, work.first, work.second
    small = work.small
    reach = gap / 2.0
    r1, r2 = touch.geom_size[g1, 0] + reach, touch.geom_size[g2, 0] + reach
    length = r1 + r2
    if not length > 1e-9:
        return False
    for side in range(2):  # axes of capsules whose nearest point is none of their ends
        g, sign = (g1, -r1) if side == 0 else (g2, r2)
        at = 0.0
        for k in range(3):
            small[side, k] = 0.0
        for k in range(3):
            offset = point[k] + sign * axis[0, k] - touch.geom_xpos[g, k]
            at += offset * touch.geom_xmat[g, 3 * k + 2]
        if touch.geom_type[g] == _CAPSULE and abs(at) < touch.geom_size[g, 1] - 1e-9:
            for m in range(3):
                for k in range(3):
                    small[side, m] += axis[m, k] * touch.geom_xmat[g, 3 * k + 2]
    a, b = _dot3(small, 0, small, 0), _dot3(small, 1, small, 1)
    ab = _dot3(small, 0, small, 1)
    if a > 0.0 and b > 0.0 and 1.0 - ab * ab < _STRAIGHT:
        return False
    ax, ay, az = _row3(small, 0)
    bx, by, bz = _row3(small, 1)
    for c in range(size):
        # Nearest points c_1, c_2 at −r_1 n and r_2 n: their motion with the bodies, s + w × r n.
        _, q1, w1, x1, y1, z1 = _row(one, c)
        _, q2, w2, x2, y2, z2 = _row(two, c)
        y1, z1 = y1 - w1 * r1, z1 + q1 * r1
        x, y, z = x2 - x1, y2 + w2 * r2 - y1, z2 - q2 * r2 - z1
        # (w × a) · (length n) + a · (δ + σ_2 a_2 − σ_1 a_1) = 0 for each free axis a
        f1 = length * (q1 * az - w1 * ay) + ax * x + ay * y + az * z
        f2 = length * (q2 * bz - w2 * by) + bx * x + by * y + bz * z
        s1 = s2 = 0.0
        if a > 0.0 and b > 0.0:
            s1 = (f1 - ab * f2) / (1.0 - ab * ab)
            s2 = (ab * f1 - f2) / (1.0 - ab * ab)
        elif a > 0.0:
            s1 = f1
        elif b > 0.0:
            s2 = -f2
        x, y, z = x + s2 * bx - s1 * ax, y + s2 * by - s1 * ay, z + s2 * bz - s1 * az
        # δn = (0, y, z) / length; p = c_1 + r_1 n, with r_1 that changes by half of the distance
        spot[c, 0], spot[c, 3] = x1 + s1 * ax + x / 2.0, x
        spot[c, 1], spot[c, 2] = y1 + s1 * ay + r1 * y / length, z1 + s1 * az + r1 * z / length
        turn[c, 1], turn[c, 2] = -z / length, y / length
    return True


@compiled_part
def put_moves(sim, mech, after, work, positions, a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the derivatives of a step by H and −∂r, which it overwrites.

    Columns of positions that are not among `positions` stay as they are.
    """
    h = sim.structure.time_step
    moves, other = work.moves, work.other
    n, n_a, n_u = len(sim.qvel), len(sim.act), len(sim.ctrl)
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
            turn(sim, after, moves)
            _add_own(sim, after, moves)
        for i in range(n):
            for j in positions:
                a[first + i, j] = moves[i, j]
            for j in range(n, n_dx):
                a[first + i, j] = moves[i, j]
            for j in range(n_u):
                b[first + i, j] = moves[i, n_dx + j]


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
