# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Requests of Algorithm 1 small enough for a unit test."""

import dataclasses

import numpy as np
import pytest

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.search.optimization_request import OptimizationRequest
from vgps_ros.search.situations import Situation
from vgps_ros.search.trajectory_optimization import optimize


@pytest.fixture
def policy(swimmer, rng):
    """Some policy that fits the swimmer."""
    architecture = Architecture(swimmer.observation.names, (5,), 2)
    parameters = rng.standard_normal(architecture.num_parameters)
    return GaussianPolicy(architecture, parameters, np.array([3.0, 5.0]))


@pytest.fixture
def first_request(short_swimmer, rng):
    """Line 1 of Algorithm 1."""
    return OptimizationRequest(
        trajectory_index=0,
        iteration=0,
        seed=0,
        cost_scale=1.0,
        max_iterations=3,
        situation=Situation.at_start(short_swimmer),
        guess=short_swimmer.begin.controls(short_swimmer, 40, rng),
    )


@pytest.fixture
def next_request(short_swimmer, first_request, policy):
    """Line 6 of Algorithm 1."""
    return dataclasses.replace(
        first_request,
        iteration=1,
        cost_scale=0.9,
        guess=None,
        previous=optimize(short_swimmer, first_request).distribution,
        policy=policy,
    )
