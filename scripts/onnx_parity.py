# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compares exported policies, as onnxruntime executes them, with the policies themselves."""

from typing import Any

import numpy as np
import onnxruntime

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.storage.onnx_graph import PRECISIONS, ExportedPolicy, to_onnx
from vgps_ros.tasks import Task

STATES = 10_000


def parity(task: Task, policy: GaussianPolicy) -> dict[str, Any]:
    """Returns the largest errors in the states of noisy rollouts from perturbed starts.

    They are relative to the largest torque of the same control. A graph in float32 reads rounded
    observations, and so does the policy with which it is compared.
    """
    rng, horizon = np.random.default_rng(0), task.horizon
    count = 2 * -(-STATES // horizon)  # twice as many, since some may diverge
    space, n_u = task.dynamics.space, task.dynamics.control_dim
    spread = task.initial_std * rng.standard_normal((count, space.tangent_dim))
    noise = policy.noise_std * rng.standard_normal((count, horizon, n_u))
    starts = space.add(task.initial_state, spread)
    states, _ = task.dynamics.execute(policy, task.observation, starts, noise)
    flat = states.reshape(-1, states.shape[-1])
    inputs = task.observation(flat[np.isfinite(flat).all(axis=1)][:STATES])
    assert len(inputs) == STATES
    found = {"units": policy.architecture.hidden_units, "readings": len(policy.observed)}
    for precision, kind in PRECISIONS.items():
        exported = ExportedPolicy(policy, task.dynamics.control_limits, precision)
        content = to_onnx(exported, {"observation_names": ",".join(policy.observed)})
        session = onnxruntime.InferenceSession(content)
        read = inputs.astype(kind)
        mean = np.clip(policy.mean(read.astype(float)), *task.dynamics.control_limits)
        (actions,) = session.run(["actions"], {"obs": read})
        errors = np.abs(actions - mean).max(axis=0) / np.abs(mean).max(axis=0)
        found[precision] = float(errors.max())
    return found
