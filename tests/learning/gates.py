# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""How well a short training does its task, and the limits that it must keep.

A training is judged without its noise, from perturbed starts, against DDP solved on the same start
until it has converged. To measure a gate on other seeds, and to print what DDP converges to:

    python -m tests.learning.gates walker --seeds 2 3 4 5 6 7
"""

import argparse
import dataclasses
import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.settings import with_values
from vgps_ros.search.evaluation import evaluate
from vgps_ros.search.iteration import SearchIteration
from vgps_ros.search.methods import search
from vgps_ros.search.rollouts import Executions
from vgps_ros.search.settings import SearchSettings, search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.tasks import Task, make_task

ROLLOUTS = 20  # perturbed starts, in each situation


@dataclass(frozen=True)
class Gate:
    """A training that takes seconds, and how good its policy must be.

    Attributes:
        search: settings of the training that are not the task's own.
        horizon: length of the motion [s]; None: the task's own.
        ddp_iterations: number after which DDP lowers its cost no further, or hardly.
        converged: the cost that DDP then has, by seed, where finding it takes long; see the module.
        beyond: how many horizons the policy must go on for.
        cost: largest median cost over one horizon ÷ that of the converged DDP.
        cost_beyond: the same over `beyond` horizons, of which each counts as one of DDP's.
        survival: smallest share of the rollouts that stay up for `beyond` horizons.
    """

    search: Mapping[str, Any]
    horizon: float | None
    ddp_iterations: int
    beyond: int
    cost: float
    cost_beyond: float
    survival: float = 1.0
    converged: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Score:
    """What a policy reaches; see `Gate` for the figures."""

    cost: float
    cost_beyond: float
    survival: float

    def failures(self, gate: Gate) -> list[str]:
        """Returns a sentence for each figure that the gate does not let through."""
        sentences = []
        for name in ("cost", "cost_beyond"):
            value, limit = getattr(self, name), getattr(gate, name)
            if not value <= limit:
                sentences.append(f"{name} is {value:.3f}, but must be at most {limit:g}")
        if not self.survival >= gate.survival:
            sentences.append(
                f"survival is {self.survival:.2f}, but must be at least {gate.survival:g}"
            )
        return sentences


# Eight seeds, 0 to 7, were measured for each; the worst of them is named beside each limit.
GATES = {
    "swimmer": Gate(
        search={"iterations": 30, "initial_ddp_iterations": 40},
        horizon=5.0,
        ddp_iterations=300,
        converged={0: 83.482, 1: 83.358},
        beyond=2,
        cost=1.1,  # 1.01
        cost_beyond=2.2,  # 1.58
    ),
    "cart_pole": Gate(
        search={"iterations": 6, "initial_ddp_iterations": 40},
        horizon=None,
        ddp_iterations=200,
        converged={0: 118.029, 1: 118.029},
        beyond=3,
        cost=1.02,  # 1.002
        cost_beyond=0.36,  # 0.334
    ),
    "arm": Gate(
        search={"iterations": 8},
        horizon=None,
        ddp_iterations=200,
        converged={0: 87.158, 1: 136.33},
        beyond=3,
        cost=1.1,  # 1.016
        cost_beyond=4.0,  # 1.84
    ),
    "walker": Gate(
        search={"iterations": 20},
        horizon=None,
        ddp_iterations=200,
        converged={0: 45.008, 1: 45.008},
        beyond=3,
        cost=1.3,  # 1.153
        cost_beyond=1.3,  # 1.141
        survival=0.9,  # 1
    ),
    "hopper": Gate(
        search={"iterations": 14, "fit.samples_per_step": 15, "fit.iterations": 60},
        horizon=2.0,
        ddp_iterations=200,
        converged={0: 471.414, 1: 450.574},
        beyond=2,
        # Of seeds 0 to 3, measured anew; in brackets seed 3, which falls beyond the motion.
        cost=1.2,  # 1.089 (0.973)
        cost_beyond=1.3,  # 0.847 (3.438)
        survival=0.6,  # 0.95 (0.4)
    ),
}


def task_of(name: str) -> Task:
    """Returns the task of a gate, with its horizon."""
    task, seconds = make_task(name), GATES[name].horizon
    if seconds is None:
        return task
    horizon = round(seconds / task.dynamics.time_step)
    return dataclasses.replace(task, horizon=horizon)


def settings_of(name: str, task: Task) -> SearchSettings:
    """Returns the settings of a gate's training."""
    # The gates draw rollouts of their own.
    return with_values(search_settings(task), {"evaluation_rollouts": 1, **GATES[name].search})


