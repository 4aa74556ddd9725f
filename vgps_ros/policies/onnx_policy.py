# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A network of others as a policy: an ONNX graph of bounded work, which onnxruntime executes.

Its metadata say what its numbers mean (`policies.contract`). Where it has a stiffness, its actions
are targets of positions. A robot of servos gets the targets. One of motors gets the torque
k_p (p_0 + s a − p) − k_d v, with the joint's position p and its velocity v; it is then held for a
control period, at which stiff joints become unstable (`tasks.disturbed_task.with_servos`).
"""

import re
from functools import cache
from typing import Any

import numpy as np

from vgps_ros.core.checks import nearest, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.memory import Memory
from vgps_ros.core.records import Array
from vgps_ros.policies.contract import HELD, Contract, nearest_term
from vgps_ros.policies.onnx_file import (
    IR_VERSION,
    OPSET,
    check_network,
    metadata_of,
    package,
    parse_model,
)
from vgps_ros.robot.controls import ControlKind, Controls

MEMORY = 256 << 20  # of all networks of a process [bytes]
_ENDLESS = 1 << 30  # steps after which nobody waits to know a state
_DRAWN = 3  # random observations that a network answers before it may drive
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
        contract: what its numbers mean.
        observed: names of what it reads.
        noise_std: zero, shape (n_u,).
        stiffness: k_p in the order of the controls, shape (n_u,).
        damping: k_d, likewise.

    Raises:
        InvalidInputError: the bytes are no ONNX model that may be read; or its inputs, outputs or
            metadata do not fit each other or the robot.
    """

    def __init__(self, content: bytes, name: str, controls: Controls):
        metadata = metadata_of(model := parse_model(content, name))
        self.content, self.task = content, metadata.get("task", "")
        self._name = name
        self.contract = contract = Contract(metadata, name)
        joints, named = controls.names, contract.all_joints
        if strange := [joint for joint in named if joint not in joints]:
            raise InvalidInputError(
                f"{name} drives {quote(list(contract.joints))}, but the robot's controls drive "
                f"{', '.join(joints)}; use a policy of this robot.{nearest(strange[0], joints)}"
            )
        if idle := [joint for joint in joints if joint not in named]:
            raise InvalidInputError(
                f"{name} does not drive {', '.join(idle)}; write it with `vgps import`, which has "
                f"them held, or name them in its metadata {HELD!r}."
            )
        self._order = [named.index(joint) for joint in joints]
        self.stiffness = contract.stiffness[self._order]
        self.damping = contract.damping[self._order]
        for i in map(joints.index, contract.held):
            can_hold = controls.are_braked[i] and self.stiffness[i] > 0.0
            if not (controls.are_servos[i] or can_hold):
                raise InvalidInputError(
                    f"{name} does not drive {joints[i]}, whose {controls.kinds[i]} cannot hold it: "
                    "it is no servo, and a motor needs a joint whose position is measured and a "
                    "'held_joint_stiffness' above 0; use a policy that drives it."
                )
        self.observed = contract.observed
        self.noise_std = np.zeros(len(joints))
        self._controls = controls
        of_servos = controls.are(ControlKind.POSITION)[np.argsort(self._order)]
        has_loop = np.isin(np.arange(len(named)), contract.looped)
        self._origin = np.where(of_servos | (contract.stiffness != 0.0), contract.origin, 0.0)
        self._closed = has_loop & ~of_servos  # joints whose loops are closed here
        for i, kind in enumerate(map(str.strip, metadata.get("action_kind", "").split(","))):
            own = "position" if has_loop[i] else controls.kinds[joints.index(named[i])]
            if kind and ControlKind(kind).field != ControlKind(own).field:
                raise InvalidInputError(
                    f"{name} gives a {kind} of {named[i]}, but the robot takes a {own} there; use "
                    "a robot with other actuators, or give 'joint_stiffness' and 'joint_damping'."
                )
        check_network(model, count := len(contract.places), name)
        self._session, given, output = self._opened()
        self._input, self._output, self._kind = given.name, output.name, _KINDS[given.type]
        self._is_vector = len(given.shape) == 1
        drawn = np.random.default_rng(0).standard_normal((_DRAWN, count))
        self.actions(np.vstack([np.zeros(count), np.ones(count), drawn]))

    @property
    def steps(self) -> int:
        """How many steps, with the newest, the network reads; 0: it remembers nothing."""
        if len(self.contract.state) + len(self.contract.phases):
            return _ENDLESS
        return self.contract.steps if self.contract.remembers else 0

    @property
    def control_dim(self) -> int:
        """n_u."""
        return len(self._order)

    def mean(self, inputs: Array) -> Array:
        """Returns μ(o), controls of shape (..., n_u), for inputs o of shape (..., n_o).

        Of a network that remembers former steps, these are first ones.
        """
        controls, _ = self.answer(inputs.reshape(-1, inputs.shape[-1]), None)
        return controls.reshape(*inputs.shape[:-1], self.control_dim)

    def answer(
        self, inputs: Array, memory: Memory | None, noise: Array | float = 0.0
    ) -> tuple[Array, Memory | None]:
        """Returns controls (N, n_u) for inputs o (N, n_o), and what N robots remember of the step.

        Args:
            inputs: what was observed.
            memory: what they remember of the step before; None: this is the first.
            noise: added to the controls; the actions that are remembered are without.
        """
        found = self.contract.remembered(inputs, memory)
        actions = self.actions(self.contract.read(found))
        controls = self.controls(actions, inputs)
        kept = np.append(actions, found.action[:, actions.shape[1] :], axis=1)
        return controls + noise, found._replace(action=kept) if self.contract.remembers else None

    def actions(self, read: Array) -> Array:
        """Returns the network's actions and its state, (N, n_a + m), for what it reads (N, n).

        One observation is answered after another, as on the robot.
        """
        count = len(self.contract.joints) + len(self.contract.state)
        actions = np.reshape([self._answer(row) for row in read], (len(read), count))
        return np.asarray(np.clip(actions, *self.contract.action_clip))

    def controls(self, actions: Array, inputs: Array) -> Array:
        """Returns the controls of actions (N, n_a) for inputs o (N, n_o), shape (N, n_u)."""
        driving, unmoved = actions[:, : len(self.contract.joints)], len(self.contract.held)
        driving = np.concatenate([driving, np.zeros((len(actions), unmoved))], axis=1)
        values = self._origin + self.contract.scale * driving
        values = np.clip(values, *self.contract.target_clip)
        if self._closed.any():
            position, velocity = self._looped_joint_state(inputs)
            torques = self.contract.stiffness * (values - position)
            torques -= self.contract.damping * velocity
            values = np.where(self._closed, torques, values)
        return self._controls.from_joints(values.take(self._order, axis=1))

    def actions_of(self, controls: Array, inputs: Array) -> Array:
        """Returns the actions (N, n_a) of controls (N, n_u): the inverse of `controls`."""
        values = self._controls.at_joints(controls)[:, np.argsort(self._order)]
        if self._closed.any():
            position, velocity = self._looped_joint_state(inputs)
            stiffness = np.where(self.contract.stiffness, self.contract.stiffness, 1.0)
            held = position * (self.contract.stiffness != 0.0)
            targets = (values + self.contract.damping * velocity) / stiffness + held
            values = np.where(self._closed, targets, values)
        scale = np.where(self.contract.scale, self.contract.scale, 1.0)
        return np.asarray((values - self._origin) / scale)[:, : len(self.contract.joints)]

    def _looped_joint_state(self, inputs: Array) -> Array:
        """Returns the positions and velocities of looped joints, shape (2, N, n_u); of others 0."""
        found = np.zeros((2, len(inputs), self.control_dim))
        found[..., self.contract.looped] = np.split(
            inputs[:, self.contract.looped_places], 2, axis=1
        )
        return found

    def _opened(self) -> tuple[Any, Any, Any]:
        """Returns a session of onnxruntime, its input and its output."""
        name, count = self._name, len(self.contract.places)
        try:
            session = _session(self.content)
        except Exception as error:  # of onnxruntime, see _answer
            raise self._refused(error) from error
        given, outputs = session.get_inputs(), {o.name: o for o in session.get_outputs()}
        if len(given) != 1:
            raise InvalidInputError(
                f"{name} has the inputs {quote([i.name for i in given])}, but it must have one, "
                "the observation; a network with a memory or a clock cannot be executed: export "
                "one without."
            )
        (read,) = given
        if read.type not in _KINDS or len(read.shape) not in (1, 2):
            raise InvalidInputError(
                f"{name} reads a {read.type} of shape {quote(read.shape)}, but it must read "
                f"floats of shape [batch, {count}]; export it with such an input."
            )
        if read.shape[-1] != count and isinstance(read.shape[-1], int):
            raise InvalidInputError(
                f"{name} reads {read.shape[-1]} numbers, but its metadata 'observation_names' "
                f"names {count} ({self.contract.sizes}); name each number that it reads, in their "
                f"order.{nearest_term(self.contract.strange)}"
            )
        return session, read, outputs.get("actions", session.get_outputs()[0])

    def _refused(self, error: Exception) -> InvalidInputError:
        """Returns what onnxruntime says of the network, and what to do."""
        return InvalidInputError(
            f"{self._name} cannot be executed: {_sentence(error)} Export it "
            f"anew, with opset {OPSET} and IR version {IR_VERSION} if these are the reason, and "
            "try it with onnxruntime alone."
        )

    def _answer(self, row: Array) -> Array:
        """Returns the network's actions and its state, n_a + m numbers, for n that it reads."""
        read = row.astype(self._kind)
        given = read if self._is_vector else read[None]
        try:
            (found,) = self._session.run([self._output], {self._input: given})
            found = np.asarray(found, dtype=float).ravel()
        except Exception as error:  # of onnxruntime, which has no common class for its errors
            raise self._refused(error) from error
        count, state = len(self.contract.joints), len(self.contract.state)
        if found.size != count + state:
            has = f"{count} joints{f' and its state {state} numbers' * bool(state)}"
            raise InvalidInputError(
                f"{self._name} gives {found.size} actions, but its metadata 'joint_names' has "
                f"{has}; name one joint for each action."
            )
        # What is read may be infinite where a rollout has diverged.
        if np.isfinite(read).all() and not np.isfinite(found).all():
            raise InvalidInputError(
                f"{self._name} answers the observation {quote(row.tolist())} with "
                f"{quote(found.tolist())}, but actions must be finite; look for NaN among its "
                "weights, or a division by zero."
            )
        return found


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


