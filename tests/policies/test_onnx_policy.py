# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Networks of others: what they compute, and which are refused, in bounded time and memory."""

import os
import resource
import subprocess
import sys
from itertools import pairwise

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from tests.motors import motors, named, robot
from tests.onnx_models import elu_layers, elu_mean, elu_model, model
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.simulation.controls import controls_of

JOINTS = ("hip", "knee")
READ = ("hip/position", "knee/position", "hip/velocity", "knee/velocity", "up")
NAMES = {"joint_names": ",".join(JOINTS), "observation_names": ",".join(READ)}
LAYERS = elu_layers(5, 2)


def policy(made, joints=JOINTS):
    return OnnxPolicy(made.SerializeToString(), "The file", named(motors(1e9, 1e9), joints))


def test_it_computes_what_the_network_does_for_one_observation_and_for_many(rng):
    inputs = rng.standard_normal((4, 30, 5))
    expected = elu_mean(LAYERS, inputs)
    for rows in (1, "batch"):
        found = policy(elu_model(LAYERS, NAMES, rows=rows))
        assert found.observed == READ
        np.testing.assert_allclose(found.mean(inputs), expected, atol=1e-6)
        np.testing.assert_allclose(found.mean(inputs[0, 0]), expected[0, 0], atol=1e-6)


def test_a_network_may_read_one_vector_without_a_batch(rng):
    weights = rng.standard_normal((5, 2)).astype(np.float32)
    nodes = [helper.make_node("MatMul", ["obs", "w"], ["actions"])]
    found = policy(model(nodes, 5, 2, [("w", weights)], NAMES, rows=None))
    inputs = rng.standard_normal((3, 5))
    for given in (inputs, inputs[0], inputs[:1], inputs[:0]):
        np.testing.assert_allclose(found.mean(given), given @ weights, atol=1e-5)


def test_onnxruntime_says_nothing_to_its_maker(tmp_path):
    """Where it does, it begins with a file of its session beside other temporary ones."""
    given = {"CI", "ORT_DISABLE_TELEMETRY"}
    code = "from vgps_ros.policies.onnx_file import package; package('onnxruntime')"
    environment = {name: value for name, value in os.environ.items() if name not in given}
    environment["TMPDIR"] = str(tmp_path)
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    assert not list(tmp_path.iterdir())


def test_torques_come_in_the_order_of_the_robots_controls(rng):
    inputs = rng.standard_normal((3, 5))
    turned = policy(elu_model(LAYERS, NAMES), joints=JOINTS[::-1])
    np.testing.assert_array_equal(
        turned.mean(inputs), policy(elu_model(LAYERS, NAMES)).mean(inputs)[:, ::-1]
    )


def test_gains_make_its_actions_targets_of_positions_as_mjlab_means_them(rng):
    """The torque is k_p (p_0 + s a − p) − k_d v, and joint_pos is read from p_0 on."""
    says = {
        "joint_names": "hip,knee",
        "observation_names": "joint_pos,joint_vel,up",
        "action_scale": "0.5",
        "default_joint_pos": "0.1,-0.2",
        "joint_stiffness": "20.0,30.0",
        "joint_damping": "1.0,2.0",
    }
    found = policy(elu_model(LAYERS, says))
    felt = ("hip/position", "knee/position", "hip/velocity", "knee/velocity")
    assert found.observed == (*felt, "up")
    p, v, up = rng.standard_normal((6, 2)), rng.standard_normal((6, 2)), np.ones((6, 1))
    zero = np.array([0.1, -0.2])
    action = elu_mean(LAYERS, np.hstack([p - zero, v, up]))
    expected = np.array([20.0, 30.0]) * (zero + 0.5 * action - p) - np.array([1.0, 2.0]) * v
    torques = found.mean(np.hstack([p, v, up]))
    np.testing.assert_allclose(torques, expected, rtol=1e-5, atol=1e-5)
    # A robot of servos gets the targets, whatever its gears, and the network feels no more.
    servo = '<position joint="{}" kp="9" gear="4"/>'
    servos = named(controls_of(robot(servo, servo)), ("hip", "knee"))
    found = OnnxPolicy(elu_model(LAYERS, says).SerializeToString(), "The file", servos)
    assert found.observed == (*felt, "up")
    assert (found.stiffness.tolist(), found.damping.tolist()) == ([20.0, 30.0], [1.0, 2.0])
    targets = found.mean(np.hstack([p, v, up]))
    np.testing.assert_allclose(targets, 4 * (zero + 0.5 * action), rtol=1e-5, atol=1e-5)