def train(task: Task, settings: SearchSettings, seed: int) -> list[SearchIteration]:
    """Returns the iterations of a training in this process."""
    return list(search("vgps", task, settings, seed, partial(optimize_all, task)))


def converged_cost(name: str, seed: int, *, anew: bool = False) -> float:
    """Returns the cost of DDP from the training's first motion, a mean over its situations.

    The cost that the gate states is taken, if there is one and the solve is not asked for anew.
    """
    gate, task = GATES[name], task_of(name)
    if seed in gate.converged and not anew:
        return gate.converged[seed]
    settings = settings_of(name, task)
    settings = dataclasses.replace(
        settings,
        iterations=1,
        initial_ddp_iterations=gate.ddp_iterations,
        fit=dataclasses.replace(settings.fit, iterations=1),
    )
    return train(task, settings, seed)[-1].initial_ddp_cost


def score(
    name: str, task: Task, iteration: SearchIteration, policy: GaussianPolicy, converged: float
) -> Score:
    """Rolls a policy out without noise from perturbed starts of the training's situations."""
    gate = GATES[name]
    calm = dataclasses.replace(policy, noise_std=1e-9 * policy.noise_std)
    starts = [s.distribution.mean.states[0] for s in iteration.initial_solutions]

    def judged(horizons: int) -> tuple[float, float]:
        tasks = [
            dataclasses.replace(task, initial_state=start, horizon=horizons * task.horizon)
            for start in starts
        ]
        result = evaluate(tasks, calm, ROLLOUTS, Executions(1), 0)
        costs = result.stochastic_costs.reshape(len(starts), ROLLOUTS)
        mean_over_situations = np.median(costs, axis=1).mean()
        return mean_over_situations / (horizons * converged), result.stochastic_survived.mean()

    cost, _ = judged(1)
    cost_beyond, survival = judged(gate.beyond)
    return Score(cost, cost_beyond, survival)


def main() -> None:
    """Prints a line of JSON for each seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("robot", choices=GATES)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--search", type=json.loads, default={}, help="settings that replace some")
    parser.add_argument("--converged", type=float, help="a known cost of DDP, not to solve it")
    arguments = parser.parse_args()
    name, task = arguments.robot, task_of(arguments.robot)
    given = {k: tuple(v) if isinstance(v, list) else v for k, v in arguments.search.items()}
    for seed in arguments.seeds:
        began = time.process_time()
        converged = arguments.converged or converged_cost(name, seed, anew=True)
        solved = time.process_time()
        log = train(task, with_values(settings_of(name, task), given), seed)
        trained = time.process_time()
        scores = {
            "first": score(name, task, log[0], log[0].policy, converged),
            "last": score(name, task, log[-1], log[-1].policy, converged),
        }
        line = {
            "robot": name,
            "seed": seed,
            **arguments.search,
            "converged": round(converged, 3),
            **{
                key: {k: round(float(v), 3) for k, v in vars(value).items()}
                for key, value in scores.items()
            },
            "ddp_seconds": round(solved - began, 1),
            "training_seconds": round(trained - solved, 1),
            "judging_seconds": round(time.process_time() - trained, 1),
        }
        print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
