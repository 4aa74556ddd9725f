# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy as a LEAPP bundle: policy.yaml, policy.onnx and what its states begin with.

LEAPP is the format of Isaac's deployment: a network, and a description of each of its tensors by
what a robot measures or is commanded.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.exports import terms
from vgps_ros.policies.onnx_file import OPSET, ExportedPolicy, model_of, network
from vgps_ros.robot.controls import ControlKind
from vgps_ros.tasks.task import Task

# LEAPP's kind of what a control is at its joint; of an activation there is none.
_KINDS = {
    ControlKind.POSITION: "target/joint/position",
    ControlKind.VELOCITY: "target/joint/velocity",
    ControlKind.TORQUE: "target/joint/effort",
    ControlKind.FORCE: "target/joint/effort",
}
_STATES = ("gait_phase", "last_action", "awake")  # terms that the network hands to its next step
_INPUT_NAMES = {"projected_gravity": "base_rotation", "": "readings"}  # unlike their terms'
# Gravity's direction in a frame whose quaternion is q = (x, y, z, w), of length 1, is qᵀ M q, with
# a matrix M for each axis; here [i, axis, j].
_GRAVITY = np.array([[[0, 0, -2, 0], [0, 0, 0, 0], [1, 0, 0, 0]],
                     [[0, 0, 0, 0], [0, 0, -2, 0], [0, 1, 0, 0]],
                     [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, -1, 0]],
                     [[0, 2, 0, 0], [-2, 0, 0, 0], [0, 0, 0, -1]]])  # fmt: skip


def write_leapp(task: Task, exported: ExportedPolicy, folder: Path) -> None:
    """Writes a bundle.

    Its inputs are what a robot measures; the clock is a state of the network, and so are the steps
    for which one that stops goes on (`robot.unrest`), and the last action. A reading that is no
    term is an input of its own, without a kind.

    Raises:
        InvalidInputError: the policy reads former steps, of which no state tells in the first one.
    """
    numbers = terms.find_numbers(task, exported.policy.observed)
    if past := next((n.name for n in numbers if n.lag), ""):
        raise InvalidInputError(
            f"The policy reads {quote(past)} of former steps, which equal the first one in the "
            "first step; no state of a LEAPP bundle does: use the ONNX file or a deploy.yaml."
        )
    bundle = _Bundle(task, numbers)
    actions, _ = network(exported, bundle.build, bundle.read_inputs())
    bundle.give_targets(actions, exported)
    targets = [tensor["name"] for tensor in bundle.outputs]
    bundle.give_states(actions)
    content = model_of(bundle.graph(), {})
    terms.write_file(folder / "policy.onnx", content)
    digests = {f"{each}sum": hashlib.new(each, content).hexdigest() for each in ("md5", "sha256")}
    file = {"model_path": "policy.onnx", **digests, "backend": "onnx", "opset_version": OPSET}
    states = [tensor["name"] for tensor in bundle.states]
    feedback = {f"policy/{s.removesuffix('_in')}_out": [f"policy/{s}"] for s in states}
    flow: dict[str, Any] = {"data_flow": {}, "feedback_flow": feedback}
    if states:
        flow["initial_values"] = "policy_initial_values.safetensors"
        terms.write_file(folder / flow["initial_values"], _safetensors(bundle.states))
    tensors = {"inputs": bundle.inputs, "outputs": bundle.outputs}
    measured = [t["name"] for t in bundle.inputs if t["name"] not in states]
    pipeline = {"configs": {"frequency": 1.0 / task.dynamics.time_step}, **flow,
                "inputs": {"policy": measured}, "outputs": {"policy": targets}}  # fmt: skip
    producer = {"leapp config version": "1.3", "producer": "vgps_ros"}
    said = {"models": {"policy": {**tensors, "parameters": file}}, "pipeline": pipeline}
    terms.write_file(folder / "policy.yaml", {**said, "system information": producer})


