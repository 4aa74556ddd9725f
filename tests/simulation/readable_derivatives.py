# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives of inverse dynamics, written to be read; the compiled ones must agree with these."""

import mujoco
import numpy as np


def skew(v):
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def cross(twist):
    """V ×, of motions (turn, shift); V ×* of forces is −(V ×)ᵀ."""
    turn, shift = skew(twist[:3]), skew(twist[3:])
    return np.block([[turn, np.zeros((3, 3))], [shift, turn]])


def cross_force(force):
    """The matrix that maps ψ to ψ ×* F."""
    turn, shift = skew(force[:3]), skew(force[3:])
    return -np.block([[turn, shift], [shift, np.zeros((3, 3))]])


def inertia(numbers):
    xx, yy, zz, xy, xz, yz, *first, mass = numbers
    c = skew(first)
    turning = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.block([[turning, c], [-c, mass * np.eye(3)]])


def inverse_dynamics_rates(model, data, acceleration):
    """Returns ∂(M a + c)/∂q and ∂c/∂v of a model without ball joints, (n_v, n_v) each.

    Its free joints come first in their trees. `data` must hold what mj_forward has left.
    """
    n, twists = model.nv, data.cdof
    free = {*model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]}
    parent, base, end = model.dof_parentid, model.dof_parentid.copy(), np.arange(n)
    for first in free:
        base[first : first + 3], end[first : first + 3] = -1, first + 2
        base[first + 3 : first + 6], end[first + 3 : first + 6] = first + 2, first + 5
    velocity, total = np.zeros((n + 1, 6)), np.zeros((n + 1, 6))  # the last row is the world's
    total[-1, 3:] = -model.opt.gravity
    psi, zeta, chi = (np.zeros((n, 6)) for _ in range(3))
    for i, twist in enumerate(twists):
        carrier = cross(velocity[base[i]])
        psi[i] = carrier @ twist
        zeta[i] = cross(total[base[i]]) @ twist + carrier @ psi[i]
        velocity[i] = velocity[parent[i]] + twist * data.qvel[i]
        total[i] = total[parent[i]] + twist * acceleration[i] + psi[i] * data.qvel[i]
    for i, twist in enumerate(twists):
        chi[i] = psi[i] + cross(velocity[end[i]]) @ twist
    inertias, curls = np.zeros((model.nbody, 6, 6)), np.zeros((model.nbody, 6, 6))
    forces = np.zeros((model.nbody, 6))
    ends = np.full(model.nbody, -1)  # the last degree of freedom that moves each body
    for b in range(1, model.nbody):
        own = model.body_dofnum[b]
        ends[b] = model.body_dofadr[b] + own - 1 if own else ends[model.body_parentid[b]]
    for b in range(model.nbody - 1, 0, -1):
        own, last = inertia(data.cinert[b]), ends[b]
        v = cross(velocity[last])
        momentum = own @ velocity[last]
        inertias[b] += own
        curls[b] += -v.T @ own - own @ v + cross_force(momentum)
        forces[b] += own @ total[last] - v.T @ momentum
        if up := model.body_parentid[b]:
            inertias[up] += inertias[b]
            curls[up] += curls[b]
            forces[up] += forces[b]
    by_position, by_velocity = np.zeros((n, n)), np.zeros((n, n))
    for j, twist in enumerate(twists):
        b, i = model.dof_bodyid[j], j
        carried = inertias[b] @ zeta[j] + curls[b] @ psi[j] + cross_force(forces[b]) @ twist
        while i >= 0:
            below = inertias[b], curls[b]
            moved = twists[i] @ (below[0] @ zeta[j] + below[1] @ psi[j])
            by_position[i, j] = moved if base[i] == base[j] else twists[i] @ carried
            by_velocity[i, j] = twists[i] @ (below[0] @ chi[j] + below[1] @ twist)
            by_position[j, i] = twist @ (below[0] @ zeta[i] + below[1] @ psi[i])
            by_velocity[j, i] = twist @ (below[0] @ chi[i] + below[1] @ twists[i])
            if i == j:
                by_position[i, i] = moved
            i = parent[i]
    return by_position, by_velocity