def _session(content: bytes) -> Any:
    """Returns a network that onnxruntime has opened."""
    options = (runtime := _runtime()).SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    # No graph is rewritten, so that all versions do the same operations in the same order, and
    # nothing is computed before the sizes are known.
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_DISABLE_ALL
    options.log_severity_level = 4
    options.add_session_config_entry("session.use_env_allocators", "1")
    providers = ["CPUExecutionProvider"]
    return runtime.InferenceSession(content, options, providers=providers, enable_fallback=0)


def constants_of(content: bytes, outputs: list[str], name: str) -> dict[str, Array]:
    """Returns outputs of a network that are the same whatever it reads, each as a vector.

    Raises:
        InvalidInputError: an output depends on what it reads, or the network cannot be executed.
    """
    if not outputs:
        return {}
    constants = check_network(parse_model(content, name), 1, name)
    if varying := [output for output in outputs if output not in constants]:
        raise InvalidInputError(
            f"The output '{varying[0]}' of {name} depends on what it reads, but gains must stay as "
            "they are; export a policy with fixed ones."
        )
    try:
        session = _session(content)
        given = {i.name: np.zeros(i.shape, _KINDS[i.type]) for i in session.get_inputs()}
        found = [values.ravel() for values in session.run(outputs, given)]
    except Exception as error:  # of onnxruntime, which has no common class for its errors
        raise InvalidInputError(f"{name} cannot be executed: {_sentence(error)}") from error
    return dict(zip(outputs, found, strict=True))


def _sentence(error: Exception) -> str:
    """Returns what onnxruntime says, on one line, without its error's number and place in C++."""
    text = re.sub(r"\[ONNXRuntimeError\] : \d+ : \w+ : ", "", " ".join(str(error).split()))
    text = re.sub(r"/\S*onnxruntime/\S+:\d+ .*?\)(?: const)? (?=[A-Z])", "", text)
    return f"{text:.400}".rstrip(".") + "."
