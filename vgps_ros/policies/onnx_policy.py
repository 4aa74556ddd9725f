# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A network of others as a policy: any ONNX graph without loops, which onnxruntime executes.

Its metadata say what its numbers mean, by the keys that mjlab writes (docs/how_to/export.md):

    joint_names         the joints that its actions drive, in their order
    observation_names   what it reads; joint_pos and joint_vel stand for one number of each joint
    action_scale        s, 1 if it is left out
    default_joint_pos   p_0, 0 if it is left out
    joint_stiffness     k_p, joint_damping k_d: of a controller of positions

An action a is a torque s a. Where k_p is not zero, p_0 + s a is the target of a position. A robot
of servos gets the targets. One of motors gets the torque k_p (p_0 + s a − p) − k_d v, with the
joint's position p and its velocity v; it is then held for a control period, which stiff loops do
not bear (`tasks.driver.with_loops`).
"""

import re
import threading
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from vgps_ros.core.checks import quoted
from vgps_ros.core.controls import ControlKind, Controls
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.policies.onnx_file import (
    DOMAINS,
    IR_VERSION,
    OPSET,
    metadata_of,
    names_of,
    numbers_of,
    package,
    parsed,
)

MEMORY = 256 << 20  # of all networks of a process [bytes]
_LONGEST = 5.0  # time for one observation, at the first time [s]
_OF_JOINTS = {"joint_pos": "position", "joint_vel": "velocity"}
_KINDS = {"tensor(float)": np.float32, "tensor(double)": np.float64}
# Of the torques of float32 networks on two machines, relative to the largest torque.
TOLERANCE = 1e-5


class OnnxPolicy:
    """μ(o) of a network in an ONNX file, for a robot. It has no noise.

    Args:
        content: bytes of the file.
        name: what the sentence of an error calls it.
        controls: what the robot's controls are.

    Attributes:
        content: bytes of the file.
        task: name of the task in its metadata; empty if there is none.
        observed: names of what it reads.
        noise_std: zero, shape (n_u,).
        stiffness: k_p in the order of the controls, shape (n_u,).
        damping: k_d, likewise.

    Raises:
        InvalidInputError: the bytes are no ONNX model that may be read; or its inputs, outputs or
            metadata do not fit each other or the robot.
    """

    def __init__(self, content: bytes, name: str, controls: Controls):
        metadata = metadata_of(model := parsed(content, name))
        self.content, self.task = content, metadata.get("task", "")
        self._name = name
        driven, joints = names_of(metadata, "joint_names", name), controls.names
        if sorted(driven) != sorted(joints):
            raise InvalidInputError(
                f"{name} drives {quoted(list(driven))}, but the robot's controls drive "
                f"{', '.join(joints)}; use a policy of this robot."
            )
        self._order = [driven.index(joint) for joint in joints]
        self.noise_std = np.zeros(len(joints))

        def of_joints(key: str, default: float) -> Array:
            return numbers_of(metadata, key, default, len(driven), name)

        self._scale = of_joints("action_scale", 1.0)
        self._default = of_joints("default_joint_pos", 0.0)
        self._stiffness = of_joints("joint_stiffness", 0.0)
        self._damping = of_joints("joint_damping", 0.0)
        self.stiffness, self.damping = self._stiffness[self._order], self._damping[self._order]
        self._controls = controls
        of_servos = controls.are(ControlKind.POSITION)[np.argsort(self._order)]
        self._origin = np.where(of_servos | (self._stiffness != 0.0), self._default, 0.0)
        # Joints whose loops are closed here, where the robot has motors.
        self._closed = ((self._stiffness != 0.0) | (self._damping != 0.0)) & ~of_servos
        terms = names_of(metadata, "observation_names", name)
        read, offsets = _expanded(terms, driven, self._default)
        self._offsets = offsets
        self._count = len(read)
        felt = [f"{joint}/{kind}" for kind in _OF_JOINTS.values() for joint in driven]
        self.observed = (*read, *felt) if self._closed.any() else read
        self._versions = _versions(model)
        self._session, given, output = self._opened()
        self._input, self._output, self._kind = given.name, output.name, _KINDS[given.type]
        self._is_vector = len(given.shape) == 1
        self._takes_many = not self._is_vector and not isinstance(given.shape[0], int)
        with _limited(name) as options:
            self._check(self._outputs(np.zeros((1, self._count)), options))

    @property
    def control_dim(self) -> int:
        """n_u."""
        return len(self._order)

    def mean(self, inputs: Array) -> Array:
        """Returns μ(o), controls of shape (..., n_u), for inputs o of shape (..., n_o)."""
        rows = inputs.reshape(-1, inputs.shape[-1])
        read = rows[:, : self._count] - self._offsets
        if len(rows) == 1 or (self._takes_many and len(rows)):
            actions = self._outputs(read)
        else:
            one_by_one = [self._outputs(row) for row in read[:, None]]
            actions = np.concatenate([*one_by_one, np.empty((0, self.control_dim))])
        values = self._origin + self._scale * actions
        if self._closed.any():
            position, velocity = np.split(rows[:, self._count :], 2, axis=1)
            torques = self._stiffness * (values - position) - self._damping * velocity
            values = np.where(self._closed, torques, values)
        ordered = self._controls.from_joints(values.take(self._order, axis=1))
        return ordered.reshape(*inputs.shape[:-1], self.control_dim)

    def _opened(self) -> tuple[Any, Any, Any]:
        """Returns a session of onnxruntime, its input and its output.

        Raises:
            InvalidInputError: onnxruntime refuses the model, or its input does not fit.
        """
        runtime, name, count = _runtime(), self._name, self._count
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        # No graph is rewritten, so that all versions do the same operations in the same order.
        options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
        options.log_severity_level = 4
        options.add_session_config_entry("session.use_env_allocators", "1")
        try:
            session = runtime.InferenceSession(
                self.content, options, providers=["CPUExecutionProvider"], enable_fallback=0
            )
        except Exception as error:  # of onnxruntime, see _outputs
            raise self._refused(error) from error
        given, outputs = session.get_inputs(), {o.name: o for o in session.get_outputs()}
        if len(given) != 1:
            raise InvalidInputError(
                f"{name} has the inputs {', '.join(i.name for i in given)}, but it must have one, "
                "the observation; a network with a memory or a clock cannot be executed: export "
                "one without."
            )
        (read,) = given
        if read.type not in _KINDS or len(read.shape) not in (1, 2):
            raise InvalidInputError(
                f"{name} reads a {read.type} of shape {read.shape}, but it must read floats of "
                f"shape [batch, {count}]; export it with such an input."
            )
        if read.shape[-1] != count and isinstance(read.shape[-1], int):
            raise InvalidInputError(
                f"{name} reads {read.shape[-1]} numbers, but its metadata 'observation_names' "
                f"names {count}; name each number that it reads, in their order."
            )
        return session, read, outputs.get("actions", session.get_outputs()[0])

    def _refused(self, error: Exception) -> InvalidInputError:
        """Returns what onnxruntime says of the network, and what to do."""
        return InvalidInputError(
            f"{self._name} ({self._versions}) cannot be executed: {_sentence(error)} Export it "
            f"anew, with opset {OPSET} and IR version {IR_VERSION} if these are the reason, and "
            "try it with onnxruntime alone."
        )

    def _outputs(self, rows: Array, options: Any = None) -> Array:
        """Returns the network's actions, shape (N, n_u), for what it reads (N, n_o)."""
        given = rows.astype(self._kind)
        if self._is_vector:
            given = given.reshape(-1)
        try:
            (found,) = self._session.run([self._output], {self._input: given}, options)
        except Exception as error:  # of onnxruntime, which has no common class for its errors
            raise self._refused(error) from error
        return np.asarray(found, dtype=float).reshape(len(rows), -1)

    def _check(self, actions: Array) -> None:
        if actions.size != self.control_dim:
            raise InvalidInputError(
                f"{self._name} gives {actions.size} actions, but its metadata 'joint_names' has "
                f"{self.control_dim} joints; name one joint for each action."
            )
        if not np.isfinite(actions).all():
            raise InvalidInputError(
                f"{self._name} answers the observation zero with {actions.ravel().tolist()}, but "
                "actions must be finite; look for NaN among its weights."
            )


