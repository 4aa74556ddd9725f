# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Constraints in derivatives of a step: what limits, friction and contacts add to ∂r.

The point p, the normal n and the distance of a contact between a plane and a sphere, a capsule's
end or a corner, or between two of spheres and capsules, move with their bodies. So do the relative
motions J a and J v, the forces f, and the wrench W at p. Other contacts have no closed form.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compiled_part
from vgps_ros.core.records import Array
from vgps_ros.simulation import mujoco_functions as mj
from vgps_ros.simulation.compiled_spatial import (
    add_cross_force,
    add_to_row,
    cross,
    dot,
    dot3,
    put_row,
    row,
    row3,
)

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


class Rows(NamedTuple):
    """The constraints of a step: their number, and where MuJoCo keeps their numbers.

    Attributes:
        number: of the rows of all constraints.
        contacts: address of the contacts' records.
        size: of such a record [B].
        kind: address of the rows' kinds; the others are those of the fields of this name.
    """

    number: np.int64
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
def add_constraints(mech, data, work):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds constraints to H, to −∂r and to the forces on bodies; returns whether all are known."""
    rows = _find_rows(mech.touch, data)
    e = np.int64(0)
    while e < rows.number:
        if mj.int32_at(rows.kind, e) < _FIRST_CONTACT:
            _add_row(rows, e, mech.is_sparse, work.hessian, work.moves)
            e += 1
            continue
        count, acts = _count_rows(rows, e)
        if acts and not _add_contact(mech, rows, e, count, work):
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
    while e < rows.number and mj.int32_at(rows.kind, e) == kind and mj.int32_at(rows.id, e) == name:
        acts |= mj.double_at(rows.force, e) != 0.0
        e += 1
    return e - first, acts


@compiled_part
def _put_in_frame(axis, origin, a, i, out, k):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes a twist a_i at a contact, along its axes; the offset from the twist's origin."""
    p, q, r, s, t, u = row(a, i)
    x, y, z = origin
    s, t, u = s + q * z - r * y, t + r * x - p * z, u + p * y - q * x
    for m in range(3):
        x, y, z = row3(axis, m)
        out[k, m] = x * p + y * q + z * r
        out[k, 3 + m] = x * s + y * t + z * u


@compiled_part
def _add_contact(mech, rows, first, count, memory):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Adds a contact, whose first row is given; returns whether it is known."""
    tree, touch, work = mech.tree, mech.touch, memory.contact
    plain, velocity, forces = memory.plain, memory.velocity, memory.force
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
        _add_column(work, dim, size, c, memory.moves, memory.hessian)
    n = len(memory.hessian)
    if e2 < n:
        _put_wrench(wrench, axis, o2, -1.0, forces, b2)
    if e1 < n:
        _put_wrench(wrench, axis, o1, 1.0, forces, b1)
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
        if dot(twists, c, twists, c) == 0.0:
            continue
        _put_in_frame(work.axis, o2 if side == 0 else o1, up, base, small, 6)
        for k in range(6):
            small[6, k] = small[2 * part + side, k] - small[6, k]
        cross(twists, c, small, 6, small, 7)
        sign = 1.0 if side == 0 else -1.0
        for k in range(6):
            change[part, k] += sign * small[7, k]
    # the point moves by `spot`, the axes turn by `turn`
    x, y, o = row3(work.spot, c)
    p, q, r = row3(work.turn, c)
    wx, wy, wz, vx, vy, vz = row(small, 4 + part)
    lx = wy * o - wz * y - (q * vz - r * vy)
    ly = wz * x - wx * o - (r * vx - p * vz)
    lz = wx * y - wy * x - (p * vy - q * vx)
    ax, ay, az = q * wz - r * wy, r * wx - p * wz, p * wy - q * wx
    add_to_row(change, part, 1.0, -ax, -ay, -az, lx, ly, lz)


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
    p, q, r = row3(work.turn, c)
    x, y, o = row3(work.spot, c)
    tx, ty, tz, fx, fy, fz = row(wrench, 0)
    ax, ay, az = q * tz - r * ty + y * fz - o * fy, r * tx - p * tz + o * fx - x * fz, x * fy
    az += p * ty - q * tx - y * fx
    lx, ly, lz = q * fz - r * fy, r * fx - p * fz, p * fy - q * fx
    put_row(wrench, 1, ax, ay, az, lx, ly, lz)
    for k in range(6):
        wrench[1, k] += rates[k + 3 if k < 3 else k - 3]
    for k in range(6):
        wrench[2, k] = wrench[3, k] = wrench[1, k]
    add_cross_force(work.second, c, wrench, 0, -1.0, wrench, 2)
    add_cross_force(work.first, c, wrench, 0, -1.0, wrench, 3)
    for k in range(dim):  # forces by J a, and by J v
        rates[k] = small[6, k] = 0.0
        for m in range(dim):
            at = 3 + m if m < 3 else m - 3
            rates[k] += basis[k, m] * both[c, at]
            small[6, k] += by_velocity[k, m] * both[c, at]
    for d in range(size):
        i = chain[d]
        moves[i, j] += dot(work.second, d, wrench, 2) - dot(work.first, d, wrench, 3)
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
        p, q, r = row3(axis, m)
        t, f = w[0, m], w[0, 3 + m]
        t0, t1, t2 = t0 + p * t, t1 + q * t, t2 + r * t
        f0, f1, f2 = f0 + p * f, f1 + q * f, f2 + r * f
    t0, t1, t2 = t0 + y * f2 - z * f1, t1 + z * f0 - x * f2, t2 + x * f1 - y * f0
    add_to_row(force, b, sign, t0, t1, t2, f0, f1, f2)


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
            _, q, r, s, t, u = row(two, c)
            _, y1, z1, d, _, _ = row(one, c)
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
    a, b = dot3(small, 0, small, 0), dot3(small, 1, small, 1)
    ab = dot3(small, 0, small, 1)
    if a > 0.0 and b > 0.0 and 1.0 - ab * ab < _STRAIGHT:
        return False
    ax, ay, az = row3(small, 0)
    bx, by, bz = row3(small, 1)
    for c in range(size):
        # Nearest points c_1, c_2 at −r_1 n and r_2 n: their motion with the bodies, s + w × r n.
        _, q1, w1, x1, y1, z1 = row(one, c)
        _, q2, w2, x2, y2, z2 = row(two, c)
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
