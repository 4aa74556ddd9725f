"""The solids of an MJCF model as Rerun shows them.

MuJoCo centres a capsule and writes quaternions as wxyz; Rerun starts a capsule at its origin and
writes xyzw.
"""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import rerun as rr

from vgps_ros.core.records import Array

_ENDLESS = 50.0  # half the size at which an endless floor is drawn [m]
_THICKNESS = 0.002  # half the thickness at which a plane is drawn [m]
_SOLID = rr.components.FillMode.Solid


def body_paths(model: mujoco.MjModel) -> list[str]:
    """Returns the entity path of each body; the first one is the world."""
    names = [model.body(i).name or f"body_{i}" for i in range(model.nbody)]
    return [f"/robot/{name}" for name in names]


def body_pose(position: Array, quaternion: Array) -> rr.Transform3D:
    """Returns MuJoCo's pose of a body, [m] and wxyz, as a transform."""
    return rr.Transform3D(translation=position, quaternion=np.roll(quaternion, -1))


def solids(model: mujoco.MjModel) -> Iterator[tuple[str, Any]]:
    """Yields the entity path and the archetype of each solid, placed in the frame of its body."""
    bodies = body_paths(model)
    for i in range(model.ngeom):
        geom = model.geom(i)
        solid = _solid(geom)
        if solid is not None:
            yield f"{bodies[geom.bodyid[0]]}/{geom.name or f'geom_{i}'}", solid


def _solid(geom: Any) -> Any:
    """The archetype of one geom; None for a kind that is not drawn, such as a mesh."""
    size, quaternion = geom.size, np.roll(geom.quat, -1)
    look = {"quaternions": [quaternion], "colors": [geom.rgba], "fill_mode": _SOLID}
    kind = mujoco.mjtGeom(geom.type[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, geom.quat)
        start = geom.pos - size[1] * rotation.reshape(3, 3)[:, 2]
        return rr.Capsules3D(
            lengths=[2 * size[1]], radii=[size[0]], translations=[start], **look
        )
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return rr.Cylinders3D(lengths=[2 * size[1]], radii=[size[0]], centers=[geom.pos], **look)
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        half = np.full(3, size[0]) if kind == mujoco.mjtGeom.mjGEOM_SPHERE else size
        return rr.Ellipsoids3D(half_sizes=[half], centers=[geom.pos], **look)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return rr.Boxes3D(half_sizes=[size], centers=[geom.pos], **look)
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        half = np.array([size[0] or _ENDLESS, size[1] or _ENDLESS, _THICKNESS])
        return rr.Boxes3D(half_sizes=[half], centers=[geom.pos - [0, 0, _THICKNESS]], **look)
    return None
