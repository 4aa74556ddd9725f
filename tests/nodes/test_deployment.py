# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""An executor on a robot's computer, where nothing is installed that it can do without."""

import os

import numpy as np
import pytest

from tests.nodes.test_measured_robot import BLIND, MS, REAL, Robot, a_policy
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.messages.conversions import command_from_msg
from vgps_ros.policies.deployment_file import read_deployment, write_deployment
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

ABSENT = (
    *("mujoco", "torch", "numba", "llvmlite", "scipy", "pyarrow", "matplotlib", "PIL", "msgspec"),
    *("onnx", "onnxruntime", "rich", "mcap", "mcap_ros2", "rosbags", "rerun", "ruamel"),
)


@pytest.fixture
def bare(tmp_path):
    """The words before a command, for which none of these packages can be imported."""
    folder = tmp_path / "absent"
    folder.mkdir()
    for name in ABSENT:
        (folder / f"{name}.py").write_text(
            f"raise ModuleNotFoundError('None is here', name={name!r})"
        )
    return ("env", f"PYTHONPATH={folder}:{os.environ.get('PYTHONPATH', '')}")


def test_a_policy_and_its_deployment_drive_without_mujoco_and_the_bag_is_checked(
    graph, bare, tmp_path
):
    task, deployment, policy = make_task(str(BLIND)), tmp_path / "robot.json", tmp_path / "p.json"
    write_deployment(task.deployment, deployment)
    save_policy(a_policy(task), task.name, policy)
    recorder = graph.start("recorder", output=tmp_path / "bag")
    robot = Robot(graph, task, prefix=bare, task=str(deployment), policy_file=str(policy), **REAL)
    for topic in ("imu", "joint_states", "joint_command", "context", "policy"):
        graph.spin_until(lambda t=topic: graph.node.count_subscribers(t) > (t in robot.sent))
    graph.spin_for(1.0)
    for step in range(60):
        robot.send_imu(1000 * MS + step * 20 * MS)
        robot.send_joints(1000 * MS + step * 20 * MS)
        graph.spin_for(0.02)
        robot.keep_pace(1000 * MS + step * 20 * MS)
    graph.spin_for(1.2)  # for the diagnostics
    assert len(robot.commands) > 30
    observation, limits = read_deployment(deployment).observation, task.dynamics.control_limits
    told = {c.header.stamp.sec * 1000 * MS + c.header.stamp.nanosec: c for c in robot.contexts}
    for command, stamp in zip(robot.commands, robot.stamps(), strict=True):
        x = robot.state(stamp)
        x[:3], x[19:22] = 0.0, 0.0  # no IMU measures them
        inputs = observation.within(np.array(told[stamp].values))(x)
        wanted = np.clip(robot.policy.mean(inputs), *limits)
        np.testing.assert_allclose(
            command_from_msg(command, task.controls), wanted, rtol=1e-9, atol=1e-9
        )
    assert recorder.end() == 0, recorder.output
    found = check_bag(tmp_path / "bag")
    assert found.wrong == []
    assert found.counts["mean"] > 30  # bit for bit


def test_a_task_without_its_packages_is_refused_in_a_sentence(graph, bare):
    executor = graph.start("policy_executor", prefix=bare, task="swimmer")
    assert executor.wait() == 1
    assert executor.output.strip().endswith(
        "The task 'swimmer' needs the package mujoco, which is not installed; install it, or name "
        "the file of 'vgps export --deployment', which needs none."
    )
    assert "Traceback" not in executor.output


def test_a_policy_without_its_packages_is_refused_in_a_sentence(graph, bare, tmp_path):
    deployment, policy = tmp_path / "robot.json", tmp_path / "policy.onnx"
    write_deployment(make_task(str(BLIND)).deployment, deployment)
    policy.write_bytes(b"a network")
    given = {"task": str(deployment), "policy_file": str(policy)}
    executor = graph.start("policy_executor", prefix=bare, **given)
    assert executor.wait() == 1
    assert "An ONNX policy needs the package onnx" in executor.output.strip().splitlines()[-1]
    assert "Traceback" not in executor.output
