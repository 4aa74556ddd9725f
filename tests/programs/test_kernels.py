# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trainings under several kernels of BLAS: other bytes, and costs within a tolerance."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import yaml

from vgps_ros.search.metrics import METRICS

pytestmark = pytest.mark.slow

KERNELS = ("Sandybridge", "Prescott", "Nehalem")
# Of the costs, over two iterations; each further fit enlarges the rounding, a thousandfold or more.
TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The folder of a short training by its kernel."""
    folders = {kernel: tmp_path_factory.mktemp(kernel) for kernel in KERNELS}
    for kernel, folder in folders.items():
        words = ["--task", "rotor", "--iterations", "2", "--seed", "1", "--output", str(folder)]
        subprocess.run(
            [sys.executable, "-m", "vgps_ros.programs", "train", *words],
            env={**os.environ, "OPENBLAS_CORETYPE": kernel},
            capture_output=True,
            check=True,
        )
    return folders


def test_each_run_says_what_its_bytes_depend_on(runs):
    kernels: set[str] = set()
    for kernel, folder in runs.items():
        said = yaml.safe_load((folder / "environment.yaml").read_text())
        assert len(said["arithmetic"]["blas_kernels"]) == 1
        assert said["variables"]["OPENBLAS_CORETYPE"] == kernel
        assert said["arithmetic"]["processor"]
        assert {"numpy", "torch", "mujoco"} < set(said["packages"])
        kernels.update(said["arithmetic"]["blas_kernels"])
    assert len(kernels) > 1


def test_the_bytes_differ_and_the_costs_agree_within_the_tolerance(runs):
    assert len({(folder / "policy.json").read_bytes() for folder in runs.values()}) > 1
    results = [json.loads((f / "result.json").read_text())["iterations"] for f in runs.values()]
    costs = [name for name in METRICS if "cost" in name]
    found = np.array([[[k[name] for name in costs] for k in result] for result in results])
    np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), rtol=TOLERANCE)
