# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds the positions on which nothing depends, such as how far a robot has gone along a floor.

The rest of the motion is the same wherever it starts along such a coordinate. So the derivatives
along it are known, and no finite difference is taken.
"""

import mujoco
import numpy as np

_JOINT, _TRANSMISSION, _WRAP = mujoco.mjtJoint, mujoco.mjtTrn, mujoco.mjtWrap


def cyclic_positions(model: mujoco.MjModel) -> list[int]:
    """Returns the cyclic positions, as indices in a deviation.

    They are translations of the one body that moves in the world, along a direction in which all
    that stands in the world, if anything does, is planes.
    """
    if model.ntree != 1 or model.neq or model.nmocap or model.nplugin:
        return []
    found = []
    first = int(np.flatnonzero(model.body_dofnum)[0])
    if model.body_weldid[model.body_parentid[first]] != 0 or _is_tied(model, first):
        return []
    for joint in range(
        model.body_jntadr[first], model.body_jntadr[first] + model.body_jntnum[first]
    ):
        dof = int(model.jnt_dofadr[joint])
        if model.jnt_type[joint] == _JOINT.mjJNT_FREE:
            axes = np.eye(3)
        elif model.jnt_type[joint] == _JOINT.mjJNT_SLIDE:
            axes = _in_world(model, first, model.jnt_axis[joint])[None]
        else:
            break  # the axes of joints behind a rotation turn with it
        if not _is_held(model, joint):
            found += [dof + i for i, axis in enumerate(axes) if _is_level(model, axis)]
    return found


def _in_world(model: mujoco.MjModel, body: int, axis: np.ndarray) -> np.ndarray:
    """Returns a direction of a body's frame in the world, before any joint has moved."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return np.asarray(data.xmat[body].reshape(3, 3) @ axis)


def _is_tied(model: mujoco.MjModel, root: int) -> bool:
    """Returns whether a tendon runs over a joint of the root, or over something in the world."""
    for kind, target in zip(model.wrap_type, model.wrap_objid, strict=True):
        if kind == _WRAP.mjWRAP_JOINT and model.jnt_bodyid[target] == root:
            return True
        if kind == _WRAP.mjWRAP_SITE and model.body_weldid[model.site_bodyid[target]] == 0:
            return True
        is_geom = kind in (_WRAP.mjWRAP_SPHERE, _WRAP.mjWRAP_CYLINDER)
        if is_geom and model.body_weldid[model.geom_bodyid[target]] == 0:
            return True
    return False


def _is_held(model: mujoco.MjModel, joint: int) -> bool:
    """Returns whether a spring, a limit or an actuator pulls a joint to a position."""
    if model.jnt_limited[joint] or model.jnt_stiffness[joint].any():
        return True
    for i in range(model.nu):
        kind, target = _TRANSMISSION(model.actuator_trntype[i]), model.actuator_trnid[i]
        pulls = model.actuator_biasprm[i, 1] or model.actuator_gaintype[i]
        if kind == _TRANSMISSION.mjTRN_SITE and target[1] < 0:
            continue  # a force in the frame of a site
        if kind == _TRANSMISSION.mjTRN_TENDON:
            continue  # it is not tied to the world
        if kind not in (_TRANSMISSION.mjTRN_JOINT, _TRANSMISSION.mjTRN_JOINTINPARENT):
            return True
        if target[0] == joint and pulls:
            return True
    return False


def _is_level(model: mujoco.MjModel, axis: np.ndarray) -> bool:
    """Returns whether all that can be touched in the world are planes along an axis."""
    standing = model.body_weldid[model.geom_bodyid] == 0
    pairs = np.concatenate([model.pair_geom1, model.pair_geom2])
    touchable = (model.geom_contype | model.geom_conaffinity) != 0
    touchable[pairs] = True
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in np.flatnonzero(standing & touchable):
        normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE or abs(normal @ axis) > 1e-12:
            return False
    return True
