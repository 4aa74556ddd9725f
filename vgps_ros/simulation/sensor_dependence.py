# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads off the tree of bodies which joints a sensor's value depends on.

A sensor of where a body is, or how it moves, feels the joints between that body and the world only.
So few finite differences are needed for it, and no forces.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

_SENSOR, _OBJECT = mujoco.mjtSensor, mujoco.mjtObj
# Sensors of one frame, perhaps relative to another one.
_OF_FRAMES = {
    *(_SENSOR.mjSENS_FRAMEPOS, _SENSOR.mjSENS_FRAMEQUAT),
    *(_SENSOR.mjSENS_FRAMEXAXIS, _SENSOR.mjSENS_FRAMEYAXIS, _SENSOR.mjSENS_FRAMEZAXIS),
    *(_SENSOR.mjSENS_FRAMELINVEL, _SENSOR.mjSENS_FRAMEANGVEL),
    *(_SENSOR.mjSENS_GYRO, _SENSOR.mjSENS_VELOCIMETER),
}
# Sensors of a body with all that hangs on it.
_OF_SUBTREES = {
    *(_SENSOR.mjSENS_SUBTREECOM, _SENSOR.mjSENS_SUBTREELINVEL, _SENSOR.mjSENS_SUBTREEANGMOM),
}
_OF_JOINTS = {
    *(_SENSOR.mjSENS_JOINTPOS, _SENSOR.mjSENS_JOINTVEL),
    *(_SENSOR.mjSENS_BALLQUAT, _SENSOR.mjSENS_BALLANGVEL),
}


def needs_everything(model: mujoco.MjModel, sensor: int) -> bool:
    """Returns whether a sensor needs more than the positions and velocities of bodies."""
    if _SENSOR(model.sensor_type[sensor]) not in {*_OF_FRAMES, *_OF_SUBTREES, *_OF_JOINTS}:
        return True
    frames = (model.sensor_objtype[sensor], model.sensor_reftype[sensor])
    return int(_OBJECT.mjOBJ_CAMERA) in frames


def velocities_felt(model: mujoco.MjModel, sensor: int) -> NDArray[np.bool_]:
    """Returns the mask of the degrees of freedom, (n_v,), that such a sensor may depend on."""
    felt = np.zeros(model.nv, dtype=bool)
    bodies = [
        _body_of(model, model.sensor_objtype[sensor], model.sensor_objid[sensor]),
        _body_of(model, model.sensor_reftype[sensor], model.sensor_refid[sensor]),
    ]
    if _SENSOR(model.sensor_type[sensor]) in _OF_SUBTREES:
        bodies = [i for i in range(model.nbody) if bodies[0] in _ancestors(model, i)]
    for body in bodies:
        for each in _ancestors(model, body):
            first = model.body_dofadr[each]
            felt[first : first + model.body_dofnum[each]] = True
    return felt


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Returns a body, and all between it and the world, which is left out unless it is asked of."""
    found = [body]
    while model.body_parentid[found[-1]] > 0:
        found.append(int(model.body_parentid[found[-1]]))
    return found


def _body_of(model: mujoco.MjModel, kind: int, index: int) -> int:
    """Returns the body to which an object is fixed; the world where there is no object."""
    if index < 0:
        return 0
    owners = {
        _OBJECT.mjOBJ_GEOM: model.geom_bodyid,
        _OBJECT.mjOBJ_SITE: model.site_bodyid,
        _OBJECT.mjOBJ_JOINT: model.jnt_bodyid,
    }
    of_bodies = owners.get(_OBJECT(kind))
    return index if of_bodies is None else int(of_bodies[index])
