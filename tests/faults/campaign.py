# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Strikes a working graph with random faults, and counts what it survives and what it loses.

    python -m tests.faults --count 40 --seed 7

A fault is survived if what is promised for it happens and no other node dies of it; the graph has
recovered when every node is well and every stream flows again. At the end each training must have
the policy and the numbers that the same training has undisturbed, and every bag all that was
published while its recorder ran.
"""

import json
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from random import Random

from tests.faults.kinds import FAULTS
from tests.faults.records import Recording, Training
from tests.faults.system import System
from tests.faults.trainings import HIDDEN_UNITS, LEARNING
from vgps_ros.bags import BagReader
from vgps_ros.bags.reindex import reindex
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

DISCOVERED = 5.0  # in which all publishers have found a recorder that subscribes to them [s]


@dataclass
class Tally:
    """What a campaign counted, and what went wrong in words."""

    injected: Counter[str] = field(default_factory=Counter)
    survived: Counter[str] = field(default_factory=Counter)
    recovered: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    recorded: int = 0
    compared: int = 0
    trainings: int = 0
    slowest: float = 0.0  # that a silent node went unnoticed by some other [s]

    def summary(self) -> str:
        """Returns the last line."""
        return (
            f"faults: injected {self.injected.total()}, survived {self.survived.total()}, "
            f"recovered {self.recovered.total()}, lost {len(self.lost)}"
        )

    @property
    def is_good(self) -> bool:
        """Whether everything was survived and nothing lost."""
        counts = {self.injected.total(), self.survived.total(), self.recovered.total()}
        compared = self.compared > 0 and self.trainings > 0
        return compared and len(counts) == 1 and not self.lost and not self.wrong


def strike(system: System, kind: str, tally: Tally) -> bool:
    """Injects one fault; returns whether the graph works afterwards."""
    tally.injected[kind] += 1
    system.strikes.append((time.monotonic(), kind))
    system.listener.forget_words()
    try:
        FAULTS[kind](system)
        dead = system.dead()
        assert not dead, f"{', '.join(dead)} ended too: {system.processes[dead[0]].output}"
        tally.survived[kind] += 1
        system.wait_until_it_works()
        tally.recovered[kind] += 1
    except (AssertionError, TimeoutError) as error:
        tally.wrong.append(f"{kind}: {error}")
        print(tally.wrong[-1], flush=True)
        return False
    return True


def choose(rng: Random, count: int, only: str = "") -> list[str]:
    """Returns as many kinds of faults whose names contain a text, each about as often."""
    possible = [kind for kind in FAULTS if only in kind]
    kinds: list[str] = []
    while possible and len(kinds) < count:
        kinds += rng.sample(possible, len(possible))
    return kinds[:count]


def run(system: System, kinds: Sequence[str], tally: Tally, say: Callable[[str], None]) -> None:
    """Strikes with each fault at a random time, then looks what was lost."""
    for number, kind in enumerate(kinds, 1):
        system.spin(system.rng.uniform(2.0, 4.0))  # a new node has heard all others by then
        began = time.monotonic()
        good = strike(system, kind, tally)
        outcome = "works again" if good else "FAILED"
        say(
            f"{number:4d}/{len(kinds)}  {kind:32s} {outcome} after {time.monotonic() - began:.1f} s"
        )
        if not good:
            break
    verify(system, tally, say)


def verify(system: System, tally: Tally, say: Callable[[str], None]) -> None:
    """Ends the work, and notes what was lost."""
    tally.slowest = max(tally.slowest, system.slowest)
    try:
        system.finish_training()
        system.spin(1.0)
        system.end("recorder")
    except (AssertionError, TimeoutError) as error:
        tally.wrong.append(f"the end: {error}")
        return
    bags, trainings = len(system.recordings), len(system.trainings.all)
    say(f"Checking {bags} bags; doing {trainings} trainings again, undisturbed ...")
    for recording in system.recordings:
        check_bag(recording, system, tally)
    for training in system.trainings.all:
        check_training(training, system, tally)


def check_bag(recording: Recording, system: System, tally: Tally) -> None:
    """Notes what is missing in a bag."""
    if not recording.windows and not recording.path.exists():
        return  # its recorder was interrupted before it began
    if recording.killed:
        reindex(recording.path)
    with BagReader(recording.path) as bag:
        topics = sorted({message.topic for message in system.listener.published} & set(bag.topics))
        recorded = {(message.topic, message.data) for message in bag.messages(topics)}
        tally.recorded += sum(bag.counts.values())
    # A stream keeps nothing for those who come later, and no recorder can tell when its publishers
    # have found it.
    found: dict[str, float] = {}
    for message in system.listener.published:
        if recording.covers(message.time) and (message.topic, message.data) in recorded:
            found.setdefault(message.topic, message.time)
    for message in system.listener.published:
        if not system.listener.expects(message, recording):
            continue
        is_early = message.time < recording.windows[0][0] + DISCOVERED
        if is_early and message.time < found.get(message.topic, math.inf):
            continue
        tally.compared += 1
        if (message.topic, message.data) not in recorded:
            began = recording.windows[0][0]
            struck, kind = min(system.strikes, key=lambda strike: abs(strike[0] - message.time))
            tally.lost.append(
                f"{system.mode}: {recording.path.name} lacks {message.topic} "
                f"{message.time - began:.1f} s after it began, "
                f"{message.time - struck:+.1f} s from '{kind}'"
            )


def check_training(training: Training, system: System, tally: Tally) -> None:
    """Notes where a training is not what it is undisturbed."""
    tally.trainings += 1
    task = make_task(system.task)
    settings = replace(
        search_settings(task),
        iterations=system.trainings.iterations,
        hidden_units=(HIDDEN_UNITS,),
        **LEARNING,
    )
    iterations = list(search("vgps", task, settings, training.seed, partial(optimize_all, task)))
    expected = system.graph.folder / "expected.json"
    save_policy(iterations[-1].policy, task.name, expected)
    if (training.folder / "policy.json").read_bytes() != expected.read_bytes():
        tally.lost.append(f"the policy of seed {training.seed} is another one")
    result = json.loads((training.folder / "result.json").read_text())
    if _numbers(result["iterations"]) != _numbers([i.entry() for i in iterations]):
        tally.lost.append(f"the history of seed {training.seed} is another one")


def _numbers(entries: list[dict[str, float]]) -> list[dict[str, float]]:
    return [{k: v for k, v in e.items() if not k.endswith("_seconds")} for e in entries]
