# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""ONNX files: reads untrusted ones safely, and writes a policy of ours so that it is read back.

A file is read without opening anything outside it. onnxruntime cannot end an operator, so it gets
only networks of floats: integers are constants, sizes and places, and `check_network` finds these,
and bounds sizes and work, before anything is executed.
The package `onnx` is imported only when a file is read or written.

The graph of a policy of ours maps `obs`, shape (batch, n_o), to

    mean     μ_θ(o), shape (batch, n_u)
    actions  the mean within the robot's limits, from the origin, shape (batch, n_u); the last
             ones are read from there, too
    std      σ, shape (n_u,)

all in the units of the robot. `obs` and the outputs are float32 or float64. Between them all is
float64: where large terms nearly cancel, float32 would lose up to 6e-5 of the largest torque. So
the file keeps every bit of the policy. Its operators are few and old, so every runtime has them.
Softplus is written as max(z, 0) + log(1 + exp(−|z|)), since onnxruntime has it for float32 alone.
"""

import importlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vgps_ros.core.checks import error_text, finite_array, quote
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.memory import LAST_ACTION
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Array

NO_TELEMETRY = "ORT_DISABLE_TELEMETRY"
LARGEST = 64 << 20  # [bytes]; policies of legged robots take about 1 MB
_MOST_PARTS = 50_000  # nodes with their inputs, outputs and attributes; tensors; axes
_MOST_NUMBERS = 2**19  # of a tensor between the weights, for one observation
_MOST_WORK = 2**29  # multiplications of a network for one observation
_WORK_OF_NUMBER = 100  # multiplications that take as long as one number of another operator
_FLOAT32, _FLOAT64, _INT32, _INT64, _BOOL = 1, 11, 6, 7, 9  # ONNX's numbers of types
_FLOATS, _NUMBERS = {_FLOAT32, _FLOAT64}, {_FLOAT32, _FLOAT64, _INT32, _INT64, _BOOL}
_PREDICATES = "And Equal Greater GreaterOrEqual IsInf IsNaN Less LessOrEqual Not Or".split()  # noqa: SIM905
_OF_SHAPES = """
Add Cast Concat Constant ConstantOfShape Expand Gather Identity Mul Reshape Shape Size Slice Squeeze
Sub Transpose Unsqueeze Where
""".split()  # noqa: SIM905
_OPERATORS = f"""{" ".join([*_PREDICATES, *_OF_SHAPES])}
Abs Acos Asin Atan BatchNormalization Ceil Celu Clip Conv Cos Div Elu Erf Exp Flatten Floor GRU Gelu
Gemm GlobalAveragePool GlobalMaxPool GroupNormalization HardSigmoid HardSwish InstanceNormalization
LSTM LayerNormalization LeakyRelu Log LogSoftmax LpNormalization MatMul Max Mean Min Mish Neg PRelu
Pad Pow RMSNormalization RNN Reciprocal ReduceL1 ReduceL2 ReduceLogSumExp ReduceMax ReduceMean
ReduceMin ReduceSum ReduceSumSquare Relu Round Selu Sigmoid Sign Sin Softmax Softplus Softsign Split
Sqrt Sum Swish Tan Tanh ThresholdedRelu Tile
""".split()
OPSET, IR_VERSION = 17, 8  # of 2022, which the runtimes on robots read too
PRECISIONS = {"float32": np.float32, "float64": np.float64}


def package(name: str) -> Any:
    """Returns a module of the packages onnx or onnxruntime.

    From 1.29 on onnxruntime tells its maker the names of networks and files, unless it is told not
    to before it is imported.

    Raises:
        VgpsError: it is not installed.
    """
    os.environ.setdefault(NO_TELEMETRY, "1")
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        needed = name.partition(".")[0]
        raise VgpsError(
            f"An ONNX policy needs the package {needed}: run `pip install {needed}`."
        ) from error


def parse_model(content: bytes, name: str) -> Any:
    """Returns the model in the bytes of an ONNX file, after it was found to be harmless.

    An error calls the file by its name.

    Raises:
        InvalidInputError: the bytes are no ONNX model; or it keeps tensors in other files, or holds
            functions, or operators that no policy uses.
    """
    if len(content) > LARGEST:
        raise InvalidInputError(
            f"{name} is larger than {LARGEST / 1e6:.0f} MB; use a smaller network."
        )
    try:
        model = package("onnx").load_model_from_string(content)
    except Exception as error:  # of protobuf, whose classes differ between its implementations
        raise InvalidInputError(
            f"{name} is not an ONNX model, or is damaged ({str(error).strip():.80}); export it "
            "anew."
        ) from error
    graph = model.graph
    if not (graph.node and graph.input and graph.output):
        raise InvalidInputError(
            f"{name} has no graph with nodes, inputs and outputs; export it anew."
        )
    parts = [model.opset_import, graph.input, graph.output, graph.value_info, graph.initializer]
    parts += [part for n in graph.node for part in ([n], n.input, n.output, n.attribute)]
    parts += [each.type.tensor_type.shape.dim for each in graph.input]
    parts += [tensor.dims for tensor in graph.initializer]
    if (count := sum(map(len, parts))) > _MOST_PARTS:
        raise InvalidInputError(
            f"{name} has {count} nodes, names and sizes, but a policy may have at most "
            f"{_MOST_PARTS}: use a smaller network."
        )
    tensors = (*graph.initializer, *(each.t for n in graph.node for each in n.attribute))
    if any(t.data_location == t.EXTERNAL or t.external_data for t in tensors):
        raise InvalidInputError(
            f"{name} keeps its weights in another file, which is not read; if you trust both, join "
            'them: python -c \'import onnx; onnx.save(onnx.load("FILE.onnx"), "WHOLE.onnx")\'.'
        )
    if model.functions or graph.sparse_initializer:
        raise InvalidInputError(
            f"{name} has local functions or sparse tensors; export it with functions inlined and "
            "weights dense."
        )
    for node in graph.node:
        if node.domain not in ("", "ai.onnx") or node.op_type not in _OPERATORS:
            raise InvalidInputError(
                f"{name} has the operator {quote(f'{node.domain}.{node.op_type}'.lstrip('.'))}, "
                "which is none of those that are executed (docs/how_to/import_a_policy.md); export "
                "it without."
            )
    return model


def check_network(model: Any, count: int, name: str) -> set[str]:
    """Returns the tensors of a network that are the same whatever it reads.

    Refuses one that is not of floats, or does not answer soon.

    Args:
        model: what `parse_model` returned.
        count: how many numbers an observation has, where the file does not fix it.
        name: what the sentence of an error calls the file.

    Raises:
        InvalidInputError: another number than a float, or a size, depends on what is read; or a
            size or the work is too large.
    """
    bare = package("onnx").ModelProto()
    bare.CopyFrom(model)
    shapes = {tensor.name: [*tensor.dims] for tensor in bare.graph.initializer}
    kinds = {tensor.name: tensor.data_type for tensor in bare.graph.initializer}
    constants = {*shapes}  # all else depends on the observation
    inputs = [each for each in model.graph.input if each.name not in shapes]
    del bare.graph.input[:], bare.graph.value_info[:]  # whose sizes may be wrong
    bare.graph.input.extend(inputs)
    for each in bare.graph.output:
        each.ClearField("type")
    for each in bare.graph.input:
        for i, dim in enumerate(reversed(each.type.tensor_type.shape.dim)):
            dim.dim_value = dim.dim_value or (1 if i else count)
    try:
        infer = package("onnx.shape_inference").infer_shapes
        graph = infer(bare, strict_mode=True, data_prop=True).graph
    except Exception as error:  # of onnx, which has no common class for its errors
        sentence = f"{name} cannot be executed: {error_text(error)}; export it anew."
        raise InvalidInputError(sentence) from error
    for each in (*graph.input, *graph.value_info, *graph.output):
        kind = each.type.tensor_type
        kinds[each.name] = kind.elem_type
        if kind.HasField("shape") and all(dim.HasField("dim_value") for dim in kind.shape.dim):
            shapes[each.name] = [dim.dim_value for dim in kind.shape.dim]
    for each in [each for each, shape in shapes.items() if 0 in shape and kinds[each] in _FLOATS]:
        del kinds[each]  # some operators crash on nothing
    work = 0
    for node in graph.node:
        read, given = ([*filter(None, names)] for names in (node.input, node.output))
        allowed = _FLOATS | {_BOOL} if node.op_type in _PREDICATES else _FLOATS
        if node.op_type in ("Shape", "Size") or constants.issuperset(read):
            constants.update(given)
            allowed = _NUMBERS if node.op_type in _OF_SHAPES else allowed
        is_allowed = allowed.issuperset(map(kinds.get, given))
        if not (is_allowed and _NUMBERS.issuperset(map(kinds.get, read))):
            raise InvalidInputError(
                f"{name} has a node {quote(node.op_type)} of tensors that are empty, unknown or "
                "not float, but only floats may depend on an observation, and integers be sizes "
                f"and places, without division; export it with float tensors and opset {OPSET}."
            )
        for each in given:
            size = _size(shapes[each]) if each in shapes else math.inf
            if size > _MOST_NUMBERS:
                raise InvalidInputError(
                    f"{name} has a node {quote(node.op_type)} that gives {min(size, 10**12):g} "
                    f"numbers, but at most {_MOST_NUMBERS} may come of an observation, and how "
                    "many may not depend on it; use a smaller network of fixed sizes."
                )
        work += _work(node.op_type, [shapes[each] for each in (*read, *given) if each in shapes])
    if work > _MOST_WORK:
        raise InvalidInputError(
            f"{name} takes {min(work, 10**15):.1e} multiplications for an observation, but "
            f"{_MOST_WORK:.1e} are the most; use a smaller network."
        )
    return constants


def _size(shape: Sequence[int]) -> int:
    """Returns how many numbers a tensor has; an axis of none counts, since it is still walked."""
    return math.prod(max(1, size) for size in shape)


def _work(operator: str, shapes: Sequence[Sequence[int]]) -> int:
    """Returns the multiplications of a node, from the shapes of its inputs and outputs."""
    sizes = [_size(shape) for shape in shapes]
    work = _WORK_OF_NUMBER * sum(sizes)
    if operator in ("Gemm", "MatMul"):  # n m k is the root of (n m) (m k) (n k)
        work = math.isqrt(math.prod(sorted(sizes)[-3:]))
    elif operator in ("GRU", "LSTM", "RNN"):  # all weights at each step of a sequence
        work = _size(shapes[0][:-1]) * sum(sizes[1:3])
    elif operator == "Conv":  # a channel's weights for each number that it gives
        work = sizes[-1] * _size(shapes[1][1:])
    return work


def metadata_of(model: Any) -> dict[str, str]:
    """Returns the metadata of a model, by key, without those that are no text."""
    pairs = [(entry.key, entry.value) for entry in model.metadata_props]
    return {key: value for key, value in pairs if isinstance(key, str) and isinstance(value, str)}


def with_metadata(content: bytes, metadata: dict[str, str], name: str) -> bytes:
    """Returns an ONNX file with more metadata, which take the place of those of the same key.

    Raises:
        InvalidInputError: the bytes are no ONNX model that may be read.
    """
    model = parse_model(content, name)
    package("onnx.helper").set_model_props(model, metadata_of(model) | metadata)
    changed: bytes = model.SerializeToString(deterministic=True)
    return changed


def joined_tensors(
    content: bytes,
    inputs: Mapping[str, Sequence[int]],
    outputs: list[str],
    less: Sequence[float],
    name: str,
) -> bytes:
    """Returns a network that reads one vector, and gives one, in place of several tensors each.

    Args:
        content: bytes of the file.
        inputs: its inputs, each with the places of its numbers in the vector.
        outputs: those of its outputs whose numbers come one after another.
        less: what is subtracted from them.
        name: what the sentence of an error calls the file.

    Raises:
        InvalidInputError: the bytes are no ONNX model that may be read, or have no such tensors.
    """
    model, helper = parse_model(content, name), package("onnx.helper")
    graph = model.graph
    constants = {tensor.name for tensor in graph.initializer}
    given = {i.name: i.type.tensor_type for i in graph.input if i.name not in constants}
    if given.keys() != inputs.keys() or not {*outputs} <= {o.name for o in graph.output}:
        raise InvalidInputError(
            f"{name} has the inputs {quote(sorted(given))} and the outputs "
            f"{quote([o.name for o in graph.output])}, but {quote(sorted(inputs))} and "
            f"{quote(outputs)} are described; export it anew."
        )
    element = _FLOAT64 if _FLOAT64 in [t.elem_type for t in given.values()] else _FLOAT32
    build, count = Builder("float32", "joined/"), sum(map(len, inputs.values()))
    for tensor, places in inputs.items():
        part = build.node("Gather", "joined/obs", build.indices(places), axis=1)
        shape = [d.dim_value for d in given[tensor].shape.dim]
        part = build.node("Reshape", part, build.indices(shape))
        build.node("Cast", part, output=tensor, to=given[tensor].elem_type)
    first = len(build.nodes)
    rows = [build.node("Reshape", each, build.indices([1, -1])) for each in outputs]
    rows = [build.node("Cast", row, to=element) for row in rows]
    row = build.node("Concat", *rows, axis=1)
    build.node("Sub", row, build.constant("joined/less", less, element), output="joined/actions")
    nodes = [*build.nodes[:first], *graph.node, *build.nodes[first:]]
    whole = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("joined/obs", element, [1, count])],
        [helper.make_tensor_value_info("joined/actions", element, [1, None])],
        [*graph.initializer, *build.constants],
    )
    model.graph.CopyFrom(whole)
    changed: bytes = model.SerializeToString(deterministic=True)
    return changed


def with_commas(values: Sequence[object]) -> str:
    """Returns values separated by commas, numbers with the digits that read back to their bits.

    Raises:
        InvalidInputError: a name has a comma.
    """
    for value in values:
        if "," in str(value):
            raise InvalidInputError(
                f"The name '{value}' has a comma, but names in ONNX metadata are separated by "
                "commas: rename it in the MJCF."
            )
    return ",".join(map(str, values))


def names_of(metadata: dict[str, str], key: str, name: str) -> tuple[str, ...]:
    """Returns names that are separated by commas.

    Raises:
        InvalidInputError: the key is missing.
    """
    words = tuple(word.strip() for word in metadata.get(key, "").split(",") if word.strip())
    if not words:
        raise InvalidInputError(
            f"{name} has no metadata {key!r}, so nothing tells what its numbers mean; add it, with "
            "the names separated by commas (docs/how_to/import_a_policy.md)."
        )
    return words


def numbers_of(
    metadata: dict[str, str],
    key: str,
    default: float,
    count: int,
    name: str,
    of: str = "joint_names",
) -> Array:
    """Returns numbers that are separated by commas, shape (count,); one may stand for all.

    Raises:
        InvalidInputError: there are as many others, or one is no finite number.
    """
    words = metadata.get(key, str(default)).split(",")
    values = words * count if len(words) == 1 else words
    if len(values) != count:
        raise InvalidInputError(
            f"The metadata {key!r} of {name} has {len(values)} values, but '{of}' has "
            f"{count} joints; give a value for each of them, or one for all."
        )
    return finite_array(f"the metadata {key!r} of {name}", values, (count,))


@dataclass(frozen=True)
class ExportedPolicy:
    """A policy with what its graph needs beside it.

    Attributes:
        policy: π_θ.
        limits: the lowest and the highest control u, shapes (n_u,); ∓inf for none.
        precision: float32 or float64, of the graph's input and outputs.
        origin: what is subtracted from the controls, n_u numbers; empty: nothing.
    """

    policy: GaussianPolicy
    limits: tuple[Array, Array]
    precision: str
    origin: tuple[float, ...] = ()


def to_onnx(exported: ExportedPolicy, metadata: dict[str, str]) -> bytes:
    """Returns the bytes of an ONNX file."""
    activation = exported.policy.architecture.activation
    return model_of(_graph(exported), metadata | {"activation": activation})


def from_onnx(content: bytes, name: str) -> ExportedPolicy | None:
    """Returns the policy from which `to_onnx` wrote these bytes, or None if it did not.

    It did if it writes the same graph again.

    Raises:
        InvalidInputError: the bytes are no ONNX model that may be read.
    """
    model = parse_model(content, name)
    try:
        exported = _read(model, name)
        return exported if _graph(exported) == model.graph else None
    except (InvalidInputError, ArithmeticError, LookupError, TypeError, ValueError):
        return None  # a graph of others


class Builder:
    """Collects the nodes and constants of a graph."""

    def __init__(self, precision: str, prefix: str = ""):
        self.kind, self._prefix = np.dtype(PRECISIONS[precision]), prefix
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self._helper = package("onnx.helper")

    def constant(self, name: str, values: ArrayLike, element: int | None = None) -> str:
        """Adds a constant, of float64 or of another element, and returns its name."""
        kind = self._helper.tensor_dtype_to_np_dtype(element) if element else np.float64
        array = np.asarray(values, dtype=kind)
        self.constants.append(package("onnx.numpy_helper").from_array(array, name))
        return name

    def indices(self, values: Sequence[int]) -> str:
        """Adds a constant of whole numbers and returns its name."""
        name = f"{self._prefix}indices_{len(self.constants)}"
        array = np.array(values, dtype=np.int64)
        self.constants.append(package("onnx.numpy_helper").from_array(array, name))
        return name

    def node(self, operator: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """Adds a node and returns the name of its output."""
        output = output or f"{self._prefix}{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(self._helper.make_node(operator, inputs, [output], **attributes))
        return output

    def activation(self, name: str, z: str) -> str:
        """Adds an activation of z."""
        if name != "softplus":
            return self.node(name.capitalize(), z)
        e = self.node("Exp", self.node("Neg", self.node("Abs", z)))
        logarithm = self.node("Log", self.node("Add", e, "one"))
        return self.node("Add", self.node("Relu", z), logarithm)

    def declaration(self, name: str, *sizes: int | str, kind: str = "") -> Any:
        """Returns the declaration of an input or an output."""
        element = self.element(np.dtype(kind or self.kind))
        return self._helper.make_tensor_value_info(name, element, sizes)

    def element(self, kind: np.dtype) -> int:
        """Returns ONNX's number of a type of numbers."""
        number: int = self._helper.np_dtype_to_tensor_dtype(kind)
        return number

    def give(self, value: str, name: str) -> None:
        """Adds an output."""
        self.node("Cast", value, output=name, to=self.element(self.kind))

    def graph(self, inputs: list[Any], outputs: list[Any]) -> Any:
        """Returns the graph."""
        return self._helper.make_graph(self.nodes, "policy", inputs, outputs, self.constants)


