# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs the whole graph for long with random faults, in lock-step and in real time.

Memory and open files of each process must be flat: what it takes when it begins to work does not
count, and over the rest of its life the median slope between any two samples (Theil and Sen) must
vanish, so that a single step, as of the first backlog after a hang, is no growth, but one for each
fault is. Shared memory must be flat over the whole time.
"""

import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import theilslopes

from tests.faults.campaign import Tally, strike, verify
from tests.faults.kinds import FAULTS
from tests.faults.system import NODES, System
from tests.nodes.conftest import open_graph, private_memory

PERIOD = 2.0  # between two samples [s]
WARM_UP = 120.0  # in which a process takes what it needs to work [s]
LONG = 120.0  # a shorter life after that says nothing of growth [s]
KILLING = ("killed", "started anew", "checkpoint cut off")  # end of kinds that end a life
FLAT = {"memory [MB/min]": 1.0, "open files [1/min]": 0.5}
SHARED_FLAT = 8.0  # growth of /dev/shm over the whole time [MB]


@dataclass
class Growth:
    """What grew.

    Attributes:
        rates: for each node and quantity, the growth per minute of each long life.
        shared: size of /dev/shm after each fault [MB].
    """

    rates: dict[str, dict[str, list[float]]] = field(
        default_factory=lambda: defaultdict(lambda: defaultdict(list))
    )
    shared: list[float] = field(default_factory=list)

    @property
    def shared_growth(self) -> float:
        """Growth of /dev/shm from the second third to the last one [MB]."""
        third = len(self.shared) // 3
        if not third:
            return 0.0
        return float(np.median(self.shared[-third:]) - np.median(self.shared[third : 2 * third]))

    @property
    def is_flat(self) -> bool:
        """Whether nothing grew."""
        rates = [
            np.median(values) <= FLAT[quantity]
            for quantities in self.rates.values()
            for quantity, values in quantities.items()
        ]
        return bool(self.rates) and all(rates) and self.shared_growth <= SHARED_FLAT

    def show(self) -> None:
        """Prints the table."""
        table = Table("node", "long lives", *FLAT)
        for node, quantities in sorted(self.rates.items()):
            medians = [f"{np.median(quantities[quantity]):.2f}" for quantity in FLAT]
            table.add_row(node, str(len(next(iter(quantities.values())))), *medians)
        Console().print(table)
        print(f"growth of /dev/shm: {self.shared_growth:.1f} MB")


class Lives:
    """Samples of each process's memory and open files while it lives.

    Args:
        growth: what the rates of growth are added to.
        path: file for the samples, which stays with the logs of a run that fails.
    """

    def __init__(self, growth: Growth, path: Path):
        self._growth, self._path = growth, path
        self._samples: dict[int, tuple[str, list[tuple[float, float, float]]]] = {}

    def sample(self, system: System) -> None:
        """Takes a sample of each node."""
        for name in NODES:
            pid = system.processes[name].pid
            try:
                sample = (time.monotonic(), private_memory(pid), float(len(list(_open_files(pid)))))
            except OSError:  # it is about to be started again
                continue
            self._samples.setdefault(pid, (name, []))[1].append(sample)

    def close(self) -> None:
        """Writes the samples, and turns them into rates of growth."""
        lines = [",".join(("node", "pid", "time [s]", "memory [MB]", "open files"))]
        for pid, (name, samples) in self._samples.items():
            lines += [f"{name},{pid},{t:.1f},{mb:.1f},{files:g}" for t, mb, files in samples]
            for quantity, rate in growth_rates(samples).items():
                self._growth.rates[name][quantity].append(rate)
        self._path.write_text("\n".join(lines) + "\n")


def growth_rates(samples: Sequence[tuple[float, ...]]) -> dict[str, float]:
    """Returns the slope of each quantity over a life [1/min]; of a short life none.

    Args:
        samples: times [s], each with one value a quantity, in the order of FLAT.
    """
    table = np.array(samples)
    times, *quantities = table[table[:, 0] - table[0, 0] > WARM_UP].T
    if times.size == 0 or np.ptp(times) < LONG:
        return {}
    slopes = [float(theilslopes(values, times / 60.0).slope) for values in quantities]
    return dict(zip(FLAT, slopes, strict=True))


def soak(folder: Path, task: str, seed: int, duration: float, tally: Tally) -> Growth:
    """Runs both modes, each for half of the time."""
    growth, rng, say = Growth(), Random(seed), partial(print, flush=True)
    for mode in ("lock_step", "real_time"):
        (folder / mode).mkdir()
        with open_graph(folder / mode) as graph:
            system = System(graph, task, mode, iterations=20, rng=rng)
            lives = Lives(growth, folder / mode / "memory.csv")
            end = time.monotonic() + duration / 2
            while time.monotonic() < end:
                kind = _choose(rng)
                pause = time.monotonic() + rng.uniform(2.0, 20.0)
                while time.monotonic() < pause:
                    system.spin(PERIOD)
                    lives.sample(system)
                works = strike(system, kind, tally)
                growth.shared.append(_shared_memory())
                left = max(0.0, end - time.monotonic()) / 60.0
                outcome = "works again" if works else "FAILED"
                say(f"{mode}: {kind:32s} {outcome}; {left:.1f} min left")
                if not works:
                    break
            lives.close()
            verify(system, tally, say)
    return growth


def _choose(rng: Random) -> str:
    """Chooses a fault, one that ends a process less often: growth needs long lives to be seen."""
    ending = [kind for kind in FAULTS if kind.endswith(KILLING)]
    others = [kind for kind in FAULTS if kind not in ending]
    return rng.choice(ending if rng.random() < 0.2 else others)


def _open_files(pid: int) -> list[Path]:
    return list(Path(f"/proc/{pid}/fd").iterdir())


def _shared_memory() -> float:
    return sum(file.stat().st_blocks for file in Path("/dev/shm").glob("*fastrtps*")) * 512 / 1e6
