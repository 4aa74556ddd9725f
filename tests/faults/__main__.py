# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Command line of the fault campaign and the soak test."""

import argparse
import random
import shutil
import sys
import tempfile
import time
from pathlib import Path
from random import Random

from rich.console import Console
from rich.table import Table

from tests.faults.campaign import Tally, choose, run
from tests.faults.soak import soak
from tests.faults.system import System
from tests.nodes.conftest import open_graph


def main() -> int:
    """Runs it; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("--count", type=int, default=40, help="faults to inject")
    parser.add_argument("--minutes", type=float, help="soak: inject for as long, and watch growth")
    parser.add_argument("--seed", type=int, help="of all that is random; printed; default: random")
    parser.add_argument("--only", default="", help="kinds whose name contains this text")
    parser.add_argument("--task", default="swimmer", help="what the graph learns")
    arguments = parser.parse_args()
    seed = random.randrange(10**6) if arguments.seed is None else arguments.seed
    print(f"faults: seed {seed}", flush=True)
    folder, good = Path(tempfile.mkdtemp(prefix="vgps_ros_faults_")), False
    try:
        good = inject(arguments, seed, folder)
    finally:
        if good:
            shutil.rmtree(folder)
        else:
            kept = f"Logs and bags are kept in {folder}; remove it when you have looked at them."
            print(kept, file=sys.stderr)  # the last line of the output is the summary
    return 0 if good else 1


def inject(arguments: argparse.Namespace, seed: int, folder: Path) -> bool:
    """Runs the campaign or the soak and prints its table; returns whether all went well."""
    began, tally = time.monotonic(), Tally()
    if arguments.minutes:
        growth = soak(folder, arguments.task, seed, 60.0 * arguments.minutes, tally)
    else:
        rng = Random(seed)
        kinds = choose(rng, arguments.count, arguments.only)
        with open_graph(folder) as graph:
            system = System(graph, arguments.task, "real_time", iterations=20, rng=rng)
            run(system, kinds, tally, lambda line: print(line, flush=True))
        growth = None
    show(tally)
    print(
        f"{tally.recorded} messages recorded, {tally.compared} of them looked for in the bags; "
        f"{tally.trainings} trainings compared; {time.monotonic() - began:.0f} s; "
        f"a silent node was missed by all others after {tally.slowest:.1f} s at most"
    )
    if growth:
        growth.show()
    for sentence in tally.wrong + tally.lost:
        print(sentence)
    print(tally.summary())
    return tally.is_good and (growth is None or growth.is_flat)


def show(tally: Tally) -> None:
    """Prints the table of faults by kind."""
    table = Table("fault", "injected", "survived", "recovered")
    for kind, count in sorted(tally.injected.items()):
        table.add_row(kind, str(count), str(tally.survived[kind]), str(tally.recovered[kind]))
    Console().print(table)


if __name__ == "__main__":
    sys.exit(main())