def _graph(exported: ExportedPolicy) -> Any:
    shape, build = exported.policy.architecture, Builder(exported.precision)
    inputs = build.node("Cast", "obs", to=build.element(np.dtype(np.float64)))
    within, mean = network(exported, build, inputs)
    build.give(within, "actions")
    build.give(mean, "mean")
    build.give(build.constant("noise_std", exported.policy.noise_std), "std")
    outputs = [build.declaration(name, "batch", shape.control_dim) for name in ("actions", "mean")]
    outputs.append(build.declaration("std", shape.control_dim))
    return build.graph([build.declaration("obs", "batch", len(shape.observed))], outputs)


def network(exported: ExportedPolicy, build: "Builder", inputs: str) -> tuple[str, str]:
    """Adds the nodes of a policy; returns the names of its actions and of its mean, both float64.

    Args:
        exported: the policy.
        build: takes the nodes.
        inputs: name of what it reads, float64 of shape (batch, n_o).
    """
    policy, a = exported.policy, inputs
    build.constant("one", 1.0)
    shape, last = policy.architecture, len(policy.layers) - 1
    acted = [name.startswith(f"{LAST_ACTION}/") for name in shape.observed]
    if any(acted) and any(exported.origin):
        shift = np.zeros(len(acted))
        shift[acted] = exported.origin
        a = build.node("Add", a, build.constant("last_origin", shift))
    for i, (weight, bias) in enumerate(policy.layers):
        operands = [a, build.constant(f"weight_{i}", weight)]
        if shape.biased[i]:
            operands.append(build.constant(f"bias_{i}", bias))
        a = build.node("Gemm", *operands, transB=1)
        if i < last:
            a = build.activation(shape.activation, a)
    low, high = (
        build.constant(*limit) for limit in zip(("lowest", "highest"), exported.limits, strict=True)
    )
    within = build.node("Min", build.node("Max", a, low), high)
    if any(exported.origin):
        within = build.node("Sub", within, build.constant("origin", exported.origin))
    return within, a


