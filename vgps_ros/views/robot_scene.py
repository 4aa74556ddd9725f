# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Draws a robot into a Rerun recording: its shape in motion, joints, contacts and trajectories.

Joint states get the same entities and timeline as from Rerun's own MCAP reader, so that a live
recording and one made from a bag look alike.
"""

from collections.abc import Collection, Mapping
from itertools import compress
from typing import Any

import mujoco
import numpy as np
import rerun as rr

from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.messages.conversions import robot_model
from vgps_ros.messages.names import CONTEXT
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.simulation.controls import closed_loops, controls_of
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import compile_model, deviation_names, hinge_names, state_names
from vgps_ros.views.blueprint import PLAN_COST, PLAN_TIME, blueprint, eye, ground
from vgps_ros.views.recording import Recording, robot_time
from vgps_ros.views.robot_shape import RobotShape, floor

_LEARNED, _DDP, _FORCE = (31, 95, 191), (0, 0, 0), (214, 39, 40)
_Q, _PLAN = (255, 159, 28), (44, 160, 44)
_AXES = [(214, 39, 40), (44, 160, 44), (31, 95, 191)]  # of x, y and z
_PATH_STYLE = rr.LineStrips3D.from_fields(colors=[_LEARNED], radii=[0.015])
_PLAN_STYLE = rr.LineStrips3D.from_fields(colors=[_PLAN], radii=[0.01])
_FORCE_STYLE = rr.Arrows3D.from_fields(colors=[_FORCE])
_FORCE_SCALE = 1e-3  # length of a force's arrow [m/N]
_WALL = 50.0  # half the side at which an unbounded plane is drawn [m]
_SLAB = 0.005  # half the thickness at which a plane is drawn [m]


class RobotScene:
    """Draws one robot.

    Attributes:
        states: the messages of the robot's states, and the names of its joints.
        state_names, deviation_names: of each coordinate.
        controls: what its controls are.
        told: what messages say of it.

    Raises:
        InvalidInputError: the MJCF does not compile, or lacks the name of a joint.
    """

    def __init__(self, recording: Recording, mjcf: str):
        self._recording = recording
        self._model = model = compile_model(mjcf)
        self._shape = RobotShape(model)
        self._geometries = _geometries(model)
        self._centre: Array | None = None
        self._solutions: dict[int, tuple[TrajectoryDistribution, float]] = {}
        self.states = StateMessages(state_layout(model))
        self.state_names, self.deviation_names = state_names(model), deviation_names(model)
        self._joints, self._rates = (
            [self.state_names.index(f"{name}/{kind}") for name in self.states.joint_names]
            for kind in ("position", "velocity")
        )
        self.hinge_names = hinge_names(model)
        self._mjcf, self.controls = mjcf, controls_of(model)
        self.told = robot_model(mjcf, self.state_names, self.controls.names)
        # The efforts of a message stand for all that the actuators do.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
        self._dofs = [int(model.joint(name).dofadr[0]) for name in self.states.joint_names]
        disabled = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.has_contacts = not disabled and bool(np.any(model.geom_contype))
        recording.log_static("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        for quantity in ("position", "velocity", "effort"):
            recording.name_series(f"joint_states/{quantity}", self.states.joint_names)
        if self.states.base:
            recording.name_series("odom/position", ["x", "y", "z"], colors=_AXES)
        self._name_commands()
        recording.name_series("policy/noise_std", list(self.controls.names))
        for name in self.hinge_names:
            executed = f"trajectory_distribution/{name}/executed"
            recording.name_series(executed, ["executed"], colors=[_LEARNED], widths=[2])
        self._view = eye(model, self._shape), ground(model, self._shape)
        self.lay_out()
        for name, (_, picture) in self._geometries.items():
            recording.log_static(f"world/robot/{name}", picture)

    def close_loops(self, stiffness: Array, damping: Array) -> None:
        """Draws the commands of joints that close loops of positions, with k_p and k_d (n_u,)."""
        mjcf = closed_loops(self._mjcf, stiffness, damping)
        if mjcf == self._mjcf:
            return
        self.controls = controls_of(compile_model(mjcf))
        self._name_commands()
        self.lay_out()

    def _name_commands(self) -> None:
        for field, mask in self.controls.fields.items():
            names = list(compress(self.controls.names, mask))
            self._recording.name_series(f"joint_command/{field}", names)

    def lay_out(self, logged: Collection[str] | None = None) -> None:
        """Sets the recording's layout; `logged` is what it holds, once that is known."""
        has_base = self.states.base is not None
        layout = blueprint(
            self.hinge_names, self.controls, *self._view, has_base=has_base, logged=logged
        )
        self._recording.lay_out(layout)

    def log_state(self, stamp: int, state: Array, efforts: Array | None = None) -> None:
        """Draws the robot in a state x, shape (n_x,), at a time [ns].

        The efforts are the forces at the hinges and slides [N·m, N], if they are known.
        """
        self._recording.set_time(stamp)
        log = self._recording.log
        log("joint_states/position", rr.Scalars, scalars=state[self._joints])
        log("joint_states/velocity", rr.Scalars, scalars=state[self._rates])
        if efforts is not None:
            log("joint_states/effort", rr.Scalars, scalars=efforts)
        for name in self.hinge_names:
            angle = state[self.state_names.index(f"{name}/position")]
            log(f"trajectory_distribution/{name}/executed", rr.Scalars, scalars=[angle])
        if self.states.base:
            position, (w, *xyz), *_ = self.states.base.parts(state)
            turned = [[*xyz, w]]
            log("world/odom", rr.Transform3D, translation=[position], quaternion=turned)
            log("odom/position", rr.Scalars, scalars=position)
        centre, data = self._shape.centre_of_mass(state), self._shape.data
        for name, (i, _) in self._geometries.items():
            rotation, part = data.geom_xmat[i].reshape(3, 3), f"world/robot/{name}"
            log(part, rr.Transform3D, translation=[data.geom_xpos[i]], mat3x3=[rotation])
        if self._centre is not None:
            step = [[self._centre, centre]]
            log("world/centre_of_mass", rr.LineStrips3D, style=_PATH_STYLE, strips=step)
        self._centre = centre
        if self.has_contacts:
            self._log_contacts(state, efforts)

    def restart_path(self) -> None:
        """Starts a new path of the centre of mass, as after a reset."""
        self._centre = None

    def log_command(self, stamp: int, control: Array) -> None:
        """Plots u, shape (n_u,), at a time [ns], in the units of its kinds."""
        self._recording.set_time(stamp)
        values = self.controls.at_joints(control)
        for field, mask in self.controls.fields.items():
            self._recording.log(f"joint_command/{field}", rr.Scalars, scalars=values[mask])

    def log_context(self, stamp: int, values: Mapping[str, float]) -> None:
        """Plots the commands and the clock in the state of a time [ns], by name."""
        self._recording.set_time(stamp)
        for kind in ("command", "clock"):
            entity = f"{CONTEXT}/{kind}"
            of_kind = {name: v for name, v in values.items() if name.startswith(f"{kind}/")}
            if not of_kind:
                continue
            if entity not in self._recording.logged:
                self._recording.name_series(entity, list(of_kind))
            self._recording.log(entity, rr.Scalars, scalars=list(of_kind.values()))

    def log_plan(self, stamp: int, states: Array, cost: float, solve_time: float) -> None:
        """Draws the path of the centre of mass in a plan that begins at a time [ns]."""
        self._recording.set_time(stamp)
        path = [self._shape.path(states)]
        self._recording.log("world/plan", rr.LineStrips3D, style=_PLAN_STYLE, strips=path)
        self._recording.log(PLAN_COST, rr.Scalars, scalars=[cost])
        self._recording.log(PLAN_TIME, rr.Scalars, scalars=[solve_time])

    def keep_solution(self, index: int, q: TrajectoryDistribution, time_step: float) -> None:
        """Keeps the newest q(ζ) of a trajectory index, for `log_tubes`."""
        self._solutions[index] = q, time_step

    def log_initial_solution(self, index: int, states: Array) -> None:
        """Draws the path of the centre of mass in an initial DDP solution."""
        line = rr.LineStrips3D([self._shape.path(states)], colors=_DDP, radii=0.008)
        self._recording.log_static(f"world/initial_ddp/{index}", line)

    def log_tubes(self) -> None:
        """Plots two standard deviations around the mean of each angle, for each q(ζ) kept."""
        for index, (q, time_step) in self._solutions.items():
            stamps = np.arange(len(q.mean.states)) * round(time_step * 1e9)
            times = robot_time(stamps)
            deviations = np.sqrt(np.diagonal(q.state_covariances, axis1=1, axis2=2).clip(0.0))
            for name in self.hinge_names:
                mean = q.mean.states[:, self.state_names.index(f"{name}/position")]
                deviation = deviations[:, self.deviation_names.index(f"{name}/position")]
                tube = mean[:, None] + np.outer(deviation, [-2.0, 0.0, 2.0])
                entity = f"trajectory_distribution/{name}/{index}"
                names = ["mean − 2 sd", "mean", "mean + 2 sd"]
                self._recording.name_series(entity, names, colors=[_Q] * 3, widths=[2.5, 1, 2.5])
                self._recording.send_series(entity, times, tube)

    def _log_contacts(self, state: Array, efforts: Array | None) -> None:
        """Draws the contact forces in this state as arrows."""
        data, model = self._shape.data, self._model
        data.qvel[:] = state[model.nq : model.nq + model.nv]
        data.qfrc_applied[self._dofs] = 0.0 if efforts is None else efforts
        mujoco.mj_forward(model, data)
        origins, vectors = np.zeros((data.ncon, 3)), np.zeros((data.ncon, 3))
        wrench = np.zeros(6)
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, wrench)
            origins[i] = data.contact.pos[i]
            # The rows of the frame are the contact's axes. The force acts on the second geometry.
            vectors[i] = data.contact.frame[i].reshape(3, 3).T @ wrench[:3]
        arrows = {"origins": origins, "vectors": _FORCE_SCALE * vectors}
        self._recording.log("world/contact_forces", rr.Arrows3D, style=_FORCE_STYLE, **arrows)


def _geometries(model: mujoco.MjModel) -> dict[str, tuple[int, Any]]:
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
