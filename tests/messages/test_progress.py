# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Each metric is declared once, and appears wherever an iteration is told of."""

import math
import runpy
from pathlib import Path
from typing import get_type_hints

from builtin_interfaces.msg import Time

from benchmarks.figure1.table import SCHEMA
from vgps_ros.messages.conversions import progress_from_msg, progress_to_msg
from vgps_ros.search.metrics import METRICS, IterationMetrics

SCRIPT = Path(__file__).parents[2] / "scripts" / "write_progress_message.py"
KINDS = {name: kind for name, kind in get_type_hints(IterationMetrics).items() if name in METRICS}
VALUES = {float: 0.1, int: 7, str: "a", tuple[float, ...]: (0.1, 0.2)}
ITERATION = IterationMetrics(k=3, **{name: VALUES[kind] for name, kind in KINDS.items()})


def sent(metrics):
    context = {"task": "rotor", "method": "vgps", "seed": 5, "iterations": 9}
    return progress_to_msg(metrics, **context, remaining_seconds=1.5, stamp=Time(sec=2))


def test_the_message_carries_every_metric():
    assert progress_from_msg(sent(ITERATION)) == ITERATION
    assert (sent(ITERATION).iteration, sent(ITERATION).remaining_seconds) == (3, 1.5)


def test_an_entry_of_result_json_has_every_metric_and_no_infinity():
    assert list(ITERATION.entry()) == ["k", *METRICS]
    assert ITERATION.entry()["noise_std"] == [0.1, 0.2]
    diverged = IterationMetrics(**{**vars(ITERATION), "ddp_cost": math.inf})
    assert diverged.entry() == {**ITERATION.entry(), "ddp_cost": None}


def test_the_table_of_an_experiment_has_a_column_for_every_metric_that_is_one_number():
    assert [name for name in KINDS if KINDS[name] in (float, int)] == [
        name for name in SCHEMA.names if name in METRICS
    ]


def test_the_definition_of_the_message_is_the_one_that_the_script_writes():
    script = runpy.run_path(str(SCRIPT))
    assert script["PATH"].read_text() == script["definition"](), (
        "Run `python scripts/write_progress_message.py` and build again: the message "
        "LearningProgress lacks a change of vgps_ros/search/metrics.py."
    )
