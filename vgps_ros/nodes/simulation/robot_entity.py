# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The simulated robot as an entity of the ROS standard simulation_interfaces.

Its pose is that of its root body: the body of the free joint, or the one that the world holds.
"""

import mujoco
import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Accel, Twist, Vector3
from simulation_interfaces.msg import (
    Bounds,
    EntityCategory,
    EntityFilters,
    EntityInfo,
    EntityState,
    Result,
)
from simulation_interfaces.srv import SetEntityState

from vgps_ros.core.checks import finite_array, quote
from vgps_ros.core.dynamics import DIVERGENCE_BOUND
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.records import Array
from vgps_ros.messages.robot_state import read_body
from vgps_ros.robot.bodies import BodyJoint
from vgps_ros.simulation.frames import body_joints
from vgps_ros.tasks import Task

WORLD = "world"
_FRAMES = ("", WORLD, "odom")  # names of the one frame that there is
_LONGEST_PATTERN = 200  # of a filter for names


class RefusedError(VgpsError):
    """A request that fails.

    Attributes:
        result: the code that the standard has for it, and a sentence on what would be right.
    """

    def __init__(self, code: int, sentence: str):
        super().__init__(sentence)
        self.result = Result(result=code, error_message=sentence)


class RobotEntity:
    """Tells where the robot is, puts it elsewhere, and tells whether it passes filters.

    Attributes:
        name: the model's name.
        info: what it is.
        base: the free base, or None.
    """

    def __init__(self, task: Task):
        self._model = model = task.dynamics.model
        self._data = mujoco.MjData(model)
        bases = [joint for joint in body_joints(model) if joint.is_free]
        self.base: BodyJoint | None = bases[0] if bases else None
        joints = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE if bases else [True]
        self._root = int(model.body_rootid[model.jnt_bodyid[np.argmax(joints)]])
        self.name = model.names.split(b"\0", 1)[0].decode()
        body = model.body(self._root).name or f"number {self._root}"
        self.info = EntityInfo(
            category=EntityCategory(category=EntityCategory.CATEGORY_ROBOT),
            description=f"The robot of the task {task.name}; its pose is that of the body {body}.",
        )

    def state(self, x: Array, control: Array, stamp: Time) -> EntityState:
        """Returns pose, velocity and acceleration in the world's frame.

        Args:
            x: state, shape (n_x,).
            control: the controls that hold, shape (n_u,).
            stamp: time of the state.
        """
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:], data.act[:] = np.split(x, [model.nq, model.nq + model.nv])
        data.ctrl[:] = control
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        result = EntityState()
        result.header.frame_id, result.header.stamp = WORLD, stamp
        at, rotation = result.pose.position, result.pose.orientation
        at.x, at.y, at.z = data.xpos[self._root].tolist()
        rotation.w, rotation.x, rotation.y, rotation.z = data.xquat[self._root].tolist()
        both, body = np.zeros(6), (mujoco.mjtObj.mjOBJ_XBODY, self._root)
        mujoco.mj_objectVelocity(model, data, *body, both, 0)
        result.twist = Twist(angular=_vector(both[:3]), linear=_vector(both[3:]))
        mujoco.mj_objectAcceleration(model, data, *body, both, 0)
        if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
            both[3:] += model.opt.gravity  # MuJoCo has what an accelerometer feels
        result.acceleration = Accel(angular=_vector(both[:3]), linear=_vector(both[3:]))
        return result

    def moved(self, x: Array, state: EntityState) -> Array:
        """Returns x with the free base in another state, shape (n_x,).

        Raises:
            RefusedError: there is no free base, or the state is not one.
        """
        if not self.base:
            sentence = (
                f"{self.name} has no free base, so that its pose follows from its joints: set "
                "the parameter initial_state, and reset the simulation."
            )
            raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, sentence)
        if state.header.frame_id not in _FRAMES:
            sentence = (
                f"header.frame_id is {quote(state.header.frame_id)}, but it must be '{WORLD}', "
                "'odom' or empty, which are the same here."
            )
            raise RefusedError(Result.RESULT_OPERATION_FAILED, sentence)
        x = x.copy()
        _, rotation, linear, angular = self.base.parts(x)
        try:
            read_body(self.base, x, "state", state.pose.position, state.pose.orientation, Twist())
            _check_bounds("position", x)
        except InvalidInputError as error:
            raise RefusedError(SetEntityState.Response.INVALID_POSE, str(error)) from error
        try:
            linear[:] = _array("linear velocity", state.twist.linear)
            spin = _array("angular velocity", state.twist.angular)
            mujoco.mju_rotVecQuat(angular, spin, rotation * [1.0, -1.0, -1.0, -1.0])
            _check_bounds("velocity", x)
        except InvalidInputError as error:
            raise RefusedError(Result.RESULT_OPERATION_FAILED, str(error)) from error
        return x

    def passes(self, filters: EntityFilters) -> bool:
        """Returns whether the robot passes all filters.

        Raises:
            RefusedError: a filter is wrong, or of a kind that is not supported.
        """
        for name, is_given in (
            ("tags", filters.tags.tags),
            ("bounds", filters.bounds.type != Bounds.TYPE_EMPTY),
        ):
            if is_given:
                sentence = f"Entities are not filtered by {name} here: leave the filter's empty."
                raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, sentence)
        categories = [given.category for given in filters.categories]
        passes = not categories or self.info.category.category in categories
        return passes and (not filters.filter or _matches(filters.filter, self.name))


def _matches(pattern: str, name: str) -> bool:
    """Returns whether a regular expression matches, in time that does not grow with its tricks."""
    import pyarrow  # as late as this: its import takes time and memory, and filters are rare
    from pyarrow import compute

    try:
        if len(pattern) > _LONGEST_PATTERN:
            raise ValueError(f"it is longer than {_LONGEST_PATTERN} characters")
        return bool(compute.match_substring_regex(pyarrow.array([name]), pattern)[0].as_py())
    except ValueError as error:
        reason = str(error).removeprefix("Invalid regular expression: ").rstrip(".")
        sentence = f"The filter {quote(pattern)} is no regular expression: {quote(reason)}."
        raise RefusedError(Result.RESULT_OPERATION_FAILED, sentence) from error


def _check_bounds(what: str, x: Array) -> None:
    if np.abs(x).max() >= DIVERGENCE_BOUND:
        raise InvalidInputError(
            f"The {what} has a value of {DIVERGENCE_BOUND:g} or more, beyond the world's bounds."
        )


def _array(what: str, vector: Vector3) -> Array:
    return finite_array(what, [vector.x, vector.y, vector.z], (3,))


def _vector(values: Array) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)
