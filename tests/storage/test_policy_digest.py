# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy's digest changes with each of its bits, and with all policies before it."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.storage.run_folder import policy_digest


def test_it_is_the_sha_256_of_the_shape_and_the_little_endian_numbers(random_policy):
    policy = random_policy(("a", "b"), (3,), 2)
    shape = policy.architecture
    words = {name: getattr(shape, name) for name in shape.__dataclass_fields__}
    content = "before" + json.dumps(words)
    numbers = [*policy.parameters, *policy.noise_std]
    expected = hashlib.sha256(content.encode() + np.array(numbers, "<f8").tobytes())
    assert policy_digest(policy, "before") == expected.hexdigest()


@pytest.mark.parametrize("name", ["parameters", "noise_std"])
def test_the_last_bit_of_a_number_counts(name, random_policy):
    policy = random_policy()
    values = getattr(policy, name).copy()
    values[-1] = np.nextafter(values[-1], np.inf)
    assert policy_digest(replace(policy, **{name: values})) != policy_digest(policy)


def test_the_names_and_the_order_of_the_policies_count(random_policy):
    one, other = random_policy(("a", "b")), random_policy(("a", "b"))
    renamed = GaussianPolicy(
        replace(one.architecture, observed=("a", "c")), one.parameters, one.noise_std
    )
    chains = [
        policy_digest(one),
        policy_digest(renamed),
        policy_digest(one, policy_digest(other)),
        policy_digest(other, policy_digest(one)),
    ]
    assert len(set(chains)) == len(chains)
