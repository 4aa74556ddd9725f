# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A short campaign; `make faults` runs the long one, `make soak` runs for half an hour."""

from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.faults.campaign import Tally, choose, run
from tests.faults.soak import FLAT, WARM_UP, growth_rates
from tests.faults.system import System
from tests.nodes.conftest import open_graph

SEED = 20131205


def test_ten_faults_are_survived_and_nothing_is_lost(tmp_path: Path) -> None:
    rng, tally = Random(SEED), Tally()
    kinds = choose(rng, 10)
    with open_graph(tmp_path) as graph:
        system = System(graph, "rotor", "real_time", iterations=10, rng=rng)
        run(system, kinds, tally, print)
    assert tally.is_good, "\n".join([tally.summary(), *tally.wrong, *tally.lost])


@pytest.mark.parametrize(
    ("memory", "grows"),
    [
        (lambda minutes: 300.0 + 5.0 * (minutes < 1.0) * minutes, False),  # as it begins to work
        (lambda minutes: 300.0 + 20.0 * (minutes > 4.0), False),  # a step, as of the first backlog
        (lambda minutes: 300.0 + 0.5 * np.floor(3.0 * minutes), True),  # something of each fault
        (lambda minutes: 300.0 + 1.5 * minutes, True),
    ],
)
def test_the_soak_tells_growth_from_a_step(memory, grows):
    minutes = np.arange(0.0, 10.0, 0.05)
    noise = np.random.default_rng(1).normal(0.0, 1.0, minutes.size)
    samples = np.column_stack([60.0 * minutes, memory(minutes) + noise, np.full(minutes.size, 9)])
    rates = growth_rates(samples)
    assert (rates["memory [MB/min]"] > FLAT["memory [MB/min]"]) == grows
    assert rates["open files [1/min]"] == 0.0
    assert growth_rates(samples[samples[:, 0] < WARM_UP + 60.0]) == {}
