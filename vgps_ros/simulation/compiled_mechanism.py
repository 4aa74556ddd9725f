# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A model's tree of joints and its constraints, as compiled derivatives in closed form read them.

MuJoCo allocates contacts and constraints anew in each step. Compiled code finds them by pointers in
MuJoCo's record of a simulation, whose places are looked up once in a small simulation. These
records are private to a release of MuJoCo, so that each must be tried before it is listed here.
"""

import ctypes
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.records import Array
from vgps_ros.simulation.model import damping_varies

Indices = NDArray[np.int32]

# Fields of MuJoCo's record that are found by their addresses, and counts by their values.
POINTERS = (
    *("efc_type", "efc_id", "efc_J_rownnz", "efc_J_rowadr", "efc_J_colind", "efc_J", "efc_pos"),
    *("efc_margin", "efc_D", "efc_KBIP", "efc_aref", "efc_frictionloss", "efc_force"),
)
# Releases whose records compiled code knows; by others all positions are left to differences.
_KNOWN_RELEASES = ("4.0.0",)
_LENGTH = 40_540  # of what is searched of the record, in words of four bytes
_POS = 8  # offset of `pos` in a contact [B]
# What gives a tendon a force or an inertia of its own.
_OF_TENDONS = ["limited", "frictionloss", "armature", "actfrclimited", "stiffness", "damping"]
_OF_TENDONS += ["stiffnesspoly", "dampingpoly"]
_ROLLER = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body><freejoint/><geom type="capsule" fromto="-.1 0 0 .1 0 0" size=".1"/></body>
  </worldbody>
</mujoco>
"""


class Tree(NamedTuple):
    """A model's tree of joints, and the vectors of MuJoCo that describe its bodies' motion.

    Attributes:
        parent: the degree of freedom before each; n_v if there is none, here and below.
        base: the last one that moves before the axes that turn with each do.
        end: the last one whose axis turns with each.
        body: the body that each moves.
        body_parent: of each body.
        body_end: the last degree of freedom that moves each body.
        body_root: the body whose subtree's centre of mass is the origin of its vectors.
        subtree_com: these centres, (n_b, 3) [m].
        cdof: S, the twist of each degree of freedom, (n_v, 6).
        cinert: I of each body, (n_b, 10).
        crb: Iᶜ, (n_b, 10).
    """

    parent: Indices
    base: Indices
    end: Indices
    body: Indices
    body_parent: Indices
    body_end: Indices
    body_root: Indices
    subtree_com: Array
    cdof: Array
    cinert: Array
    crb: Array


class Touch(NamedTuple):
    """What tells how a contact moves with its bodies.

    Attributes:
        geom_type: of each shape.
        geom_body: the body that has it.
        geom_size: (n, 3) [m].
        geom_xpos: (n, 3) [m].
        geom_xmat: (n, 9).
        contact_places: offset of the contacts' pointer and of the number of constraints in MuJoCo's
            record [B]; size of a contact's record [B].
        places: offsets of POINTERS.
    """

    geom_type: Indices
    geom_body: Indices
    geom_size: Array
    geom_xpos: Array
    geom_xmat: Array
    contact_places: NDArray[np.int64]
    places: NDArray[np.int64]


class Mechanism(NamedTuple):
    """What derivatives in closed form need of a model and its simulation.

    Attributes:
        is_known: whether each force but those of contacts has a derivative in closed form.
        is_damped: whether damping is integrated implicitly.
        is_sparse: whether rows of the constraints' Jacobian leave out zeros.
        tree: the tree of joints.
        touch: the contacts.
        gravity: (3,) [m/s²].
        held: share of each body's weight that gravity compensation holds, (n_b,).
        stiffness: of the springs at joints, (n_v,).
        damping: of the joints, (n_v,).
        lowest: lowest forces of actuators at each degree of freedom.
        highest: highest ones.
        actuator_of_act: the actuator of each activation.
        mass: M, row after row of its lower half without zeros; mass_lengths, mass_starts and
            mass_columns tell where each stands.
        system: factors of M̂ in the same order, if damping is integrated implicitly.
        system_inverse_diagonal: the inverse of D among them.
        moment: of actuators at degrees of freedom, as M.
        actuator_length: what their forces follow.
        actuator_velocity: the same.
        actuator_force: their forces.
    """

    is_known: bool
    is_damped: bool
    is_sparse: bool
    tree: Tree
    touch: Touch
    gravity: Array
    held: Array
    stiffness: Array
    damping: Array
    lowest: Array
    highest: Array
    actuator_of_act: Indices
    mass: Array
    mass_lengths: Indices
    mass_starts: Indices
    mass_columns: Indices
    system: Array
    system_inverse_diagonal: Array
    moment: Array
    moment_lengths: Indices
    moment_starts: Indices
    moment_columns: Indices
    actuator_length: Array
    actuator_velocity: Array
    actuator_force: Array


