# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Draws robots whose truth is known, measures them with noise, and identifies them.

Their physics has a fifth of the task's time step, so that the model is not right about all. The
quadruped is driven by its own policy, the arm by sines of torque. `--servo` gives the quadruped
servos of another kind: their torque falls with speed, as a voltage does, and they rub. `--bag`
writes the motion of the first draw for `vgps identify`, and `--policies` tries policies of the arm
on the robots that are drawn.
Example: python -m benchmarks.identification quadruped --draws 10
"""

import argparse
import json
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from vgps_ros import tasks
from vgps_ros.bags import BagWriter
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.search.identification import MeasuredMotion, identify
from vgps_ros.simulation.frames import state_layout
from vgps_ros.tasks import Task, make_task

Truth = dict[str, Any]
FINER = 5  # simulator steps of the truth in one of the model's
NOISE = 0.002, 0.1, 0.01, 0.05  # of joints [rad, rad/s], and of the IMU [rad, rad/s]
SECONDS, ROLLOUTS = 12.0, 40
NO_LOAD = 18.0  # speed at which the other kind of servo has no torque left [rad/s]
BODIES = {"quadruped": "trunk", "arm": "hand"}


def draw(task: Task, rng: np.random.Generator) -> Truth:
    """Returns the true numbers: factors but for friction [N·m], latency [s] and rotation [rad]."""
    friction = 0.2 if task.controls.stiffness.any() else 1.0
    return {
        "damping": np.exp(rng.uniform(-0.5, 0.6)),
        "armature": np.exp(rng.uniform(-0.5, 0.6)),
        "friction_loss": rng.uniform(0.0, friction),
        "gain": np.exp(rng.uniform(-0.35, 0.2)),
        "strength": rng.uniform(0.4, 1.0),
        "mass": np.exp(rng.uniform(-0.2, 0.4)),
        "latency": rng.uniform(0.0, 0.03),
        "imu": rng.uniform(-0.05, 0.05, 3),
    }


def true_model(task: Task, truth: Truth) -> mujoco.MjModel:
    """Returns the robot with these numbers, and its own time step."""
    m = copy(task.dynamics.model)
    body, limited = m.body(BODIES[task.name]).id, m.actuator_forcelimited > 0
    m.dof_damping[:] *= truth["damping"]
    m.dof_armature[:] *= truth["armature"]
    m.dof_frictionloss[-m.nu :] = truth["friction_loss"]
    m.actuator_gainprm[:, 0] *= truth["gain"]
    m.actuator_biasprm[:, 1:3] *= truth["gain"]
    m.actuator_forcerange[limited] *= truth["strength"]
    m.body_mass[body] *= truth["mass"]
    m.body_inertia[body] *= truth["mass"]
    m.opt.timestep /= FINER
    mujoco.mj_setConst(m, mujoco.MjData(m))
    return m


def drive(
    task: Task,
    m: mujoco.MjModel,
    truth: Truth,
    rng: np.random.Generator,
    policy: GaussianPolicy | None = None,
    seconds: float = SECONDS,
    other_servo: bool = False,
) -> tuple[MeasuredMotion, Array]:
    """Returns what the robot measured and was told, and its true states."""
    layout, period = state_layout(task.dynamics.model), task.dynamics.time_step
    data, steps = mujoco.MjData(m), round(period / m.opt.timestep)
    data.qpos[:], data.qvel[:] = np.split(task.initial_state, [m.nq])
    joints, mount = layout.joint_places.reshape(2, -1), Rotation.from_rotvec(truth["imu"])
    time = period * np.arange(round(seconds / period))
    sines = rng.uniform(0.3, 3.0, (3, m.nu)), rng.uniform(0.0, 2.0 * np.pi, (3, m.nu))
    measured, told, true = [], [], []
    servo = copy(m)
    if other_servo:
        m.actuator_gainprm[:], m.actuator_biasprm[:] = 0.0, 0.0
    for k, t in enumerate(time):
        true.append(np.r_[data.qpos, data.qvel])
        x = true[-1].copy()
        x[joints[0]] += NOISE[0] * rng.standard_normal(joints.shape[1])
        x[joints[1]] += NOISE[1] * rng.standard_normal(joints.shape[1])
        if layout.base:
            place, q, velocity, rate = layout.base.parts(x)
            shake = Rotation.from_rotvec(NOISE[2] * rng.standard_normal(3))
            turned = Rotation.from_quat(q, scalar_first=True) * mount * shake
            place[:], velocity[:], q[:] = 0.0, 0.0, turned.as_quat(scalar_first=True)
            rate[:] = rate @ mount.as_matrix() + NOISE[3] * rng.standard_normal(3)
        measured.append(x)
        if policy:
            context = np.empty(0)
            if task.signals.names:
                if k % 75 == 0:
                    drawn = rng.uniform([-0.4, -0.4, -1.0], [1.0, 0.4, 1.0])
                phase = task.signals.frequency * t % 1.0
                context = task.signals.context(drawn[None], np.array([phase]))[0]
            u = policy.mean(task.observation.within(context)(x)[None])[0]
        else:
            u = 0.1 * task.controls.limits[1] * np.sin(2 * np.pi * sines[0] * t + sines[1]).sum(0)
        told.append(np.clip(u, *task.controls.limits))
        for j in range(steps):
            late = int(np.floor(k + j / steps - truth["latency"] / period + 1e-9))
            data.ctrl[:] = told[max(late, 0)]
            if other_servo:
                data.qfrc_applied[-m.nu :] = _torque(servo, data)
            mujoco.mj_step(m, data)
    motion = MeasuredMotion(time, np.array(measured), time, np.array(told), bool(layout.base))
    return motion, np.array(true)


def _torque(m: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Returns the torques of servos whose torque falls with speed."""
    q, v = data.qpos[-m.nu :], data.qvel[-m.nu :]
    wanted = m.actuator_gainprm[:, 0] * (data.ctrl - q) + m.actuator_biasprm[:, 2] * v
    largest = m.actuator_forcerange[:, 1]
    return np.clip(
        wanted,
        -largest * np.clip(1.0 + v / NO_LOAD, 0.0, 1.0),
        largest * np.clip(1.0 - v / NO_LOAD, 0.0, 1.0),
    )