def changed(**changes):
    return elu_model(LAYERS, {**NAMES, **changes})


def without(key):
    return elu_model(LAYERS, {k: v for k, v in NAMES.items() if k != key})


def external():
    made = elu_model(LAYERS, NAMES)
    made.graph.initializer[0].data_location = TensorProto.EXTERNAL
    entry = made.graph.initializer[0].external_data.add()
    entry.key, entry.value = "location", "../../../../etc/hostname"
    return made


def external_in_a_constant():
    made = model([helper.make_node("Constant", [], ["actions"])], 5, 2, metadata=NAMES)
    tensor = TensorProto(data_type=1, dims=[1, 2], data_location=TensorProto.EXTERNAL)
    made.graph.node[0].attribute.append(helper.make_attribute("value", tensor))
    return made


def endless():
    value = helper.make_tensor_value_info
    body = helper.make_graph(
        [helper.make_node("Identity", [a], [b]) for a, b in (("go", "on"), ("x", "y"))],
        "body",
        [value("i", TensorProto.INT64, []), value("go", TensorProto.BOOL, []),
         value("x", TensorProto.FLOAT, [1, 5])],
        [value("on", TensorProto.BOOL, []), value("y", TensorProto.FLOAT, [1, 5])],
    )  # fmt: skip
    node = helper.make_node("Loop", ["", "true", "obs"], ["actions"], body=body)
    return model([node], 5, 5, [("true", np.array(True))], NAMES)


def outer_products(count=4):
    """A few nodes, each of which squares the size of what came before."""
    nodes, last = [], "obs"
    for i in range(count):
        nodes += [
            helper.make_node("Reshape", [last, shape], [f"{shape}{i}"])
            for shape in ("column", "row")
        ]
        nodes.append(helper.make_node("MatMul", [f"column{i}", f"row{i}"], [last := f"product{i}"]))
    nodes.append(helper.make_node("ReduceSum", [last], ["actions"]))
    shapes = [("column", np.array([-1, 1])), ("row", np.array([1, -1]))]
    return model(nodes, 5, 1, shapes, NAMES)


def huge_constant():
    """A tensor that says to have 4 TB, of which there is not one byte."""
    made = elu_model(LAYERS, NAMES)
    made.graph.initializer[0].dims[:] = [1_000_000, 1_000_000]
    made.graph.initializer[0].raw_data = b""
    return made


def two_inputs():
    inputs = [
        helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, 5]) for n in ("obs", "hidden")
    ]
    return model([helper.make_node("Add", ["obs", "hidden"], ["actions"])], 5, 5,
                 metadata=NAMES, inputs=inputs)  # fmt: skip


def of_integers():
    inputs = [helper.make_tensor_value_info("obs", TensorProto.INT64, [1, 5])]
    cast = helper.make_node("Cast", ["obs"], ["actions"], to=TensorProto.FLOAT)
    return model([cast], 5, 5, metadata=NAMES, inputs=inputs)


def of_a_stranger():
    made = elu_model(LAYERS, NAMES)
    made.graph.node[0].domain = "com.example"
    made.opset_import.append(helper.make_opsetid("com.example", 1))
    return made


