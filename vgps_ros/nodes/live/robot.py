# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot in viser's scene: its shape in motion, and bodies that can be dragged.

The scene goes with the robot: the frame `/world` moves, so that the robot stays before the eye and
the ground moves past below it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np
import trimesh
import viser

from vgps_ros.core.records import Array
from vgps_ros.views.robot_shape import RobotShape

_ROUND = 24  # sides of what is round
_FLOOR = 20.0  # half the side at which an unbounded plane is drawn [m]
_SLAB = 0.01  # thickness at which a plane is drawn [m]
_AWAY = 1.4  # distance of the eye, in that of a picture without controls beside the robot
_PUSH = (214, 39, 40)
_NEW = 0.07  # share of the newest state in the shown velocity: half a second at 30 states a second


class _Drag(NamedTuple):
    """A drag by a client: the body, where it is held, in its frame, and where the pointer is."""

    client: int
    body: int
    held: Array
    pointer: Array


class LiveRobot:
    """Draws one robot.

    Attributes:
        mass: of all bodies [kg].
        size: extent of the model [m].
        velocity: of the first body that moves, which is the base, in its own axes, as a mean over
            the last states: angular and then linear, shape (6,) [rad/s, m/s].
    """

    def __init__(self, server: viser.ViserServer, model: mujoco.MjModel):
        self._server, self._model = server, model
        self._shape = RobotShape(model)
        self.mass, self.size = float(model.body_subtreemass[0]), float(model.stat.extent)
        self._data = self._shape.data
        self._drag: _Drag | None = None
        self._arrow: Any = None
        self.velocity = np.zeros(6)
        self._world = server.scene.add_frame("/world", show_axes=False)
        server.scene.add_grid(
            "/world/grid",
            infinite_grid=True,
            cell_size=max(0.1, round(0.25 * model.stat.extent, 1)),
            position=(0.0, 0.0, -0.1 * model.stat.extent if self._shape.plane == (0, 1) else 0.01),
        )
        seen = np.flatnonzero(model.geom_rgba[:, 3] > 0).tolist()
        self._parts = {i: self._add(i, mesh) for i in seen if (mesh := _mesh(model, i)) is not None}
        self._centre = np.zeros(3)
        self.show(np.concatenate([model.qpos0, np.zeros(model.nv)]))
        server.initial_camera.look_at = eye_on = self._centre * (0.0, 0.0, 1.0)
        server.initial_camera.position = eye_on + _AWAY * self._shape.viewpoint

    def show(self, state: Array) -> None:
        """Shows the robot in a state x, shape (n_x,)."""
        self._centre = self._shape.centre_of_mass(state)
        self.velocity = self.velocity + _NEW * (self._base_velocity(state) - self.velocity)
        with self._server.atomic():
            self._world.position = self._offset
            for i, part in self._parts.items():
                turned = np.empty(4)
                mujoco.mju_mat2Quat(turned, self._data.geom_xmat[i])
                part.position, part.wxyz = self._data.geom_xpos[i], turned

    def grabbed(self, lives: Callable[[int], bool]) -> tuple[str, Array, Array] | None:
        """Draws the drag that is under way, while its page lives.

        Returns:
            Name of the body, where it is held, and the way from there to the pointer, along the
            axes of the body's frame, shapes (3,) [m].
        """
        if (drag := self._drag) is None or not lives(drag.client):
            if self._arrow is not None:
                self._arrow.remove()
                self._arrow = None
            return None
        _, body, held, pointer = drag
        origin, axes = self._frame(body)
        start = origin + axes @ held
        size = 0.01 * self._model.stat.extent
        self._arrow = self._server.scene.add_arrows(
            "/pull",
            np.array([[start, pointer]], dtype=np.float32),
            _PUSH,
            shaft_radius=size,
            head_radius=2.5 * size,
            head_length=5 * size,
        )
        return self._model.body(body).name, held, (pointer - start) @ axes

    @property
    def _offset(self) -> Array:
        """The place on the page of the world's origin, shape (3,) [m]."""
        return -self._centre * (1.0, 1.0, 0.0)

    def _base_velocity(self, state: Array) -> Array:
        """Returns the base's velocity in the state that was placed last, shape (6,)."""
        found, model, data = np.zeros(6), self._model, self._data
        if model.njnt:
            data.qvel[:] = state[model.nq : model.nq + model.nv]
            mujoco.mj_comVel(model, data)
            base = int(model.jnt_bodyid[0])
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, base, found, 1)
        return found

    def _frame(self, body: int) -> tuple[Array, Array]:
        """Returns the origin of a body's frame on the page, and its axes in columns."""
        return self._data.xpos[body] + self._offset, self._data.xmat[body].reshape(3, 3)

    def _add(self, i: int, mesh: trimesh.Trimesh) -> Any:
        rgba, body = self._model.geom_rgba[i], int(self._model.geom_bodyid[i])
        part = self._server.scene.add_mesh_simple(
            f"/world/geom_{i}",
            np.asarray(mesh.vertices),
            np.asarray(mesh.faces),
            color=tuple(rgba[:3].astype(float)),
            opacity=None if rgba[3] == 1.0 else float(rgba[3]),
            flat_shading=False,
            side="double",
        )
        if self._model.body_weldid[body] and self._model.body(body).name:
            part.on_drag("left")(self._follow(body))
        return part

    def _follow(self, body: int) -> Callable[[Any], Any]:
        async def follow(event: Any) -> None:  # in order, as viser calls coroutines alone
            if event.phase == "start":
                origin, axes = self._frame(body)
                held = (np.array(event.start_position) - origin) @ axes
                self._drag = _Drag(event.client_id, body, held, origin)
            pointer = np.array(event.end_position)
            if self._drag and self._drag.client == event.client_id:
                self._drag = None if event.phase == "end" else self._drag._replace(pointer=pointer)

        return follow


def _mesh(model: mujoco.MjModel, i: int) -> trimesh.Trimesh | None:
    """Returns the mesh of a geometry, if it can be drawn."""
    a, b, c = model.geom_size[i].tolist()
    make = trimesh.creation
    match mujoco.mjtGeom(model.geom_type[i]):
        case mujoco.mjtGeom.mjGEOM_PLANE:
            x, y = 2 * (a or _FLOOR), 2 * (b or _FLOOR)
            below = trimesh.transformations.translation_matrix((0.0, 0.0, -0.5 * _SLAB))
            return make.box((x, y, _SLAB), below)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return make.icosphere(3, a)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return make.capsule(2 * b, a, count=(_ROUND, _ROUND))
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return make.icosphere(3).apply_scale((a, b, c))
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return make.cylinder(a, 2 * b, sections=_ROUND)
        case mujoco.mjtGeom.mjGEOM_BOX:
            return make.box((2 * a, 2 * b, 2 * c))
        case mujoco.mjtGeom.mjGEOM_MESH:
            k = int(model.geom_dataid[i])
            vertices = model.mesh_vertadr[k] + np.arange(model.mesh_vertnum[k])
            faces = model.mesh_faceadr[k] + np.arange(model.mesh_facenum[k])
            return trimesh.Trimesh(model.mesh_vert[vertices], model.mesh_face[faces], process=False)
    return None
