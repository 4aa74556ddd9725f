"""A short campaign; `make faults` runs the long one, `make soak` runs for half an hour."""

from pathlib import Path
from random import Random

from tests.faults.campaign import Tally, choose, run
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
