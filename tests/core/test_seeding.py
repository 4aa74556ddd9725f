# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Streams are part of a run's identity."""

from itertools import product

from vgps_ros.core.seeding import Stream, generator


def test_every_seed_purpose_and_place_has_its_own_stream():
    names = list(product(range(4), Stream, range(12), range(3)))
    draws = {name: generator(*name).random() for name in names}
    assert len({*draws.values()}) == len(names)
    for name, draw in reversed(draws.items()):  # another order, the same numbers
        assert generator(*name).random() == draw


def test_purposes_keep_their_numbers():
    """They are part of a run's identity: another number is another run."""
    assert {s.name: s.value for s in Stream} == {
        "INITIAL_STATES": 1,
        "INITIAL_CONTROLS": 2,
        "POLICY_PARAMETERS": 3,
        "POLICY_DERIVATIVES": 4,
        "POLICY_FIT": 5,
        "EVALUATION": 6,
        "EXECUTION": 7,
        "POLICY_ROLLOUTS": 8,
        "GUIDING_ROLLOUTS": 9,
        "DATASET": 10,
        "BOUND": 11,
        "COVERAGE": 12,
        "DISTURBANCES": 13,
        "DYNAMICS_DERIVATIVES": 14,
        "COMMANDS": 15,
        "RENEWAL": 16,
        "JUDGEMENT": 17,
        "IMU": 18,
    }
