# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy as a Microduck loads it: policy.onnx and manifest.json."""

import fnmatch
import json
from pathlib import Path

import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.memory import LAST_ACTION
from vgps_ros.policies.contract import VELOCITY_COMMANDS
from vgps_ros.policies.exports import terms
from vgps_ros.policies.onnx_file import ExportedPolicy, model_of, network
from vgps_ros.storage.software import commit
from vgps_ros.tasks.task import Task
from vgps_ros.tasks.task_file import read_task_file

_LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle")
_HEAD = ("neck_pitch", "head_pitch", "head_yaw", "head_roll")
_JOINTS = (*(f"left_{each}" for each in _LEG), *_HEAD, *(f"right_{each}" for each in _LEG))
# What the robot gives a policy, by its names, and where our terms are in it; a clock follows.
_SIZES = {"base_ang_vel": 3, "projected_gravity": 3, "joint_pos": 14, "joint_vel": 14,
          "actions": 14, "command": 3, "head_command": 4, "body_command": 6}  # fmt: skip
_GIVEN, _MEASURED = sum(_SIZES.values()), 34  # numbers; the measured ones come first
_PLACES = {"base_ang_vel": 0, "projected_gravity": 3, "joint_pos": 6, "joint_vel": 20,
           LAST_ACTION: 34, "velocity_commands": 48, "gait_phase": _GIVEN}  # fmt: skip
_RATE = 50  # [Hz]
_LENGTHS = {"obs_len": _GIVEN, "action_len": len(_JOINTS)}


def write_microduck(task: Task, exported: ExportedPolicy, folder: Path) -> str:
    """Writes policy.onnx and manifest.json; returns sentences on how the robot is driven.

    Raises:
        InvalidInputError: the policy does not fit this robot.
    """
    if not np.isclose(task.dynamics.time_step * _RATE, 1.0):
        raise InvalidInputError(
            f"A Microduck is controlled every {1 / _RATE:g} s, but the task has a control "
            f"period of {task.dynamics.time_step:g} s; change control_period, and train anew."
        )
    numbers = terms.servo_policy_numbers(task, exported, "a Microduck", tuple(_PLACES))
    pose = _default_pose(task, exported)
    built = _Network(task, numbers, pose)
    actions, _ = network(exported, built.build, built.read_inputs())
    metadata = {**_LENGTHS, "schema_version": 1, "control_hz": _RATE, "action_scale": 1.0,
                "joint_names": _JOINTS, "default_joint_pos": [pose[joint] for joint in _JOINTS],
                "kp_fw": 200, "observation": [*_SIZES.items()]}  # fmt: skip
    content = model_of(built.graph(actions), {"microduck": json.dumps(metadata)})
    terms.write_file(folder / "policy.onnx", content)
    _write_manifest(task, folder, has_memory=built.size > 0)
    held = [joint for joint in _JOINTS if joint not in task.controls.names]
    notes = [f"The robot holds {', '.join(held)} by its default pose."] if held else []
    if any(n.term == "joint_vel" for n in numbers):
        notes.append("The joint velocities that it tells the policy are one step old.")
    return " ".join(notes)


def _default_pose(task: Task, exported: ExportedPolicy) -> dict[str, float]:
    """Returns where each joint of the robot is at rest: the driven ones, and the head's locked."""
    names, resting = task.controls.names, task.controls.at_joints(np.array(exported.origin))
    pose = dict(zip(names, resting.tolist(), strict=True))
    path = Path(task.name)
    for pattern, change in read_task_file(path)[0].changes.joints.items() if path.is_file() else ():
        if change.lock is not None:
            pose |= dict.fromkeys(fnmatch.filter(_HEAD, pattern), change.lock)
    if strange := sorted({*pose} ^ {*_JOINTS}):
        raise InvalidInputError(
            f"A Microduck has servos of {', '.join(_JOINTS)}, but the task "
            f"{'drives' if strange[0] in pose else 'does not drive'} {strange[0]}; use the "
            "robot's own model, of whose joints only those of the head may be locked."
        )
    return pose


