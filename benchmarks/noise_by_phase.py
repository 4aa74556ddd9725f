# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Does one noise for all states keep the acrobot from standing? An experiment, not a feature.

A policy's σ pools what its fit leaves of the swing-up with what it leaves at the top. So one M-step
learns from both: from the first q(ζ) of a run, which swings, and from q(ζ) of starts at the top,
each of which stands. By phase it then has

    σ² = E[(μ_θ − μ_q)² + Σ_q],

and is executed from other starts at the top without noise, with its own σ, and with that of the
phase which it is in. At the top both links are within .32 rad, of q its mean. Each seed is that of
the fit and of all draws; α is the task's last one unless told.

    vgps new recordings/acrobot --model package://dm_control/suite/acrobot.xml
    vgps train --task recordings/acrobot --seed 9921 --output recordings/acrobot-9921
    python -m benchmarks.noise_by_phase recordings/acrobot-9921 --seeds 9932 9933 9934
"""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.policy_fit import draw_targets
from vgps_ros.core.records import Array, Trajectory, TrajectoryDistribution
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import OptimizationResult, optimize, optimize_all
from vgps_ros.search.workspace import Workspace
from vgps_ros.simulation.warnings import silence_mujoco
from vgps_ros.storage.run_folder import RunFolder, load_distributions, load_policy
from vgps_ros.tasks import Task, recorded_task
from vgps_ros.tasks.task import Nominal

STANDING, ROLLOUTS, SAMPLES, SECONDS = 4, 40, 20, 8.0
UPRIGHT = 0.95  # cosine of each link's angle to the vertical
SPREAD = 0.002 * np.array([1.0, 1.0, 10.0, 10.0])  # of starts at the top [rad, rad/s]


def is_up(states: Array) -> NDArray[np.bool_]:
    """Returns whether both links are near the vertical in states (..., 4)."""
    shoulder, elbow = states[..., 0], states[..., 1]
    return np.minimum(np.cos(shoulder), np.cos(shoulder + elbow)) > UPRIGHT


def standing(task: Task, starts: Array, alpha: float) -> list[OptimizationResult]:
    """Returns what DDP makes of the feedback that holds the robot at the top, from each start."""
    horizon, usual = task.planned_horizon, replace(first_request(task, 0, 60), cost_scale=alpha)
    still = Trajectory(np.zeros((horizon + 1, 4)), np.zeros((horizon, task.dynamics.control_dim)))

    def solve(start: Array, motion: Trajectory) -> OptimizationResult:
        situation = replace(usual.situation, initial_state=start)
        return optimize(task, replace(usual, situation=situation), start=Nominal(motion))

    law = solve(np.zeros(4), still).distribution.gains
    motions = [next(iter(task.dynamics.follow_each(start, [still], law))) for start in starts]
    return [solve(*pair) for pair in zip(starts, motions, strict=True)]


def noise_by_phase(
    policy: GaussianPolicy, task: Task, taught: list[TrajectoryDistribution], seed: int
) -> Array:
    """Prints what the fit leaves in each phase; returns σ in the swing and at the top [N·m]."""
    targets = draw_targets(taught, task.observation, SAMPLES, generator(seed, Stream.EVALUATION))
    top = np.concatenate([np.tile(is_up(q.mean.states[: q.mean.horizon]), SAMPLES) for q in taught])
    squares, found = (policy.mean(targets.inputs) - targets.means)[:, 0] ** 2, []
    for name, chosen in (("swing", ~top), ("top", top)):
        residual, spread = squares[chosen].mean(), targets.variances[chosen, 0].mean()
        found.append(np.sqrt(residual + spread))
        print(
            f"  {name}: {chosen.mean():.0%} of the samples, residual {np.sqrt(residual):.3f}, of q "
            f"{np.sqrt(spread):.3f}, so σ {found[-1]:.3f}; its own {policy.noise_std[0]:.3f}"
        )
    return np.array(found)


def up_in_rollouts(task: Task, policy: GaussianPolicy, noise: Array, seed: int) -> Array:
    """Returns whether the robot is up in each step, (N, T), with noise of two phases [N·m]."""
    rng, steps = generator(seed, Stream.EVALUATION), round(SECONDS / task.dynamics.time_step)
    states = SPREAD * rng.standard_normal((ROLLOUTS, 4))
    up = np.zeros((ROLLOUTS, steps), bool)
    for t in range(steps):
        up[:, t] = is_up(states)
        drawn = noise[up[:, t].astype(int)] * rng.standard_normal(ROLLOUTS)
        after, _ = task.dynamics.execute(policy, task.observation, states, drawn[:, None, None])
        states = after[:, 1]
    return up


def main() -> None:
    """Prints what each seed does."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", required=True)
    parser.add_argument("--hidden-units", type=int, nargs="+", default=[32])
    parser.add_argument("--alpha", type=float, default=3.0, help="of the solves at the top")
    given = parser.parse_args()
    silence_mujoco()
    task = recorded_task(load_policy(RunFolder(given.run).policy)[1])
    settings = replace(search_settings(task), hidden_units=tuple(given.hidden_units))
    swing = load_distributions(RunFolder(given.run).distribution)[0][0]
    for seed in given.seeds:
        rng = generator(seed, Stream.INITIAL_STATES)
        starts = SPREAD * rng.standard_normal((STANDING, 4))
        solved = tuple(standing(task, starts, given.alpha))
        kept = np.mean([is_up(s.distribution.mean.states).mean() for s in solved])
        work = Workspace(task, settings, seed, partial(optimize_all, task), solved)
        taught = [swing, *work.taught(solved)]
        law, fresh = solved[0].distribution.gains, generator(seed, Stream.EVALUATION)
        still = Trajectory(np.zeros((len(law) + 1, 4)), np.zeros((len(law), 1)))
        tried = SPREAD * fresh.standard_normal((ROLLOUTS, 4))
        held = [next(iter(task.dynamics.follow_each(x, [still], law))).states[-1] for x in tried]
        print(f"seed {seed}, alpha {given.alpha:g}: DDP's own motions are up in {kept:.0%}")
        print(f"  feedback of the first: {is_up(np.array(held)).mean():.0%} stand after 8 s")
        policy = work.supervised_policy(taught)
        by_phase = noise_by_phase(policy, task, taught, seed)
        noises = {"no noise": np.zeros(2), "pooled": policy.noise_std.repeat(2)}
        for kind, noise in (noises | {"by phase": by_phase}).items():
            up = up_in_rollouts(task, policy, noise, seed)
            print(f"  {kind}: {up[:, -1].mean():.0%} stand after 8 s, up in {up.mean():.0%} of it")


if __name__ == "__main__":
    main()
