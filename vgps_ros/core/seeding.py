# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Random draws that depend only on a seed and on their purpose and place in a run.

Every draw has its own stream, which purpose and place name. Two processes that make the same draw
therefore agree bit for bit, whatever each drew before.
"""

from enum import IntEnum

import numpy as np

from vgps_ros.core.settings import Range, Setting

SEED = Setting("seed", 0, Range(0, 2**62), "seed of all random draws")


class Stream(IntEnum):
    """The purposes of random draws. Numbers are part of a run's identity: never change them."""

    INITIAL_STATES = 1
    INITIAL_CONTROLS = 2
    POLICY_PARAMETERS = 3
    POLICY_DERIVATIVES = 4
    POLICY_FIT = 5
    EVALUATION = 6
    EXECUTION = 7
    POLICY_ROLLOUTS = 8
    GUIDING_ROLLOUTS = 9
    DATASET = 10
    BOUND = 11
    COVERAGE = 12
    DISTURBANCES = 13
    DYNAMICS_DERIVATIVES = 14
    COMMANDS = 15
    RENEWAL = 16
    JUDGEMENT = 17
    IMU = 18


def generator(seed: int, stream: Stream, *place: int) -> np.random.Generator:
    """Returns the generator of one draw.

    Args:
        seed: seed of the run, at least 0.
        stream: purpose of the draw.
        place: its place in the run, for example iteration and trajectory index.
    """
    return np.random.default_rng([seed, int(stream), *place])
