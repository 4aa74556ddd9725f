# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Drives a robot with an exported policy, as a controller of your own would: without vgps_ros.

vgps export recordings/swimmer --output policy.onnx
python examples/08_onnx_controller.py policy.onnx vgps_ros/tasks/swimmer/swimmer.xml
"""

import os
import sys

import mujoco
import numpy as np

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # else it tells its maker about networks
import onnxruntime


def read(data: mujoco.MjData, name: str) -> float:
    """Returns what the policy calls JOINT/position or JOINT/velocity, or a sensor's number."""
    owner, _, part = name.rpartition("/")
    if part == "position":
        return data.joint(owner).qpos[0]
    if part == "velocity":
        return data.joint(owner).qvel[0]
    return data.sensor(owner or name).data["xyz".find(part) if owner else 0]


def drive(policy_file: str, robot_file: str, seconds: float = 10.0) -> mujoco.MjData:
    """Returns the robot after the policy has driven it."""
    policy = onnxruntime.InferenceSession(policy_file)
    says = policy.get_modelmeta().custom_metadata_map
    kind = {"tensor(float)": np.float32, "tensor(double)": np.float64}[policy.get_inputs()[0].type]
    model = mujoco.MjModel.from_xml_path(robot_file)
    data, period = mujoco.MjData(model), float(says["control_period"])
    mujoco.mj_forward(model, data)
    for _ in range(round(seconds / period)):
        obs = [read(data, name) for name in says["observation_names"].split(",")]
        (torques,) = policy.run(["actions"], {"obs": np.array([obs], kind)})[0]
        for joint, torque in zip(says["joint_names"].split(","), torques, strict=True):
            data.actuator(joint).ctrl = torque  # this robot's motors have the names of their joints
        mujoco.mj_step(model, data, nstep=round(period / model.opt.timestep))
    return data


if __name__ == "__main__":
    robot = drive(*sys.argv[1:3])
    print(f"After {robot.time:.1f} s the robot is at x = {robot.qpos[0]:.3f} m.")