def of_nan():
    weights = [(np.full_like(weight, np.nan), bias) for weight, bias in LAYERS]
    return elu_model(weights, NAMES)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (of_nan, r"answers the observation \[0\.0, .* with \[nan, .* must be finite"),
        (lambda: without("joint_names"), "has no metadata 'joint_names'"),
        (lambda: without("observation_names"), "has no metadata 'observation_names'"),
        (lambda: changed(joint_names="hip,toe"), "but the robot's controls drive hip, knee"),
        (lambda: changed(joint_names="hip"), "does not drive .*; write it with `vgps import`"),
        (lambda: changed(observation_names="hip/position"), "reads 5 numbers, but .* names 1"),
        (lambda: changed(action_scale="1,2,3"), "'action_scale' .* has 3 values"),
        (lambda: changed(action_scale="nan"), "must be finite"),
        (lambda: changed(joint_damping="much"), "must hold numbers only"),
        (lambda: elu_model(elu_layers(5, 3), NAMES), "gives 3 actions, but .* 2 joints"),
        (
            lambda: elu_model(LAYERS, NAMES, opset=1),
            "'Gemm' of tensors that are .* unknown .*opset 17",
        ),
        (lambda: elu_model(LAYERS, NAMES, opset=-1), "'Gemm' of tensors that are .* unknown"),
        (lambda: elu_model(LAYERS, NAMES, opset=99), "Opset 99 .*anew, with opset 17"),
        (two_inputs, r"has the inputs \['obs', 'hidden'\], but it must have one"),
        (of_integers, r"reads a tensor\(int64\)"),
        (of_a_stranger, "the operator 'com.example.Gemm'"),
        (external, "in another file, which is not read; .* join them: python -c .import onnx;"),
        (external_in_a_constant, "in another file"),
        (endless, "the operator 'Loop', which is none of those"),
        (outer_products, "a node 'MatMul' that gives 1.52588e.11 numbers, but at most 524288"),
        (huge_constant, "cannot be executed"),
        (onnx.ModelProto, "has no graph"),
    ],
)
def test_a_file_that_does_not_fit_or_harms_is_refused_with_a_sentence(make, sentence):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InvalidInputError, match=sentence) as refused:
        policy(make())
    assert "\n" not in str(refused.value)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 600_000  # [kB]


def summed(nodes, *tensors, opset=17, **named):
    """A network of these nodes, whose last value `last` is summed to two actions."""
    end = [helper.make_node("ReduceSum", ["last"], ["sum"], keepdims=0)]
    end.append(helper.make_node("Expand", ["sum", "one by two"], ["actions"]))
    given = [(name, np.asarray(values)) for name, values in named.items()]
    tensors = [("one by two", np.array([1, 2])), *given, *tensors]
    return model([*nodes, *end], 5, 2, tensors, NAMES, opset=opset)


def one(operator, *inputs, **named):
    """A network of one node; what is no array is an attribute."""
    attributes = {k: v for k, v in named.items() if not isinstance(v, np.ndarray)}
    node = helper.make_node(operator, inputs, ["last"], **attributes)
    return summed([node], **{k: v for k, v in named.items() if isinstance(v, np.ndarray)})


def product(count, size=500):
    """Matrices of ones, multiplied one after another."""
    names = ["a", *(f"m{i}" for i in range(count)), "last"]
    nodes = [helper.make_node("MatMul", [m, "a"], [n]) for m, n in pairwise(names)]
    return summed(nodes, a=np.ones((size, size), np.float32))


def long_sequence():
    x, w, r = np.ones((1, 1, 1)), np.ones((1, 2000, 1)), np.ones((1, 2000, 500))
    tensors = {
        name: values.astype(np.float32) for name, values in zip("xwr", (x, w, r), strict=True)
    }
    nodes = [
        helper.make_node("Expand", ["x", "long"], ["xs"]),
        helper.make_node("LSTM", ["xs", "w", "r"], ["", "last"], hidden_size=500),
    ]
    return summed(nodes, long=np.array([100_000, 1, 1]), **tensors)


