# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Networks as ONNX files: those of others by the package onnx alone, ours by `vgps export`."""

from itertools import pairwise

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.storage.run_folder import save_policy

ELEMENTS = {np.float32: TensorProto.FLOAT, np.float64: TensorProto.DOUBLE}


def elu_layers(n_in, n_out, hidden=(16, 8), seed=0):
    """Draws weights (n_out, n_in) and biases (n_out,) of each layer."""
    rng, sizes = np.random.default_rng(seed), (n_in, *hidden, n_out)
    return [
        (rng.standard_normal((n, m)) / np.sqrt(m), 0.1 * rng.standard_normal(n))
        for m, n in pairwise(sizes)
    ]


def elu_mean(layers, inputs):
    """What such a network computes, in float64."""
    a = inputs
    for weight, bias in layers[:-1]:
        z = a @ weight.T + bias
        a = np.where(z > 0, z, np.expm1(np.minimum(z, 0)))
    return a @ layers[-1][0].T + layers[-1][1]


def model(nodes, n_in, n_out, tensors=(), metadata=None, kind=np.float32, rows=1, **options):
    """A model with the input obs and the output actions; rows=None: vectors, without a batch."""
    element, batch = ELEMENTS[kind], [] if rows is None else [rows]
    graph = helper.make_graph(
        nodes,
        "policy",
        options.pop("inputs", [helper.make_tensor_value_info("obs", element, [*batch, n_in])]),
        [helper.make_tensor_value_info("actions", element, [*batch, n_out])],
        [numpy_helper.from_array(np.asarray(values), name) for name, values in tensors],
    )
    opset = options.pop("opset", 17)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    helper.set_model_props(made, metadata or {})
    return made


def elu_model(layers, metadata, **options):
    """A network of two layers of ELU, an architecture that vgps_ros does not have."""
    nodes, tensors, a = [], [], "obs"
    for i, (weight, bias) in enumerate(layers):
        last = i == len(layers) - 1
        tensors += [(f"w{i}", weight.astype(np.float32)), (f"b{i}", bias.astype(np.float32))]
        out = "actions" if last else f"z{i}"
        nodes.append(helper.make_node("Gemm", [a, f"w{i}", f"b{i}"], [out], transB=1))
        if not last:
            nodes.append(helper.make_node("Elu", [out], [a := f"a{i}"]))
    n_in, n_out = layers[0][0].shape[1], layers[-1][0].shape[0]
    return model(nodes, n_in, n_out, tensors, metadata, **options)


def drawn_policy(task, hidden=(5,), scale=1.0, seed=1):
    """Draws a policy of ours for a task, with weights of about `scale`."""
    shape = Architecture(task.observation.names, hidden, task.dynamics.control_dim)
    parameters = scale * np.random.default_rng(seed).standard_normal(shape.num_parameters)
    return GaussianPolicy(shape, parameters, np.full(shape.control_dim, 0.1))


def exported(policy, task, folder, *words):
    """Exports such a policy; returns the file, beside which policy.json is."""
    save_policy(policy, task.name, folder / "policy.json")
    path = folder / "policy.onnx"
    vgps(["export", str(folder / "policy.json"), "--output", str(path), *map(str, words)])
    return path
