# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""ONNX files of strangers that are refused before anything of them is executed."""

import pytest
from onnx import TensorProto, helper

from tests.onnx_models import elu_layers, elu_model
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.policies import onnx_file
from vgps_ros.policies.onnx_file import metadata_of, package, parse_model
from vgps_ros.policies.policy_file import open_policy

NAMES = {"joint_names": "hip", "task": "rotor"}


def made():
    return elu_model(elu_layers(3, 1), NAMES)


def with_function():
    model = made()
    node = helper.make_node("Identity", ["x"], ["y"])
    opset = [helper.make_opsetid("", 17)]
    model.functions.append(helper.make_function("own", "own", ["x"], ["y"], [node], opset))
    return model


def external_and_sparse():
    """The values of a sparse tensor are kept in a file that the model names."""
    values = helper.make_tensor("secret", TensorProto.FLOAT, [1], [1.0])
    values.ClearField("float_data")
    values.data_location = TensorProto.EXTERNAL
    values.external_data.add(key="location", value="/etc/passwd")
    indices = helper.make_tensor("at", TensorProto.INT64, [1], [0])
    sparse = helper.make_sparse_tensor(values, indices, [4])
    model = made()
    model.graph.sparse_initializer.append(sparse)
    return model


def test_a_network_and_its_words_are_read_as_they_stand():
    model = parse_model(made().SerializeToString(), "It")
    assert [node.op_type for node in model.graph.node] == ["Gemm", "Elu"] * 2 + ["Gemm"]
    assert metadata_of(model) == NAMES


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (with_function, "It has local functions"),
        (external_and_sparse, "sparse tensors|keeps its weights in another file"),
    ],
)
def test_what_could_reach_beyond_the_graph_is_refused(make, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        parse_model(make().SerializeToString(), "It")


def test_size_and_number_of_parts_are_bounded(monkeypatch):
    content = made().SerializeToString()
    monkeypatch.setattr(onnx_file, "_MOST_PARTS", 44)
    assert len(parse_model(content, "It").graph.node) == 5
    monkeypatch.setattr(onnx_file, "_MOST_PARTS", 43)
    with pytest.raises(InvalidInputError, match=r"It has 44 nodes, .* at most 43"):
        parse_model(content, "It")
    monkeypatch.setattr(onnx_file, "LARGEST", len(content) - 1)
    with pytest.raises(InvalidInputError, match="It is larger than"):
        parse_model(content, "It")


def test_a_path_that_the_system_refuses_is_named(tmp_path):
    with pytest.raises(InvalidInputError, match="cannot be read: File name too long"):
        open_policy(tmp_path / ("a" * 300 + ".onnx"))


def test_a_package_that_is_missing_is_named_with_the_way_to_install_it():
    with pytest.raises(VgpsError, match="needs the package no_such_package: run `pip install"):
        package("no_such_package.part")


def test_numbers_of_the_metadata_are_one_for_all_or_one_for_each():
    said = {"scale": "0.5", "each": "1, 2,3", "bad": "1,x,3"}
    numbers = onnx_file.numbers_of
    assert numbers(said, "scale", 1.0, 3, "It").tolist() == [0.5, 0.5, 0.5]
    assert numbers(said, "each", 1.0, 3, "It").tolist() == [1.0, 2.0, 3.0]
    assert numbers(said, "missing", 7.0, 2, "It").tolist() == [7.0, 7.0]
    with pytest.raises(InvalidInputError, match="'bad' of It must hold numbers only"):
        numbers(said, "bad", 1.0, 3, "It")
    with pytest.raises(InvalidInputError, match="'each' of It has 3 values"):
        numbers(said, "each", 1.0, 2, "It")
