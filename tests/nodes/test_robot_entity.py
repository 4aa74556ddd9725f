# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The robot as an entity: its motion against MuJoCo's own, and its filters."""

import mujoco
import numpy as np
import pytest
from simulation_interfaces.msg import EntityFilters

from vgps_ros.messages.conversions import stamp_of
from vgps_ros.nodes.simulation.robot_entity import RobotEntity
from vgps_ros.tasks import make_task

STAMP = stamp_of(0)


@pytest.fixture(params=["swimmer", "walker", "quadruped"])
def robot(request, rng):
    """A task, its entity, a random state and random controls."""
    task = make_task(request.param)
    model, x = task.dynamics.model, task.initial_state.copy()
    mujoco.mj_integratePos(model, x[: model.nq], rng.standard_normal(model.nv), 0.3)
    x[model.nq : model.nq + model.nv] = rng.standard_normal(model.nv)
    return task, RobotEntity(task), x, rng.standard_normal(model.nu)


def numbers(motion):
    return np.array([(v.x, v.y, v.z) for v in (motion.linear, motion.angular)])


def test_velocity_and_acceleration_are_the_derivatives_of_what_is_before_them(robot):
    task, entity, x, control = robot
    model, eps = task.dynamics.model, 1e-6
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.act[:] = np.split(x, [model.nq, model.nq + model.nv])
    data.ctrl[:] = control
    mujoco.mj_forward(model, data)
    later = x.copy()
    mujoco.mj_integratePos(model, later[: model.nq], data.qvel, eps)
    later[model.nq : model.nq + model.nv] += eps * data.qacc
    now, then = entity.state(x, control, STAMP), entity.state(later, control, STAMP)
    at, after = now.pose.position, then.pose.position
    moved = np.array([after.x - at.x, after.y - at.y, after.z - at.z])
    np.testing.assert_allclose(numbers(now.twist)[0], moved / eps, atol=1e-4)
    change = (numbers(then.twist) - numbers(now.twist)) / eps
    scale = np.abs(change).max()
    np.testing.assert_allclose(numbers(now.acceleration), change, atol=1e-4 * (1.0 + scale))
    assert now.header.frame_id == "world"


def test_to_set_what_was_told_changes_nothing(robot):
    _, entity, x, control = robot
    if entity.base:
        moved = entity.moved(x, entity.state(x, control, STAMP))
        np.testing.assert_allclose(moved, x, atol=1e-12)


@pytest.mark.timeout(30)
def test_a_name_is_matched_at_once_whatever_the_expression():
    task = make_task("swimmer")
    entity = RobotEntity(task)
    for pattern in ("((((((.*)*)*)*)*)*)*x", "(.*)" * 45 + "x"):
        assert not entity.passes(EntityFilters(filter=pattern))