class _Network:
    """The robot's network as it grows.

    Former steps, the clock's phase and the steps for which one that stops goes on are a memory of
    the network, which begins at zero. It is the sum of the tensors h and c that an LSTM has, of
    float32, and so has the digits of float64. It holds the phase, the steps, a one that says that
    there were former steps, and those, the newest first; what the policy does not need is left out.

    Attributes:
        build: takes the nodes.
        size: numbers of the memory.
    """

    def __init__(self, task: Task, numbers: list[terms.Number], pose: dict[str, float]):
        self.build, self._task, self._numbers, self._pose = terms.TermNetwork(), task, numbers, pose
        self._own = [_JOINTS.index(name) for name in task.controls.names]
        self._has_clock = any(n.term == "gait_phase" for n in numbers)
        self._stops = bool(self._has_clock and task.unrest)
        self._history = max(n.lag for n in numbers)
        self._flag = self._has_clock + self._stops  # the place of the one in the memory
        self.size = self._flag + (1 + _MEASURED * self._history if self._history else 0)
        self._following = list[str]()  # the parts of the next step's memory

    def read_inputs(self) -> str:
        """Adds what reads the robot's numbers and the memory; returns what the policy reads."""
        build, numbers = self.build, self._numbers
        obs = build.to_double("obs")
        parts, memory = [obs], ""
        if self.size:
            halves = [build.to_double(f"{each}_in") for each in "hc"]
            summed = build.node("Add", *halves)
            memory = build.node("Reshape", summed, build.indices([1, self.size]))
        if self._has_clock:
            turn = self._task.signals.frequency * self._task.dynamics.time_step
            parts.append(build.clock(self._part(memory, 0, 1), turn))
            self._following.append("gait_phase_out")
        if self._history:
            parts.append(self._remember(obs, memory))
        read = build.node("Concat", *parts, axis=1)
        picked = build.pick(read, *self._picked_numbers())
        if self._stops:
            ends = {"base_ang_vel": (obs, 0, 3), "projected_gravity": (obs, 3, 6)}
            ends["awake"] = (memory, 1, 2)
            values = {name: self._part(*of) for name, of in ends.items()}
            picked = build.stop_clock(picked, numbers, self._task, values)
            self._following.insert(1, build.to_double("awake_out"))
        return picked

    def _remember(self, obs: str, memory: str) -> str:
        """Adds the measured numbers of this step and the former ones; the first has its own."""
        build, history = self.build, self._history
        now, one = self._part(obs, 0, _MEASURED), build.constant("begun", [[1.0]])
        has_begun = build.node("Equal", self._part(memory, self._flag, self._flag + 1), one)
        first = build.node("Concat", *[now] * history, axis=1)
        former = self._part(memory, self._flag + 1, self.size)
        former = build.node("Where", has_begun, former, first)
        whole = build.node("Concat", now, former, axis=1)
        self._following += [one, self._part(whole, 0, _MEASURED * history)]
        return whole

    def _part(self, value: str, first: int, end: int) -> str:
        return self.build.node("Gather", value, self.build.indices(range(first, end)), axis=1)

    def _picked_numbers(self) -> tuple[list[int], list[float], list[float]]:
        """Returns the place, the offset and the factor of each number that the policy reads."""
        names, scale = self._task.controls.names, self._task.controls.scale
        places, offsets, factors = list[int](), list[float](), list[float]()
        for n in self._numbers:
            is_of_joint = n.term in ("joint_pos", "joint_vel", LAST_ACTION)
            place = _PLACES[n.term] + (self._own[n.index] if is_of_joint else n.index)
            behind = _GIVEN + 2 * self._has_clock + _MEASURED * n.lag
            places.append(place + (behind if n.lag else 0))
            offsets.append(self._pose[names[n.index]] if n.term == "joint_pos" else 0.0)
            factors.append(n.sign / (scale[n.index] if n.term == LAST_ACTION else 1.0))
        return places, offsets, factors

    def graph(self, actions: str) -> object:
        """Returns the network's graph, which gives each joint its action, and the next memory."""
        build, controls, size = self.build, self._task.controls, self.size
        to_joints = controls.scale[:, None] * np.eye(len(_JOINTS))[self._own]
        build.give(build.node("MatMul", actions, build.constant("to_joints", to_joints)), "actions")
        inputs = [build.declaration("obs", 1, _GIVEN)]
        outputs = [build.declaration("actions", 1, len(_JOINTS))]
        if size:
            whole = build.node("Concat", *self._following, axis=1)
            whole = build.node("Reshape", whole, build.indices([1, 1, size]))
            build.give(whole, "h_out")
            build.give(build.node("Sub", whole, build.to_double("h_out")), "c_out")
            inputs += [build.declaration(f"{half}_in", 1, 1, size) for half in "hc"]
            outputs += [build.declaration(f"{half}_out", 1, 1, size) for half in "hc"]
        return build.graph(inputs, outputs)


def _write_manifest(task: Task, folder: Path, *, has_memory: bool) -> None:
    known = {
        c.source: f"{c.name}, {c.lowest:g} to {c.highest:g} {c.unit}" for c in task.signals.commands
    }
    unused = "unused (zeros)"
    twist = [known.get(source, unused) for source in VELOCITY_COMMANDS]
    robot = {"model": "microduck", "hw_rev": 1, "servos": "xl330", "control_hz": _RATE}
    said = {"schema_version": 2, "model_api": 2 if has_memory else 1, **_LENGTHS, "robot": robot,
            "name": folder.resolve().name.lower().removeprefix("microduck-"),
            "description": "Goes as it is commanded; learned by vgps_ros, in simulation alone.",
            "kind": "perpetual", "action_scale": 1.0, "slot": "walk", "entry_pose": "standing",
            "command": {"idle": [0, 0, 0], "twist": twist, "head": unused, "body": unused},
            "training": {"repo": "vgps_ros", "commit": commit(), "task_id": task.name}}  # fmt: skip
    terms.write_file(folder / "manifest.json", json.dumps(said, indent=2).encode())
