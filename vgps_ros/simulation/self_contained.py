# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The text of a model that needs no other file: it can be sent, recorded, and compiled anywhere."""

import warnings

import mujoco
import numpy as np

from vgps_ros.core.errors import InvalidInputError


def self_contained(spec: mujoco.MjSpec) -> str:
    """Returns the MJCF of a model whose meshes stand in the text, and whose textures are left out.

    Args:
        spec: the model, which is changed by this.

    Raises:
        InvalidInputError: the model needs a file of another kind.
    """
    with warnings.catch_warnings():  # the same as when it was first compiled
        warnings.simplefilter("ignore")
        return _written(spec)


def _written(spec: mujoco.MjSpec) -> str:
    model = spec.compile()
    for hfield in spec.hfields:
        if hfield.file:
            raise InvalidInputError(
                f"The height field '{hfield.name}' is in a file, which is not supported: write its "
                "heights into the model, as the attribute elevation."
            )
    for mesh in spec.meshes:
        if mesh.file:
            _write_in(model, mesh)
    drawn = {texture.name for texture in spec.textures if texture.file or any(texture.cubefiles)}
    for material in spec.materials:
        material.textures = ["" if name in drawn else name for name in material.textures]
    for texture in list(spec.textures):
        if texture.name in drawn:
            spec.delete(texture)
    spec.meshdir = spec.texturedir = ""
    spec.compile()
    return str(spec.to_xml())


def _write_in(model: mujoco.MjModel, mesh: mujoco.MjsMesh) -> None:
    """Gives a mesh its vertices and faces, where its file had put them."""
    i = model.mesh(mesh.name).id
    first, count = model.mesh_vertadr[i], model.mesh_vertnum[i]
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[i])
    # The compiler has moved the mesh into the frame of its inertia.
    vertices = model.mesh_vert[first : first + count] @ rotation.reshape(3, 3).T + model.mesh_pos[i]
    first, count = model.mesh_faceadr[i], model.mesh_facenum[i]
    mesh.uservert = vertices.ravel().tolist()
    mesh.userface = model.mesh_face[first : first + count].ravel().tolist()
    mesh.file, mesh.content_type = "", ""
    mesh.scale, mesh.refpos, mesh.refquat = [1, 1, 1], [0, 0, 0], [1, 0, 0, 0]
