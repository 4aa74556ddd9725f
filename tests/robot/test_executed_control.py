# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Executed controls have the same bits whatever BLAS, libm and compiler find in the processor."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from vgps_ros.core.seeding import Stream, generator
from vgps_ros.robot.executed_control import ExecutedPolicy, _exp, _log1p

BITS = """
import hashlib
import numpy as np
from vgps_ros.robot.executed_control import ExecutedPolicy
from vgps_ros.core.policy import Architecture, GaussianPolicy
rng, digest = np.random.default_rng(3), hashlib.sha256()
for activation in ("softplus", "tanh", "relu"):
    shape = Architecture(tuple(f"x{i}" for i in range(17)), (64, 64), 6, activation)
    policy = GaussianPolicy(shape, rng.standard_normal(shape.num_parameters), np.ones(6))
    executed = ExecutedPolicy(policy)
    for i in range(500):
        digest.update(executed.control(rng.standard_normal(17), i, 5).tobytes())
print(digest.hexdigest())
"""
BLAS = """
import numpy as np
x = np.random.default_rng(3).standard_normal((64, 64))
print((x @ x).tobytes().hex())
"""
KERNELS = ("Sandybridge", "Prescott", "Nehalem", "Haswell")


def printed(program: str, **variables: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout


@pytest.mark.slow
def test_the_bits_do_not_depend_on_the_kernel_of_blas():
    own = printed(BITS)
    assert {printed(BITS, OPENBLAS_CORETYPE=kernel) for kernel in KERNELS[:3]} == {own}
    # The variable does choose: products of NumPy differ.
    assert len({printed(BLAS, OPENBLAS_CORETYPE=kernel) for kernel in KERNELS}) > 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "variables",
    [
        # Machine code of an old processor without fused multiply-add, compiled anew.
        {"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": ""},
        {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2,-AVX512F"},
    ],
)
def test_the_bits_do_not_depend_on_the_processor_s_features(tmp_path, variables):
    assert printed(BITS, NUMBA_CACHE_DIR=str(tmp_path), **variables) == printed(BITS)


def test_the_activations_own_functions_are_those_of_libm_up_to_rounding():
    for z in [*np.linspace(-40.0, 0.0, 4001), -1e-300, -699.9]:
        assert _exp(np.array(z)) == pytest.approx(math.exp(z), rel=4e-16, abs=0)
    smallest, *ends = (float(_exp(np.array(z))) for z in (-700.0, -701.0, -np.inf, -0.0))
    assert ends == [smallest, smallest, 1.0]
    assert math.isnan(_exp(np.array(np.nan)))
    for y in [*np.linspace(0.0, 1.0, 1001), 1e-300, 1e-12]:
        assert _log1p(np.array(y)) == pytest.approx(math.log1p(y), rel=4e-16, abs=0)


def test_noise_is_that_of_its_seed_and_stamp(random_policy):
    policy = random_policy()
    executed, inputs = ExecutedPolicy(policy), np.array([0.3, -1.0, 2.0])
    mean = executed.mean(inputs)
    np.testing.assert_allclose(mean, policy.mean(inputs), rtol=1e-13)
    assert np.array_equal(executed.control(inputs, 7), mean)
    noisy = executed.control(inputs, 7, seed=1)
    noise = generator(1, Stream.EXECUTION, 7).standard_normal(2)
    assert np.array_equal(noisy, mean + policy.noise_std * noise)
    assert not np.array_equal(noisy, executed.control(inputs, 8, seed=1))
    assert not np.array_equal(noisy, executed.control(inputs, 7, seed=2))
    assert not np.array_equal(executed.control(inputs, -7, seed=1), noisy)  # as in damaged bags
