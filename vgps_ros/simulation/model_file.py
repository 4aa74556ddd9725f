# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads a robot's model from its MJCF or its URDF.

A URDF says some things otherwise than MuJoCo takes them: it names meshes by package, its links
that are only frames have inertias that no real body has, and one without an inertial is massless.
"""

from pathlib import Path

import mujoco
import numpy as np

from vgps_ros.core.checks import error_text
from vgps_ros.core.errors import InvalidEntryError
from vgps_ros.simulation.model import MUJOCO_ERRORS
from vgps_ros.simulation.packages import package_folders

_SMALL = 0.01  # radius of the ball whose inertia a link has at least [m]


def read_model(path: Path) -> mujoco.MjSpec:
    """Returns the model in a file, in which each link of a URDF is a body.

    Raises:
        InvalidEntryError: MuJoCo cannot read the file.
    """
    if path.suffix.lower() == ".xacro":
        raise InvalidEntryError(
            ("model",),
            "it is a xacro, of which the program xacro makes a URDF; type "
            f"`xacro {path.name} > {path.stem}`, then name that file.",
        )
    is_urdf = path.suffix.lower() == ".urdf"
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except MUJOCO_ERRORS as error:
        sentence = f"the model is no valid {'URDF' if is_urdf else 'MJCF'}: {error_text(error)}."
        raise InvalidEntryError(("model",), sentence) from error
    _find_meshes(spec, path.absolute())
    if is_urdf:
        spec.compiler.fusestatic = False
        spec.compiler.discardvisual = False  # what touches nothing is drawn nevertheless
        spec.compiler.balanceinertia = True
        for body in spec.bodies[1:]:
            _mend_inertia(body)
        if any(body.explicitinertial for body in spec.bodies):
            _weigh_nothing(spec)
    return spec


def _find_meshes(spec: mujoco.MjSpec, path: Path) -> None:
    """Sets the files of meshes that are named by package, installed or around the model."""
    for mesh in spec.meshes:
        name, _, inside = mesh.file.removeprefix("package://").partition("/")
        if inside and mesh.file.startswith("package://"):
            around = [parent / part for parent in path.parents for part in ("", name)]
            files = [folder / inside for folder in (*around, *package_folders(name))]
            mesh.file = str(next(filter(Path.is_file, files), mesh.file))


def _weigh_nothing(spec: mujoco.MjSpec) -> None:
    """Gives links without an inertial no mass, which MuJoCo would take from their shapes.

    A link that a joint moves keeps that mass, since MuJoCo refuses a moving body without any.
    """
    for body in spec.bodies[1:]:
        if not body.explicitinertial and not body.joints:
            for geom in body.geoms:
                geom.density = 0.0


def _mend_inertia(body: mujoco.MjsBody) -> None:
    """Raises principal moments of inertia that are not positive to those of a small ball."""
    xx, yy, zz, xy, xz, yz = body.fullinertia
    if not body.explicitinertial or np.isnan(xx) or not body.mass:
        return
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    least = 0.4 * body.mass * _SMALL**2  # 2/5 m r², of a solid ball
    if moments[0] < 1e-3 * least:  # smaller than of any real link, or not positive
        full = (axes * np.maximum(moments, least)) @ axes.T
        body.fullinertia = full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
