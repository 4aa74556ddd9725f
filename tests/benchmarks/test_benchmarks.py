# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The suite times in turns, survives a benchmark that fails, and writes what it has."""

import json
import time

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from benchmarks import __main__ as suite
from benchmarks.problems import linear_quadratic, with_threads
from benchmarks.solver import CentredDynamics
from benchmarks.timing import Comparison, compare
from vgps_ros.core.ddp.backward_pass import _recursion, backward_pass
from vgps_ros.search.trajectory_optimization import prepare
from vgps_ros.simulation import compiled_derivatives, compiled_loops, compiled_readings
from vgps_ros.tasks import make_task


def test_a_comparison_is_measured_in_turns():
    calls = []
    row = compare(
        "sleeping",
        lambda: (calls.append("ours"), time.sleep(0.002)),
        lambda: (calls.append("peer"), time.sleep(0.008)),
        0.9,
        repetitions=5,
    )
    assert calls == 7 * ["ours", "peer"]
    assert row.met
    assert row.peer >= 8.0


@pytest.mark.parametrize(
    ("ours", "peer", "target", "unit", "met"),
    [
        (1.0, 2.0, 0.5, "ms", True),
        (1.1, 2.0, 0.5, "ms", False),
        (1.0, 2.0, None, "ms", None),
        (1400.0, 2000.0, 0.7, "loops/s", True),
        (1300.0, 2000.0, 0.7, "loops/s", False),
    ],
)
def test_a_target_is_the_ratio_that_must_not_be_passed(ours, peer, target, unit, met):
    row = Comparison("it", ours, peer, target, unit)
    assert row.met is met
    assert row.entry()["ratio"] == pytest.approx(ours / peer)


def test_one_that_fails_does_not_hide_the_others(tmp_path, monkeypatch):
    def fails():
        """Fails after one row."""
        yield Comparison("first", 1.0, 2.0, 0.8)
        raise RuntimeError("the peer is not there")

    def works():
        """Works."""
        yield Comparison("second", 3.0, 2.0, 0.8)
        curve = ((10, 0.1), (100, 1.1), (1000, 12.0))
        yield Comparison("time over steps / linear", 1.04, 1.0, 1.15, "", curve=curve)

    monkeypatch.setattr(suite, "BENCHMARKS", {"fails": fails, "works": works})
    console = Console(width=140, record=True, quiet=False)
    folder = tmp_path / "new"
    assert not suite.run(["fails", "works"], folder, console)
    rows = json.loads((folder / suite.RESULT).read_text())
    assert [(row["name"], row["met"]) for row in rows] == [
        ("first", True), ("second", False), ("time over steps / linear", True)
    ]  # fmt: skip
    assert {"name", "ours", "peer", "ratio", "target", "met"} <= set(rows[0])
    text = console.export_text()
    assert "the peer is not there" in text
    assert "1.500" in text
    assert "| second | 3 ms | 2 ms | 1.500 | 0.8 | no |" in (folder / suite.TABLE).read_text()
    assert Image.open(folder / "growth.png").width > 300


def test_the_peer_has_the_same_derivatives(swimmer):
    motion = swimmer.dynamics.rollout(
        swimmer.initial_state, lambda t, _: 20.0 * np.sin(0.1 * t + np.arange(2)), 30
    )
    peer, _ = with_threads(swimmer, 1, CentredDynamics).dynamics.linearize(motion)
    ours, _ = swimmer.dynamics.linearize(motion)
    np.testing.assert_allclose(ours.f_x, peer.f_x, rtol=0, atol=1e-5)
    np.testing.assert_allclose(ours.f_u, peer.f_u, rtol=0, atol=1e-5)


def test_the_drawn_problem_can_be_solved():
    assert backward_pass(*linear_quadratic(4, 2, 30)).complete


@pytest.mark.parametrize("name", ["rotor", "swimmer", "walker"])
def test_after_its_preparation_a_search_compiles_nothing(name):
    task = make_task(name)
    prepare(task)
    loops = [
        *(compiled_loops.advance, compiled_derivatives.differentiate),
        *(compiled_loops.execute, compiled_loops.follow, _recursion),
        compiled_readings.differentiate_each,
    ]
    before = [len(loop.signatures) for loop in loops]
    needed = before[:-1] if name == "rotor" else before  # which reads coordinates alone
    assert all(needed)
    loops.append(compiled_readings.read_each)  # only of readings that are no coordinates
    before.append(len(compiled_readings.read_each.signatures))
    motion = task.dynamics.rollout(
        task.initial_state, lambda *_: np.zeros(task.dynamics.control_dim), 3
    )
    linear, _ = task.dynamics.linearize(motion)
    gains = backward_pass(linear, task.cost.expand(motion), 0.1).gains
    list(task.dynamics.follow_each(motion.states[0], [motion], gains))
    task.cost(motion.states[None, :-1], motion.controls[None])
    task.fallen(motion.states[None])
    assert [len(loop.signatures) for loop in loops] == before


def test_without_its_peer_a_benchmark_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setitem(suite.PEERS, "backward_pass", "a_package_that_nobody_has")
    with pytest.raises(SystemExit, match="a_package_that_nobody_has is compared with, but not"):
        suite.main(["backward_pass", "--output", str(tmp_path / "out")])
    assert not list(tmp_path.iterdir())
