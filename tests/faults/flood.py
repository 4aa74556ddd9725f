# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Floods a robot and its recorder with a stranger's messages for long: their memory must be flat.

    python -m tests.faults.flood --minutes 60

Each minute it asks the recorder a question, which must be answered, and prints each node's memory.
The recorder begins a new file often, and those that are closed are removed, as its disk would be
full otherwise. What it keeps of each chunk, for the end of the bag, is no growth.
"""

import argparse
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters

from tests.faults.kinds import GROWTH
from tests.faults.soak import FLAT, PERIOD, growth_rates
from tests.nodes.conftest import Graph, open_graph, private_memory

NODES = ("simulation", "policy_executor", "recorder", "visualizer")
ANSWERED = 20.0  # in which the recorder answers a question amid the flood [s]
FILLING = 180.0  # in which what may wait in each node fills, beside the soak's warming up [s]
FILE = 500.0  # size of the recorder's files [MB]
INDEX = 40e-6  # that the recorder keeps of each chunk, of which a message has one at most [MB]


def flood(folder: Path, minutes: float) -> list[str]:
    """Floods the graph; returns what is wrong, in sentences."""
    # Times [s] with the memory that counts, and all of the memory [MB].
    samples: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    wrong = []
    with open_graph(folder) as graph:
        processes = {
            name: graph.start(name, task="rotor") for name in ("simulation", "policy_executor")
        }
        processes["recorder"] = graph.start("recorder", output=folder / "bag", max_file_size=FILE)
        processes["visualizer"] = graph.start("visualizer", output=folder / "run.rrd")
        for name in NODES:
            graph.diagnosis(name, DiagnosticStatus.OK)
        command = [sys.executable, "-m", "tests.faults.strangers", "flood", str(60.0 * minutes)]
        strangers = graph.start_command("strangers", command)
        began, minute, recorded = time.monotonic(), 0, 0
        print("minute", *(f"{name} [MB]" for name in NODES), "recorded", "answer [s]", sep="\t")
        while strangers.running:
            graph.spin_for(PERIOD)
            now = time.monotonic()
            for name, process in processes.items():
                if not process.running:
                    return [f"{name} ended: {process.output}"]
                memory = private_memory(process.pid)
                kept = INDEX * recorded if name == "recorder" else 0.0
                samples[name].append((now, memory - kept, memory))
            for file in _closed(folder / "bag"):
                file.unlink()
            if now - began > 60.0 * minute:
                recorded = _recorded(graph)
                row = [f"{samples[name][-1][2]:.0f}" for name in NODES]
                print(minute, *row, recorded, f"{_answered(graph):.2f}", sep="\t", flush=True)
                minute += 1
        print(strangers.output, end="")
    for name in NODES:
        memory = np.array(samples[name])[:, 2]
        full = [sample for sample in samples[name] if sample[0] > began + FILLING]
        rate = growth_rates(full).get("memory [MB/min]", 0.0) if full else 0.0
        print(f"{name}: {rate:+.2f} MB/min, {memory.max() - memory[0]:.0f} MB above its beginning")
        if rate > FLAT["memory [MB/min]"] or memory.max() - memory[0] > GROWTH:
            wrong.append(f"{name} grows.")
    return wrong


def _closed(bag: Path) -> list[Path]:
    """Returns the files of a bag that its recorder has closed."""
    return sorted(bag.glob("*.mcap"), key=lambda file: file.stat().st_mtime_ns)[:-1]


def _recorded(graph: Graph) -> int:
    """Returns how many messages the recorder has taken so far."""
    status = graph.diagnosis("recorder", None, timeout=ANSWERED)
    return next(int(value.value) for value in status.values if value.key == "messages")


def _answered(graph: Graph) -> float:
    """Asks the recorder a question; returns how long it took to answer [s]."""
    began = time.monotonic()
    request = GetParameters.Request(names=["cache_size"])
    graph.call(GetParameters, "recorder/get_parameters", request, ANSWERED)
    return time.monotonic() - began


def main() -> int:
    """Runs the flood; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.flood", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    with tempfile.TemporaryDirectory(prefix="vgps_ros_flood_") as folder:
        wrong = flood(Path(folder), parser.parse_args().minutes)
    print("\n".join(wrong) or "Nothing grows.")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