def _expanded(
    terms: tuple[str, ...], joints: tuple[str, ...], default: Array
) -> tuple[tuple[str, ...], Array]:
    """Returns the names of what a network reads, and what is subtracted from each of them."""
    names: list[str] = []
    offsets: list[float] = []
    for term in terms:
        found = [f"{j}/{_OF_JOINTS[term]}" for j in joints] if term in _OF_JOINTS else [term]
        names += found
        offsets += default.tolist() if term == "joint_pos" else [0.0] * len(found)
    return tuple(names), np.array(offsets)


@cache
def _runtime() -> Any:
    """Returns onnxruntime, with a limit of the memory that all networks take together."""
    runtime = package("onnxruntime")
    kind = runtime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    memory = runtime.OrtMemoryInfo("Cpu", kind, 0, runtime.OrtMemType.DEFAULT)
    same_as_requested = 1
    limits = runtime.OrtArenaCfg({"max_mem": MEMORY, "arena_extend_strategy": same_as_requested})
    runtime.create_and_register_allocator(memory, limits)
    return runtime


@contextmanager
def _limited(name: str) -> Any:
    """Gives options with which a run of a network ends after _LONGEST.

    Raises:
        InvalidInputError: it took longer.
    """
    options = _runtime().RunOptions()
    ended = threading.Event()

    def end() -> None:
        ended.set()
        options.terminate = True

    timer = threading.Timer(_LONGEST, end)
    timer.start()
    try:
        yield options
    except InvalidInputError as error:
        if ended.is_set():
            raise InvalidInputError(
                f"{name} takes more than {_LONGEST:g} s for one observation; use a smaller network."
            ) from error
        raise
    finally:
        timer.cancel()
        timer.join()


def _versions(model: Any) -> str:
    """Returns the versions of ONNX that a model names."""
    opsets = [str(o.version) for o in model.opset_import if o.domain in DOMAINS] or ["none"]
    return f"opset {', '.join(opsets)}, IR version {model.ir_version}"


def _sentence(error: Exception) -> str:
    """Returns what onnxruntime says, on one line, without its error's number and place in C++."""
    text = re.sub(r"\[ONNXRuntimeError\] : \d+ : \w+ : ", "", " ".join(str(error).split()))
    text = re.sub(r"/\S*onnxruntime/\S+:\d+ .*?\)(?: const)? (?=[A-Z])", "", text)
    return f"{text:.400}".rstrip(".") + "."