def model_of(graph: Any, metadata: dict[str, str]) -> bytes:
    """Returns the bytes of an ONNX file with a graph of ours."""
    helper = package("onnx.helper")
    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="vgps_ros",
    )
    helper.set_model_props(model, metadata)
    content: bytes = model.SerializeToString(deterministic=True)
    return content


def _read(model: Any, name: str) -> ExportedPolicy:
    """Returns what a model of ours holds; of another model, anything."""
    metadata, to_array = metadata_of(model), package("onnx.numpy_helper").to_array
    arrays = {tensor.name: to_array(tensor) for tensor in model.graph.initializer}
    element = model.graph.input[0].type.tensor_type.elem_type
    elements = {name: Builder(name).element(np.dtype(kind)) for name, kind in PRECISIONS.items()}
    layers = sum(key.startswith("weight_") for key in arrays)
    shape = Architecture(
        names_of(metadata, "observed" if "observed" in metadata else "observation_names", name),
        tuple(arrays[f"weight_{i}"].shape[0] for i in range(layers - 1)),
        len(arrays["noise_std"]),
        activation=metadata["activation"],
        hidden_bias="bias_0" in arrays or layers == 1,
        output_bias=f"bias_{layers - 1}" in arrays,
    )
    parts = [arrays.get(f"{part}_{i}") for i in range(layers) for part in ("weight", "bias")]
    parameters = np.concatenate([part.ravel() for part in parts if part is not None])
    return ExportedPolicy(
        GaussianPolicy(shape, parameters, arrays["noise_std"]),
        (arrays["lowest"], arrays["highest"]),
        next(name for name, number in elements.items() if number == element),
        tuple(arrays["origin"].tolist()) if "origin" in arrays else (),
    )
