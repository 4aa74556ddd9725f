# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Converts the geometries of a MuJoCo model to shapes that Rerun draws."""

from typing import Any

import mujoco
import numpy as np
import rerun as rr

_WALL = 50.0  # half the side at which an unbounded plane is drawn [m]
_SLAB = 0.005  # half the thickness at which a plane is drawn [m]


def floor(model: mujoco.MjModel) -> int | None:
    """Returns the index of the floor, which is the model's first plane, or None without one."""
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    return int(planes[0]) if len(planes) else None


def geometries(model: mujoco.MjModel) -> dict[str, tuple[int, Any]]:
    """Returns the index and the shape of each geometry that can be drawn, by its name.

    The floor is not among them: lines stand for it, which Rerun would hide behind a filled floor.
    """
    pictures = {}
    for i in range(model.ngeom):
        picture = _picture(model, i) if i != floor(model) else None
        if picture is not None and model.geom_rgba[i, 3] > 0:
            pictures[model.geom(i).name or f"geom_{i}"] = (i, picture)
    return pictures


def _picture(model: mujoco.MjModel, i: int) -> Any:
    a, b, c = model.geom_size[i].tolist()
    colours = [[round(255 * part) for part in model.geom_rgba[i]]]
    solid: dict[str, Any] = {"colors": colours, "fill_mode": "solid"}
    match mujoco.mjtGeom(model.geom_type[i]):
        case mujoco.mjtGeom.mjGEOM_PLANE:
            sides = [[a or _WALL, b or _WALL, _SLAB]]
            return rr.Boxes3D(half_sizes=sides, centers=[[0.0, 0.0, -_SLAB]], **solid)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return rr.Ellipsoids3D(half_sizes=[[a, a, a]], **solid)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            # Rerun's capsule starts at its origin; MuJoCo's capsule is centred on it.
            start = [[0.0, 0.0, -b]]
            return rr.Capsules3D(lengths=[2 * b], radii=[a], translations=start, **solid)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return rr.Ellipsoids3D(half_sizes=[[a, b, c]], **solid)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return rr.Cylinders3D(lengths=[2 * b], radii=[a], **solid)
        case mujoco.mjtGeom.mjGEOM_BOX:
            return rr.Boxes3D(half_sizes=[[a, b, c]], **solid)
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _mesh(model, int(model.geom_dataid[i]), model.geom_rgba[i])
    return None  # Rerun has no shape for height fields and signed distance functions


def _mesh(model: mujoco.MjModel, i: int, rgba: np.ndarray) -> rr.Mesh3D:
    vertices = model.mesh_vertadr[i] + np.arange(model.mesh_vertnum[i])
    faces = model.mesh_faceadr[i] + np.arange(model.mesh_facenum[i])
    return rr.Mesh3D(
        vertex_positions=model.mesh_vert[vertices],
        triangle_indices=model.mesh_face[faces],
        albedo_factor=rgba,
    )