WIDE = np.array([200_000, 5])


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        *(
            (lambda operator=operator: one(operator, "obs"), f"has the operator '{operator}'")
            for operator in (
                *("NonMaxSuppression", "NonZero", "Unique", "Compress", "RandomNormalLike"),
                *("Bernoulli", "Multinomial", "Einsum", "Resize", "AveragePool", "DFT", "Scan"),
                *("If", "SequenceMap", "StringConcat", "Det", "Range", "NoSuchOperator"),
            )
        ),
        (lambda: one("ConstantOfShape", "s", s=np.array([10**9])), "gives 1e.09 numbers"),
        (lambda: one("ConstantOfShape", "s", s=np.full(3, 2**32)), r"gives 1e.12 numbers"),
        (lambda: one("Expand", "obs", "s", s=WIDE), "'Expand' that gives 1e.06 numbers"),
        (lambda: one("Tile", "obs", "s", s=WIDE), "'Tile' that gives 5e.06 numbers"),
        (lambda: one("Pad", "obs", "s", s=np.array([0, 0, 0, 10**6])), "'Pad' that gives"),
        (lambda: product(40), r"takes 5.2e.09 multiplications"),
        (
            lambda: one(
                "Conv", "x", "w", pads=[99_999] * 2,
                x=np.ones((1, 1, 9), np.float32), w=np.ones((1, 1, 100_000), np.float32),
            ),
            "e.10 multiplications",
        ),
        (long_sequence, "e.11 multiplications"),
        (lambda: one("Div", "obs", "obs"), r"with \[nan, .* or a division by zero"),
    ],
)  # fmt: skip
def test_a_network_whose_work_nothing_bounds_is_refused_before_it_is_executed(make, sentence):
    with pytest.raises(InvalidInputError, match=sentence) as refused:
        policy(make())
    assert "\n" not in str(refused.value)


def chain(*steps, **named):
    """A network of nodes `(operator, inputs, attributes)`, of which each gives `v` and its number.

    The last value is read as floats.
    """
    nodes = [
        helper.make_node(operator, given.split(), [f"v{i}"], **attributes)
        for i, (operator, given, attributes) in enumerate(steps)
    ]
    nodes.append(helper.make_node("Cast", [f"v{len(steps) - 1}"], ["last"], to=TensorProto.FLOAT))
    return summed(nodes, opset=19, **named)


WHOLE = ("Cast", "obs", {"to": TensorProto.INT64})
SMALLEST, LESS, TWO = np.int32([-(2**31)]), np.int32([-1]), np.int32([2])


@pytest.mark.parametrize(
    ("operator", "make"),
    [
        ("Cast", lambda: chain(("Cast", "obs", {"to": TensorProto.STRING}))),
        ("Cast", lambda: chain(("Cast", "obs", {"to": TensorProto.BOOL}))),
        ("Cast", lambda: chain(("Cast", "obs", {"to": TensorProto.FLOAT16}))),
        ("Cast", lambda: chain(WHOLE, ("Div", "k v0", {}), k=np.array([7]))),
        ("Cast", lambda: chain(WHOLE, ("MatMul", "v0 k", {}), k=np.ones((5, 9), np.int64))),
        # The smallest number divided by −1 ends a process, which an observation may choose here.
        (
            "Where",
            lambda: chain(
                ("Greater", "obs zero", {}), ("Where", "v0 less two", {}), ("Div", "k v1", {}),
                zero=np.float32(0.0), less=LESS, two=TWO, k=SMALLEST,
            ),
        ),
        ("Div", lambda: chain(("Div", "k less", {}), k=SMALLEST, less=LESS)),
        ("MatMul", lambda: chain(("MatMul", "k k", {}), k=np.ones((9, 9), np.int64))),
        ("Equal", lambda: chain(("Equal", "k k", {}), k=np.array(["a"]))),
        ("Div", lambda: chain(("Div", "k v1", {}), WHOLE, k=np.array([7]))),  # in false order
        ("Conv", lambda: one("Conv", "x", "w", group=0, x=np.ones((1, 0, 9), np.float32),
                             w=np.ones((2, 0, 3), np.float32))),
        ("Reshape", lambda: one("Reshape", "x", "s", x=np.ones((0, 3), np.float32),
                                s=np.array([3, 0]), allowzero=1)),
    ],
)  # fmt: skip
def test_only_floats_depend_on_an_observation(operator, make):
    sentence = f"'{operator}' of tensors that are empty, unknown or not float"
    with pytest.raises(InvalidInputError, match=sentence):
        policy(make())