def mechanism_of(model: mujoco.MjModel, data: mujoco.MjData) -> Mechanism:
    """Returns the mechanism of a model."""
    is_release_known = mujoco.__version__ in _KNOWN_RELEASES
    n, free, ball = model.nv, int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    parent = np.where(model.dof_parentid < 0, n, model.dof_parentid).astype(np.int32)
    base, end = parent.copy(), np.arange(n, dtype=np.int32)
    for kind, first in zip(model.jnt_type, model.jnt_dofadr, strict=True):
        firsts = [first, first + 3] if kind == free else [first] if kind == ball else []
        for i in firsts:
            base[i : i + 3], end[i : i + 3] = parent[i], i + 2
    body_end = np.full(model.nbody, n, np.int32)
    for b in range(1, model.nbody):
        own = model.body_dofnum[b]
        before = body_end[model.body_parentid[b]]
        body_end[b] = model.body_dofadr[b] + own - 1 if own else before
    is_single = model.jnt_type[model.dof_jntid] >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    springs = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_SPRING
    damper = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER
    pulls = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    damps = not model.opt.disableflags & (
        mujoco.mjtDisableBit.mjDSBL_DAMPER | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    )
    damping, joints = model.dof_damping.copy(), model.actuator_trnid[:, 0].clip(0)
    if model.actuator_damping.any():  # of actuators at hinges and slides
        slowed = model.actuator_gear[:, 0] ** 2 * model.actuator_damping
        np.add.at(damping, model.jnt_dofadr[joints], slowed)
    is_implicit = model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    has_limit = model.jnt_actfrclimited[model.dof_jntid].astype(bool)
    lowest, highest = model.jnt_actfrcrange[model.dof_jntid].T
    of_act = np.zeros(model.na, np.int32)
    for actuator, act in enumerate(model.actuator_actadr):
        if act >= 0:
            of_act[act] = actuator
    none = np.zeros(3, np.int64)
    bodies = model.dof_bodyid, model.body_parentid, body_end, model.body_rootid
    return Mechanism(
        bool(is_release_known and _is_balance(model) and _is_known(model)),
        bool(is_implicit or (damps and damping.any())),
        bool(mujoco.mj_isSparse(model)),
        Tree(*(parent, base, end, *bodies), *(data.subtree_com, data.cdof, data.cinert, data.crb)),
        Touch(
            *(model.geom_type, model.geom_bodyid, model.geom_size),
            *(data.geom_xpos, data.geom_xmat),
            *(_places() if is_release_known else (none, none)),
        ),
        model.opt.gravity * pulls,
        model.body_gravcomp,
        np.where(is_single & springs, model.jnt_stiffness[model.dof_jntid], 0.0),
        damping * damper,
        np.where(has_limit, lowest, -np.inf),
        np.where(has_limit, highest, np.inf),
        of_act,
        *(data.M, model.M_rownnz, model.M_rowadr, model.M_colind, data.qH, data.qHDiagInv),
        *(data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind),
        *(data.actuator_length, data.actuator_velocity, data.actuator_force),
    )


def _is_balance(model: mujoco.MjModel) -> bool:
    """Returns whether a step is a balance of forces, integrated by a system of positions alone."""
    option, stages = model.opt, mujoco.mjtEnableBit
    other_stages = stages.mjENBL_SLEEP | stages.mjENBL_DIAGEXACT | stages.mjENBL_IPC
    is_fast = option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # A tree of a free joint alone is then integrated with its gyroscopic forces, which vary.
    is_free = model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
    alone = model.tree_dofnum[model.dof_treeid[model.jnt_dofadr[is_free]]] == 6
    return bool(
        (is_fast or option.integrator == mujoco.mjtIntegrator.mjINT_EULER)
        and not (is_fast and alone.any())
        and not option.disableflags & mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        and not option.enableflags & other_stages
        and not (option.noslip_iterations or model.nplugin or model.nflex)
        and not damping_varies(model)
    )


def _is_known(model: mujoco.MjModel) -> bool:
    """Returns whether each force but those of contacts has a derivative in closed form."""
    joints = int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    single = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    kind, moved = model.actuator_trntype, single[model.actuator_trnid[:, 0].clip(0)]
    plain = kind == joints[0]  # lengths of balls are no linear functions
    plain &= moved | ((model.actuator_gainprm[:, 1] == 0) & (model.actuator_biasprm[:, 1] == 0))
    plain |= (kind == joints[1]) & moved
    equality = model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)
    equality &= ~model.eq_data[:, 2:5].any(axis=1)
    muscle = int(mujoco.mjtDyn.mjDYN_MUSCLE)
    return bool(
        model.nu == model.nactuator == model.nout == len(kind)
        and plain.all()
        and (model.actuator_dyntype <= muscle).all()
        and (model.actuator_biastype <= int(mujoco.mjtBias.mjBIAS_AFFINE)).all()
        and not model.actuator_damping[~moved | (kind > joints[1])].any()
        and not any(getattr(model, f"tendon_{name}").any() for name in _OF_TENDONS)
        and not model.jnt_actgravcomp.any()
        and not model.jnt_stiffnesspoly.any()
        and not model.jnt_stiffness[~single].any()
        and not model.jnt_limited[~single].any()
        and not model.jnt_springyield.any()
        and not model.flg_adhesion
        and equality.all()
        and not model.nmocap
    )


@cache
def _places() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns where in MuJoCo's record the fields stand that compiled code reads."""
    model = mujoco.MjModel.from_xml_string(_ROLLER)
    data = mujoco.MjData(model)
    is_count = np.array(True)
    for height in (0.09, 1.0, 0.09):  # with two contacts, none and two
        data.qpos[2] = height
        mujoco.mj_forward(model, data)
        words = np.ctypeslib.as_array((ctypes.c_int32 * _LENGTH).from_address(data._address))
        is_count = is_count & (words == data.nefc)
    pointers = list(words.view(np.int64))
    one, two = (contact.pos.ctypes.data for contact in data.contact)
    addresses = one - _POS, *(getattr(data, name).ctypes.data for name in POINTERS)
    contacts, *places = (8 * pointers.index(address) for address in addresses)
    (count,) = 4 * np.flatnonzero(is_count)
    return np.array([contacts, count, two - one]), np.array(places)