def write_bag(folder: Path, task: Task, motion: MeasuredMotion) -> None:
    """Writes a motion of joints as a bag; the robot has a fixed base."""
    bag, names = BagWriter(folder), state_layout(task.dynamics.model).joints
    store, kind = get_typestore(Stores.ROS2_JAZZY), "sensor_msgs/msg/JointState"
    for topic in ("/joint_states", "/joint_command"):
        bag.add_topic(topic, kind, "", [])
    for t, x, u in zip(motion.time, motion.states, motion.controls, strict=True):
        ns = 10**9 + round(t * 1e9)
        time = store.types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        header = store.types["std_msgs/msg/Header"](time, "")
        (q, v), none = np.split(x, 2), np.empty(0)
        for topic, values in (("/joint_states", (q, v, none)), ("/joint_command", (none, none, u))):
            message = store.types[kind](header, list(names), *values)
            bag.write(topic, ns, bytes(store.serialize_cdr(message, kind)))
    bag.close()


def try_policies(task: Task, files: Sequence[str], seeds: Sequence[int]) -> None:
    """Prints what each policy costs on each robot, with standard error, and how far it ends [m]."""
    m = task.dynamics.model
    data = mujoco.MjData(m)
    for seed in seeds:
        truth = draw(task, np.random.default_rng(seed))
        for file in files:
            policy, costs, off = open_policy(Path(file)).gaussian, [], []
            for noise in range(ROLLOUTS):
                rng = np.random.default_rng((seed, noise))
                seconds = task.horizon * task.dynamics.time_step
                model, spread = true_model(task, truth), task.varied_state_std
                start = task.dynamics.space.add(
                    task.initial_state, spread * rng.standard_normal(len(spread))
                )
                here = replace(task, initial_state=start)  # as those from which it learned
                motion, states = drive(here, model, truth, rng, policy, seconds)
                data.qpos[:] = states[-1, : m.nq]
                mujoco.mj_kinematics(m, data)
                costs.append(task.cost.values(Trajectory(states, motion.controls[:-1])).sum())
                off.append(np.linalg.norm(data.site("hand").xpos - data.site("target").xpos))
            line = {"seed": seed, "policy": file, "cost": np.mean(costs), "off": np.mean(off)}
            line["error"] = np.std(costs) / np.sqrt(ROLLOUTS)
            print(json.dumps(line), flush=True)


def main() -> None:
    """Prints a line of JSON for each draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task", choices=BODIES)
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--servo", action="store_true")
    parser.add_argument("--bag", type=Path)
    parser.add_argument("--policies", nargs="+", default=())
    arguments = parser.parse_args()
    task, policy = make_task(arguments.task), None
    seeds = range(arguments.first, arguments.first + arguments.draws)
    if arguments.policies:
        try_policies(task, arguments.policies, seeds)
        return
    if task.name == "quadruped":
        file = Path(tasks.__file__).parent / "quadruped/policy.json"
        policy = open_policy(file).gaussian
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = draw(task, rng)
        model = true_model(task, truth)
        motion, states = drive(task, model, truth, rng, policy, other_servo=arguments.servo)
        if arguments.bag:
            write_bag(arguments.bag, task, motion)
            return
        found = identify(task, [motion], BODIES[task.name])
        line = {"seed": seed, "lowest": float(states[:, 2].min()), "ranges": found.ranges}
        for name, p in found.parameters.items():
            of = name.partition("_")[0]
            true = (
                truth["imu"][["imu_roll", "imu_pitch", "imu_yaw"].index(name)]
                if (of == "imu")
                else truth[name]
                if name in ("latency", "friction_loss")
                else p.nominal * truth[name]
            )
            line[name] = [true, p.value, p.std if p.is_told else None]
        line["errors"], line["windows"] = np.ravel(found.errors).tolist(), found.windows
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
