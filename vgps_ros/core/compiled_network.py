"""The policy's network for compiled loops; it computes the same as `GaussianPolicy.mean`."""

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compiled
from vgps_ros.core.policy import ACTIVATIONS, GaussianPolicy
from vgps_ros.core.records import Array

CompiledNetwork = tuple[Array, NDArray[np.int64], NDArray[np.bool_], int]

_ACTIVATIONS = tuple(ACTIVATIONS)
_SOFTPLUS, _TANH = _ACTIVATIONS.index("softplus"), _ACTIVATIONS.index("tanh")


def compiled_network(policy: GaussianPolicy) -> CompiledNetwork:
    """Returns θ, the layers' sizes, which of them have biases, and the activation."""
    shape = policy.architecture
    return (
        np.array(policy.parameters),
        np.array(shape.layer_sizes),
        np.array(shape.biased),
        _ACTIVATIONS.index(shape.activation),
    )


@compiled
def network_output(network, a, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes μ_θ(o) over o, the beginning of a; a and z must be as long as the widest layer."""
    parameters, sizes, biased, activation = network
    start = 0
    for layer in range(len(biased)):
        n_in, n_out = sizes[layer], sizes[layer + 1]
        end = start + n_out * n_in
        for o in range(n_out):
            z[o] = parameters[end + o] if biased[layer] else 0.0
            for i in range(n_in):
                z[o] += parameters[start + o * n_in + i] * a[i]
        last = layer == len(biased) - 1
        for o in range(n_out):
            a[o] = z[o] if last else _activate(activation, z[o])
        start = end + n_out if biased[layer] else end


@compiled
def _activate(activation, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    if activation == _SOFTPLUS:
        return max(z, 0.0) + np.log1p(np.exp(-abs(z)))
    if activation == _TANH:
        return np.tanh(z)
    return max(z, 0.0)