def test_sizes_of_whole_numbers_and_comparisons_of_floats_are_fine(rng):
    """As of ELU by hand, and of a flattening whose size follows from the input's."""
    nodes = [
        helper.make_node("Shape", ["obs"], ["size"]),
        helper.make_node("Mul", ["size", "one"], ["same"]),
        helper.make_node("Reshape", ["obs", "same"], ["x"]),
        helper.make_node("Greater", ["x", "zero"], ["is_positive"]),
        helper.make_node("Mul", ["x", "tenth"], ["tenths"]),
        helper.make_node("Where", ["is_positive", "x", "tenths"], ["y"]),
        helper.make_node("MatMul", ["y", "w"], ["actions"]),
    ]
    weights = rng.standard_normal((5, 2)).astype(np.float32)
    tensors = [("one", np.array([1])), ("zero", np.float32(0)), ("tenth", np.float32(0.1))]
    found = policy(model(nodes, 5, 2, [("w", weights), *tensors], NAMES, rows="batch"))
    inputs = rng.standard_normal((9, 5))
    expected = np.where(inputs > 0, inputs, 0.1 * inputs) @ weights
    np.testing.assert_allclose(found.mean(inputs), expected, atol=1e-5)


def many(kind):
    made = elu_model(LAYERS, NAMES)
    value = helper.make_tensor_value_info("i", TensorProto.FLOAT, [1])
    if kind == "inputs":
        made.graph.input.extend([value] * 10**5)
    elif kind == "opsets":
        made.opset_import.extend([helper.make_opsetid("other", 1)] * 10**5)
    elif kind == "summands":
        made.graph.node.append(helper.make_node("Sum", ["actions"] * 10**5, ["sum"]))
    else:
        made.graph.initializer[0].dims[:] = [1] * 10**5
    return made


@pytest.mark.parametrize("kind", ["inputs", "opsets", "summands", "axes"])
def test_a_file_of_many_parts_is_refused_before_they_are_looked_at(kind):
    with pytest.raises(InvalidInputError, match=r"has [12]0{2}\d+ nodes") as refused:
        policy(many(kind))
    assert len(str(refused.value)) < 200


@pytest.mark.parametrize(
    ("operator", "less", "answer"),
    [("Log", 0.0, "-inf"), ("Reciprocal", 1.0, "inf"), ("Sqrt", -1.0, "nan")],
)
def test_zeros_ones_and_random_observations_are_tried(operator, less, answer):
    nodes = [
        helper.make_node("Sub", ["obs", "less"], ["x"]),
        helper.make_node(operator, ["x"], ["y"]),
        helper.make_node("MatMul", ["y", "w"], ["actions"]),
    ]
    tensors = [("less", np.float32(less)), ("w", np.ones((5, 2), np.float32))]
    with pytest.raises(InvalidInputError, match=rf"answers the .* with \[{answer}, "):
        policy(model(nodes, 5, 2, tensors, NAMES))


def test_each_answer_must_be_finite(rng):
    nodes = [
        helper.make_node("Log", ["obs"], ["logarithm"]),
        helper.make_node("MatMul", ["logarithm", "w"], ["actions"]),
    ]
    clipped = NAMES | {"action_clip": "-1;1"}  # which would hide that one is infinite
    made = model(nodes, 5, 2, [("w", np.ones((5, 2), np.float32))], clipped, rows="batch")
    with pytest.raises(InvalidInputError, match=r"with \[-inf, -inf\]"):
        policy(made)
    made.graph.node[0].op_type = "Exp"
    found = policy(made)
    inputs = rng.standard_normal((70, 5))
    assert found.mean(inputs).shape == (70, 2)
    inputs[66, 2] = 1e5
    for given in (inputs, inputs[66]):
        with pytest.raises(InvalidInputError, match=r"answers the .* with \[inf, inf"):
            found.mean(given)
    inputs[66, 2] = np.inf  # a rollout that has diverged
    found.mean(inputs)


def test_files_that_hold_no_policy_are_refused_before_they_are_read(tmp_path):
    path = tmp_path / "policy.onnx"
    with pytest.raises(InvalidInputError, match="No such file or directory; name the ONNX file"):
        open_policy(path)
    with path.open("wb") as file:
        file.truncate(2 << 30)  # 2 GB, of which the disk holds nothing
    with pytest.raises(InvalidInputError, match="it has 2147 MB, and at most 67 MB are read"):
        open_policy(path)
    path.write_bytes(b"\x00 this is no ONNX")
    with pytest.raises(InvalidInputError, match="is not an ONNX model, or is damaged"):
        open_policy(path)
