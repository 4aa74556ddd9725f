# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Benchmark of plans over a receding horizon against judo's samplers, in closed loop.

Both drive the same MJCF to the same cost, in as much wall time: see `benchmarks.closed_loop`. Judo
needs an older MuJoCo, so it runs in an environment of its own, which `make bench` makes.
"""

import json
import os
import statistics
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.closed_loop import Drive, drive
from benchmarks.timing import Comparison
from vgps_ros.core.records import Array
from vgps_ros.search.mpc import MpcSettings, Planner
from vgps_ros.search.trajectory_optimization import prepare
from vgps_ros.simulation.model import sensor_numbers, state_names
from vgps_ros.tasks import Task, make_task
from vgps_ros.tasks.sampled_motion import FALLEN, Plans, SampledMotion, replan

ROOT = Path(__file__).resolve().parents[1]
PYTHON = ROOT / ".venv" / "judo" / "bin" / "python"  # see scripts/run_benchmarks.bash
ROBOTS = {"cart_pole": 1.0, "hopper": 4.0}  # wall time for the time of each robot
OPTIMIZERS = ("ps", "cem", "mppi")
SEEDS = 3


def sampling_peers() -> Iterator[Comparison]:
    """Cost in closed loop, after equal wall time, against the best of judo's samplers."""
    for robot, pace in ROBOTS.items():
        task = make_task(str(ROOT / "benchmarks" / "without_demonstration" / f"{robot}.yaml"))
        prepare(task)
        found: dict[str, list[tuple[float, bool]]] = {}
        for seed in range(SEEDS):
            for name, driven in _drives(task, pace, seed):
                up = bool(task.survived(driven.states[None])[0])
                cost = task.cost(driven.states[:-1], driven.controls).sum()
                found.setdefault(name, []).append((float(cost), up))
        costs = {name: statistics.median(cost for cost, _ in runs) for name, runs in found.items()}
        best = min(OPTIMIZERS, key=costs.__getitem__)
        shown = ", ".join(
            f"{name} {costs[name]:.4g} ({sum(up for _, up in runs)} of {len(runs)} stay up)"
            for name, runs in found.items()
        )
        for ours in ("mpc", "sampler"):
            yield Comparison(
                f"{robot}: cost in closed loop, {ours} / judo's best",
                costs[ours],
                costs[best],
                None,
                unit="",
                remark=shown,
            )


def _drives(task: Task, pace: float, seed: int) -> Iterator[tuple[str, Drive]]:
    """Yields the drives of all planners from one seed, ours and theirs, in turn."""
    began = time.perf_counter()
    mpc = _Mpc(task, seed)
    preparation = time.perf_counter() - began  # all others may plan as long before the first step
    period, steps = pace * task.dynamics.time_step, task.horizon
    yield "mpc", drive(_Robot(task), mpc, steps, period, 0.0)
    sampler = _Sampler(task, seed)
    yield "sampler", drive(_Robot(task), sampler, steps, period, preparation)
    shared = shared_problem(task) | {
        "preparation": preparation,
        "period": period,
        "steps": steps,
        "seed": seed,
    }
    for name in OPTIMIZERS:
        yield name, _judo(shared | {"optimizer": name})


@dataclass
class _Robot:
    """The robot, simulated."""

    task: Task
    state: Array = field(init=False)

    def __post_init__(self) -> None:
        self.state = self.task.initial_state

    def advance(self, control: Array) -> None:
        self.state = self.task.dynamics.step(self.state, control)


class _Mpc:
    """The plans of the node mpc: an iteration of DDP each, with feedback."""

    def __init__(self, task: Task, seed: int):
        horizon = _beginning(task).sampler.steps * task.dynamics.time_step
        self._planner = Planner(task, MpcSettings(horizon=horizon, ddp=task.optimizer.ddp))
        self._plan = self._planner.first_plan(seed)

    def plan(self, state: Array, step: int) -> Any:
        self._plan = plan = self._planner.next_plan(self._plan, state, step)
        last = plan.start + self._planner.steps - 1
        return lambda x, at: self._planner.control(plan, x, min(at, last))


class _Sampler:
    """The plans of `begin: {law: sampling}`: samples, and some iterations of DDP on the best."""

    def __init__(self, task: Task, seed: int):
        beginning = _beginning(task)
        self._sampler = beginning.sampler
        self._problem = Plans(task, beginning.ddp_iterations)
        self._rng = np.random.default_rng(seed)
        self._controls = np.zeros((self._sampler.steps, task.dynamics.control_dim))
        self._first = 0

    def plan(self, state: Array, step: int) -> Any:
        passed, first = step - self._first, step
        last = self._controls[-1:]
        begun = np.concatenate([self._controls[passed:], last.repeat(passed, axis=0)])
        self._controls = controls = replan(
            self._problem, self._sampler, begun[: self._sampler.steps], state, step, self._rng
        )
        self._first = first
        return lambda _, at: controls[min(at - first, len(controls) - 1)]


def shared_problem(task: Task) -> dict[str, Any]:
    """Returns a task as `benchmarks.judo_drive` reads it."""
    beginning = _beginning(task)
    return {
        "mjcf": task.mjcf,
        "start": task.initial_state.tolist(),
        "substeps": task.dynamics.substeps,
        "time_step": task.dynamics.time_step,
        "plan": beginning.sampler.steps * task.dynamics.time_step,
        "nodes": beginning.sampler.knots,
        "samples": beginning.sampler.samples,
        "readings": _places(task, task.cost.features),
        "targets": task.cost.targets.tolist(),
        "weights": task.cost.weights.tolist(),
        "controls": task.cost.control_weights.tolist(),
        "fallen": _places(task, task.fallen.readings),
        "lowest": task.fallen.lowest.tolist(),
        "highest": task.fallen.highest.tolist(),
        "penalty": FALLEN,
    }


def _judo(problem: dict[str, Any]) -> Drive:
    """Drives by one of judo's optimizers, in a process of its own."""
    done = subprocess.run(
        [str(PYTHON), "-m", "benchmarks.judo_drive"],
        input=json.dumps(problem),
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"judo ended with {done.returncode}:\n{done.stderr[-2000:]}")
    answer = json.loads(done.stdout)
    return Drive(np.array(answer["states"]), np.array(answer["controls"]), answer["plans"])


def _beginning(task: Task) -> SampledMotion:
    """Returns the task's settings of samples, which all planners share."""
    assert isinstance(task.begin, SampledMotion)
    return task.begin


def _places(task: Task, readings: Any) -> list[tuple[str, int]]:
    """Returns where MuJoCo has each reading: among the sensors' numbers, or in the state."""
    model = task.dynamics.model
    numbers, states = sensor_numbers(model), state_names(model)
    return [
        ("sensor", numbers[name][1]) if name in numbers else ("state", states.index(name))
        for name in readings.names
    ]
