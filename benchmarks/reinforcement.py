# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Variational guided policy search against reinforcement learning, on the same task and cost."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.problems import SEED, optimize
from benchmarks.timing import Comparison
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all, prepare
from vgps_ros.simulation.dynamics import ControlLaw
from vgps_ros.tasks import Task, make_task

_DDP_ITERATIONS = 200
_COST_FACTOR = 1.05  # that the swimmer's policy may cost more than DDP's solution
_WALKING_TIME = 10.0  # [s]
_WALKING_SPEED = 0.5  # below it the walker stands rather than walks, mean [m/s]


@dataclass(frozen=True)
class Goal:
    """A figure of the rollout from x_1 without noise, which must not exceed a bound.

    Attributes:
        name: what it is to reach it.
        horizon: steps of the rollout.
        figure: of a rollout; less is better.
        bound: what it must not exceed.
    """

    name: str
    horizon: int
    figure: Callable[[Trajectory], float]
    bound: float

    def measure(self, task: Task, control_law: ControlLaw) -> float:
        """Returns the figure of a policy; inf where its rollout diverges."""
        rollout = task.dynamics.rollout(task.initial_state, control_law, self.horizon)
        return self.figure(rollout) if np.isfinite(rollout.states).all() else float("inf")


def cost_goal(task: Task) -> Goal:
    """As good as DDP: the task's cost, at most 5 % above that of its 200th iteration."""
    bound = _COST_FACTOR * optimize(task, _DDP_ITERATIONS).cost
    return Goal("a cost 5 % above DDP's", task.horizon, task.trajectory_cost, bound)


def walking_goal(task: Task) -> Goal:
    """Ten seconds of walking: seconds that it lacks until a fall, or until it is fast enough."""
    horizon = round(_WALKING_TIME / task.dynamics.time_step)

    def lacking(rollout: Trajectory) -> float:
        fallen = task.fallen(rollout.states)
        steps = int(fallen.argmax()) if fallen.any() else horizon
        distance = float(task.distance(rollout.states[0], rollout.states[steps]))
        return _WALKING_TIME - min(steps * task.dynamics.time_step, distance / _WALKING_SPEED)

    return Goal("ten seconds of walking", horizon, lacking, 1e-9)


@dataclass(frozen=True)
class Outcome:
    """How a learner has fared.

    Attributes:
        reached: whether it came to the goal.
        seconds: wall time until then, or until it was given up, without the looks at it.
        simulator_steps: simulator steps done meanwhile, those of finite differences included.
        policy_steps: those of them that an unfinished policy drove.
        best: the best figure seen.
        curve: simulator steps and the figure at each look.
    """

    reached: bool
    seconds: float
    simulator_steps: int
    policy_steps: int
    best: float
    curve: tuple[tuple[int, float], ...] = ()


class Stopwatch:
    """Wall time, less that of the looks."""

    def __init__(self) -> None:
        self._began = time.perf_counter()

    @property
    def seconds(self) -> float:
        """What has passed [s]."""
        return time.perf_counter() - self._began

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Leaves out what passes meanwhile."""
        before = self.seconds
        yield
        self._began = time.perf_counter() - before


# Task: the goal, the hidden units of our policy, and what our time must not exceed of the better
# peer's.
RACES: dict[str, tuple[Callable[[Task], Goal], int, float]] = {
    "swimmer": (cost_goal, 5, 0.1),
    "walker": (walking_goal, 10, 0.05),
}
PATIENCE = 20.0  # times our own, after which a peer is given up


def reinforcement_learning() -> Iterator[Comparison]:
    """Wall time and steps to a goal against PPO and SAC of Stable-Baselines3; long."""
    from benchmarks import stable_baselines as peers

    for name, (make_goal, units, target) in RACES.items():
        watch = Stopwatch()
        task = make_task(name)  # with the walker's demonstration
        with watch.stopped():
            goal = make_goal(task)
            prepare(task)
        ours = learn(task, goal, units, watch)
        outcomes = []
        for algorithm in peers.ZOO:
            for hidden_units in (None, units):
                peer = peers.learn(
                    algorithm, task, goal, hidden_units, limit=PATIENCE * ours.seconds
                )
                outcomes.append(peer)
                network = f"{units} soft rectifiers" if hidden_units else "its own network"
                yield _row(f"{name}: to {goal.name} / {algorithm.__name__}, {network}", ours, peer)
        better = min(outcomes, key=lambda o: (0, o.seconds) if o.reached else (1, o.best))
        yield replace(
            _row(f"{name}: to {goal.name} / the better peer", ours, better), target=target
        )


def learn(task: Task, goal: Goal, hidden_units: int, watch: Stopwatch) -> Outcome:
    """Runs our search until its policy reaches the goal, for all its iterations at most."""
    settings = replace(search_settings(task), hidden_units=(hidden_units,), evaluation_rollouts=1)
    best, steps = float("inf"), 0
    for iteration in search("vgps", task, settings, SEED, partial(optimize_all, task)):
        steps = iteration.history[-1].simulator_steps
        with watch.stopped():
            best = min(best, goal.measure(task, partial(_mean, task, iteration.policy)))
        if best <= goal.bound:
            break
    return Outcome(best <= goal.bound, watch.seconds, steps, 0, best)


def _mean(task: Task, policy: GaussianPolicy, _: int, states: Array) -> Array:
    return policy.mean(task.observation(states))


def _row(name: str, ours: Outcome, peer: Outcome) -> Comparison:
    return Comparison(
        name,
        1e3 * ours.seconds,
        1e3 * peer.seconds,
        None,
        remark=f"ours {_words(ours)}; the peer {_words(peer)}",
    )


def _words(outcome: Outcome) -> str:
    reached = "there" if outcome.reached else f"NOT there, best {outcome.best:.4g},"
    return (
        f"{reached} after {outcome.simulator_steps:.3g} simulator steps, "
        f"{outcome.policy_steps:.3g} of them under an unfinished policy"
    )
