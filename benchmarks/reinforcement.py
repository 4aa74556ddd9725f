# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Variational guided policy search against reinforcement learning, on the same task and cost."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from benchmarks.goals import Goal, Outcome, Stopwatch, cost_goal, walking_goal
from benchmarks.problems import SEED
from benchmarks.timing import Comparison
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all, prepare
from vgps_ros.tasks import Task, make_task

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
