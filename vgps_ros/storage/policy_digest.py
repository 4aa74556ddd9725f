# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Digests of a training's policies, each of which vouches for all before it."""

import hashlib
import json
from dataclasses import asdict

from vgps_ros.core.arrays import arrays_of
from vgps_ros.core.policy import GaussianPolicy


def policy_digest(policy: GaussianPolicy, before: str = "") -> str:
    """Returns the SHA-256 of a policy and of the digest before it, in hexadecimal.

    Args:
        policy: the policy of iteration k; each bit of its arrays counts, and its shape.
        before: the digest of iteration k − 1; empty for the first.
    """
    digest = hashlib.sha256(f"{before}{json.dumps(asdict(policy.architecture))}".encode())
    for values in arrays_of(policy).values():
        digest.update(values.astype("<f8").tobytes())
    return digest.hexdigest()
