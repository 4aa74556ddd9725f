# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The kinematics of a robot's URDF, as yourdfpy has them, beside MuJoCo's."""

import io

import mujoco
import numpy as np
import yourdfpy

from vgps_ros.simulation.frames import ROOT, MovingLinks, frame_names
from vgps_ros.simulation.urdf import urdf


def read(model: mujoco.MjModel) -> yourdfpy.URDF:
    """Returns the model's URDF, parsed and found to be valid."""
    text = io.BytesIO(urdf(model).encode())
    robot = yourdfpy.URDF.load(text)
    assert robot.validate(), robot.errors
    return robot


def largest_difference(model: mujoco.MjModel, rng: np.random.Generator, count: int = 10) -> float:
    """Returns the largest difference between any two frames in random states [m, 1].

    All bodies' frames of the URDF are compared with MuJoCo's, and the poses of `MovingLinks`, which
    are those of tf, with the URDF's joints.
    """
    robot, data, moving = read(model), mujoco.MjData(model), MovingLinks(model)
    differences = [0.0]
    for _ in range(count):
        data.qpos[:] = model.qpos0
        mujoco.mj_integratePos(model, data.qpos, rng.uniform(-2.0, 2.0, model.nv), 1.0)
        mujoco.mj_kinematics(model, data)
        move(robot, model, data.qpos)
        positions, rotations = moving.poses(data.qpos)
        for link, *pose in zip(moving.links, positions, rotations, strict=True):
            theirs = robot.get_transform(link.name, link.parent)
            differences.append(np.abs(theirs - matrix(*pose)).max())
        for body, name in enumerate(frame_names(model)):
            theirs = robot.get_transform(name, ROOT)
            differences.append(np.abs(theirs - matrix(data.xpos[body], data.xquat[body])).max())
    return max(differences)


def move(robot: yourdfpy.URDF, model: mujoco.MjModel, qpos: np.ndarray) -> None:
    """Moves the URDF's joints to MuJoCo's positions; floating ones are set by their poses."""
    single = {}
    for i in range(model.njnt):
        name, at = model.joint(i).name or f"joint_{i}", int(model.jnt_qposadr[i])
        joint = robot.joint_map[name]
        if joint.type != "floating":
            single[name] = float(qpos[at])
            continue
        free = model.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE
        value = (
            matrix(qpos[at : at + 3], qpos[at + 3 :]) if free else matrix(np.zeros(3), qpos[at:])
        )
        robot.scene.graph.update(
            frame_from=joint.parent, frame_to=joint.child, matrix=joint.origin @ value
        )
    robot.update_cfg(single)
    for name, value in single.items():
        assert (
            robot.cfg[robot.actuated_dof_indices[robot.actuated_joint_names.index(name)]] == value
        )


def matrix(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Returns the pose as a homogeneous matrix; the first four numbers are the quaternion."""
    turned, pose = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(turned, quaternion[:4])
    pose[:3, :3], pose[:3, 3] = turned.reshape(3, 3), position
    return pose
