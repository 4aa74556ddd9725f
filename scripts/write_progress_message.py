# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes the definition of the message LearningProgress from the metrics that are declared.

Run it in the repository's root after a change of `vgps_ros/search/metrics.py`, and build again:

    python scripts/write_progress_message.py
"""

from pathlib import Path
from typing import get_type_hints

from vgps_ros.search.metrics import METRICS, IterationMetrics

PATH = Path(__file__).parents[1] / "msg_schemas" / "msg" / "LearningProgress.msg"
TYPES = {float: "float64", int: "uint64", str: "string", tuple[float, ...]: "float64[]"}
HEAD = """\
# One iteration of Algorithm 1 in numbers.
# Written by scripts/write_progress_message.py from vgps_ros/search/metrics.py; do not edit.

# stamp: time at which the iteration ended
std_msgs/Header header
# name of the task
string task
# policy search method, for example vgps
string method
# seed of all random draws of the run
uint64 seed
# k = 1, 2, ...
uint32 iteration
# iterations that the run will do
uint32 iterations
"""
# It keeps the place that it has in older bags.
REMAINING = "# estimate of the time left [s]\nfloat64 remaining_seconds\n"


def definition() -> str:
    """Returns the text of the message's definition."""
    kinds, text = get_type_hints(IterationMetrics), HEAD
    for name, metric in METRICS.items():
        if name == "simulator_steps":
            text += REMAINING
        text += f"# {metric.description}\n{TYPES[kinds[name]]} {name}\n"
    return text


if __name__ == "__main__":
    PATH.write_text(definition())
    print(f"Wrote {PATH}.")