class _Bundle:
    """The network of a bundle as it grows, with the description of each of its tensors.

    Attributes:
        build: takes the nodes.
        inputs: descriptions of the inputs.
        outputs: those of the outputs.
        states: those of the inputs that an output of the step before gives.
    """

    def __init__(self, task: Task, numbers: list[terms.Number]):
        self._task, self._numbers, self.build = task, numbers, terms.TermNetwork()
        self.inputs, self.outputs, self.states = (list[dict[str, Any]]() for _ in range(3))
        self._terms = {number.term for number in numbers}
        self._stops = bool("gait_phase" in self._terms and task.unrest)
        if self._stops:
            self._terms |= {"base_ang_vel", "projected_gravity", "awake"}

    def read_inputs(self) -> str:
        """Adds the inputs, by their terms, and returns what the policy reads of them."""
        build, task, numbers = self.build, self._task, self._numbers
        names = task.controls.names
        tensors: dict[str, tuple[str, Sequence[str]]] = {
            "joint_pos": ("state/joint/position", names),
            "joint_vel": ("state/joint/velocity", names),
            "base_lin_vel": ("state/body/linear_velocity", "xyz"),
            "base_ang_vel": ("state/body/angular_velocity", "xyz"),
            "projected_gravity": ("state/body/rotation", ("qx", "qy", "qz", "qw")),
            "velocity_commands": ("command/body/velocity", terms.COMMAND_NAMES),
            "last_action": ("", names),
            "gait_phase": ("", ("phase",)),
            "awake": ("", ("steps",)),
            "": ("", [n.name for n in numbers if not n.term]),
        }
        values, first, end = dict[str, str](), dict[str, int](), 0
        for term, (kind, elements) in tensors.items():
            if term not in self._terms:
                continue
            value, size = self._add_input(term, kind, elements), len(elements)
            if term == "gait_phase":
                turn = task.signals.frequency * task.dynamics.time_step
                value, size = build.clock(value, turn), 2
            elif term == "projected_gravity":
                value, size = _gravity(build, value), 3
            values[term], first[term], end = value, end, end + size
        others = {n.name: i for i, n in enumerate(n for n in numbers if not n.term)}
        places = [first[n.term] + others.get(n.name, n.index) for n in numbers]
        read = build.node("Concat", *values.values(), axis=1)
        signs = [number.sign for number in numbers]
        picked = build.pick(read, places, [0.0] * len(numbers), signs)
        return build.stop_clock(picked, numbers, task, values) if self._stops else picked

    def _add_input(self, term: str, kind: str, elements: Sequence[str]) -> str:
        is_state, name = term in _STATES, _INPUT_NAMES.get(term, term)
        name += "_in" * is_state
        dtype = "float64" if term == "gait_phase" else "float32"
        tensor = _describe(name, kind, elements, dtype)
        self.inputs.append(tensor)
        self.states += [tensor] if is_state else []
        return self.build.to_double(name)

    def give_targets(self, actions: str, exported: ExportedPolicy) -> None:
        """Adds the outputs that drive the robot: targets of joints, and the gains of servos."""
        build, controls, names = self.build, self._task.controls, self._task.controls.names
        scaled = build.node("Mul", actions, build.constant("scale", controls.scale))
        resting = controls.at_joints(np.array(exported.origin or np.zeros(len(names))))
        driving = build.node("Add", scaled, build.constant("default", resting))
        for kind in dict.fromkeys(_KINDS.get(each, "") for each in controls.kinds):
            own = [i for i, each in enumerate(controls.kinds) if _KINDS.get(each, "") == kind]
            joints = [names[i] for i in own]
            name = f"{kind.rpartition('/')[2] or 'activation'}_target"
            build.give(build.node("Gather", driving, build.indices(own), axis=1), name)
            self.outputs.append(_describe(name, kind, joints))
            gains = {"kp": controls.stiffness[own], "kd": controls.damping[own]}
            for key, values in gains.items() if kind == "target/joint/position" else ():
                build.give(build.constant(f"{key}_of_joints", values[None]), f"{key}_gains")
                self.outputs.append(_describe(f"{key}_gains", key, joints))

    def give_states(self, actions: str) -> None:
        """Adds the outputs that are inputs of the next step."""
        if "last_action" in self._terms:
            self.build.give(actions, "last_action_out")
            self.outputs.append(_describe("last_action_out", "", self._task.controls.names))
        if "gait_phase" in self._terms:
            self.outputs.append(_describe("gait_phase_out", "", ("phase",), "float64"))
        if self._stops:
            self.outputs.append(_describe("awake_out", "", ("steps",)))

    def graph(self) -> Any:
        """Returns the network's graph."""
        declare = self.build.declaration
        tensors = [*self.inputs, *self.outputs]
        said = [declare(t["name"], *t["shape"], kind=t["dtype"]) for t in tensors]
        return self.build.graph(said[: len(self.inputs)], said[len(self.inputs) :])


def _gravity(build: terms.TermNetwork, rotation: str) -> str:
    """Adds gravity's direction in a frame with this quaternion (x, y, z, w)."""
    by_axis = build.node("MatMul", rotation, build.constant("of_axes", _GRAVITY.reshape(4, 12)))
    by_axis = build.node("Reshape", by_axis, build.indices([1, 3, 4]))
    column = build.node("Reshape", rotation, build.indices([1, 4, 1]))
    return build.node("Reshape", build.node("MatMul", by_axis, column), build.indices([1, 3]))


def _describe(
    name: str, kind: str, elements: Sequence[str], dtype: str = "float32"
) -> dict[str, Any]:
    found = {"name": name, "dtype": dtype, "shape": [1, len(elements)], "type": "tensor"}
    return {**found, **({"kind": kind} if kind else {}), "element_names": [[*elements]]}


def _safetensors(states: list[dict[str, Any]]) -> bytes:
    """Returns a safetensors file of zeros for these tensors: a header in JSON, and the numbers."""
    header, content = dict[str, Any](), b""
    for tensor in states:
        kind, first = np.dtype(tensor["dtype"]), len(content)
        content += bytes(int(np.prod(tensor["shape"])) * kind.itemsize)
        header[f"policy/{tensor['name']}"] = {"dtype": f"F{8 * kind.itemsize}",
            "shape": tensor["shape"], "data_offsets": [first, len(content)]}  # fmt: skip
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content
