# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A short training makes a controller of the quadruped: it stays up, and does what it is told."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from PIL import Image

from tests.nodes.conftest import PATIENCE, graph  # noqa: F401
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.bags.run_reader import read_run
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.settings import with_values
from vgps_ros.search.methods import search
from vgps_ros.search.settings import search_settings
from vgps_ros.search.solver_processes import SolverProcesses
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import Task, make_task

STEPS = 500  # 10 s
# Nothing commanded; ahead, fast ahead, back; left; turning; both.
COMMANDS = (
    (0.0, 0.0, 0.0),
    (0.4, 0.0, 0.0),
    (0.8, 0.0, 0.0),
    (-0.3, 0.0, 0.0),
    (0.0, 0.2, 0.0),
    (0.0, 0.0, 0.6),
    (0.4, 0.0, -0.5),
)
STARTS = 4  # for each of them

SHORT = {
    "iterations": 6,
    "situations": 16,
    "initial_ddp_iterations": 15,
    "renew.share": 0.0,
    # So few iterations follow an α that ends lower more closely, and learn no latency yet.
    "alphas": (0.4, 0.8),
    "fit.late": 0.0,
    # Nothing is replayed, so each situation has more samples.
    "fit.samples_per_step": 8,
}


def judged(task: Task, policy: GaussianPolicy) -> tuple[float, np.ndarray]:
    """Returns the share of the rollouts that stay up, and the rms error of each command then."""
    rng, told = np.random.default_rng(7), np.repeat(np.array(COMMANDS), STARTS, axis=0)
    space = task.dynamics.space
    spread = task.initial_std * rng.standard_normal((len(told), space.tangent_dim))
    contexts = np.array([task.signals.constant_context(each, STEPS) for each in told])
    silent = np.zeros((len(told), STEPS, task.dynamics.control_dim))
    states, controls = task.dynamics.execute(
        policy, task.observation.within(contexts), space.add(task.initial_state, spread), silent
    )
    up = task.survived(states)
    if not up.any():
        return 0.0, np.full(3, np.inf)
    names = task.cost.features.names
    columns = [names.index(name) for name in ("velocity/x", "velocity/y", "turning/z")]
    late = slice(STEPS // 2, STEPS)
    done = task.cost.features(states[up, :-1][:, late], controls[up][:, late])[..., columns]
    errors = done.mean(axis=1) - told[up]
    return float(up.mean()), np.sqrt((errors**2).mean(axis=0))


@pytest.fixture(scope="module")
def policy():
    """What a short training learns."""
    task = make_task("quadruped")
    settings = with_values(search_settings(task), SHORT)
    with SolverProcesses(partial(make_task, "quadruped")) as solvers:
        *_, last = search("vgps", task, settings, 0, solvers.optimize_all)
    return last.policy


def test_a_short_training_makes_a_controller_of_the_quadruped(policy):
    task = make_task("quadruped")
    up, errors = judged(task, policy)
    # Seeds 0 and 1 stayed up at all commands, with errors of at most 0.029, 0.008 and 0.011.
    assert up >= 0.95
    assert (errors < 0.08).all(), errors
    idle = replace(policy, parameters=np.zeros_like(policy.parameters))
    assert judged(task, idle)[0] == 0.0


@pytest.mark.slow
def test_it_drives_a_figure_of_eight_by_cmd_vel_and_the_bag_agrees(policy, graph, tmp_path):  # noqa: F811
    save_policy(policy, "quadruped", tmp_path / "policy.json")
    recorder = graph.start("recorder", output=tmp_path / "bag")
    patient = {"state_timeout": 60.0}  # the machine may be busy
    graph.start(
        "policy_executor", task="quadruped", policy_file=tmp_path / "policy.json", **patient
    )
    graph.diagnosis("policy_executor", None, "Waiting for imu and joint_states")
    graph.start("simulation", task="quadruped", start_paused=True, wait_timeout=PATIENCE)
    files = ("--json", str(tmp_path / "driven.json"), "--picture", str(tmp_path / "driven.png"))
    arguments = ("--task", "quadruped", "--course", "figure_of_eight", "--timeout", str(PATIENCE))
    program = graph.start("execute_policy", *arguments, *files)
    graph.ends(program)
    graph.spin_for(1.5)  # for the diagnostics
    assert recorder.end() == 0
    told = json.loads((tmp_path / "driven.json").read_text())
    for name in ("forward", "sideways", "turn"):
        assert told[f"rms_error_of_{name}"] < 0.2, told
    with Image.open(tmp_path / "driven.png") as picture:
        assert picture.width > picture.height > 400

    run = read_run(tmp_path / "bag").driven
    assert run.errors == {name: told[f"rms_error_of_{name}"] for name in run.errors}
    # The path asked is an eight from the dot on: a circle of 0.8 m on each side.
    low, high = run.asked_path.min(axis=0), run.asked_path.max(axis=0)
    np.testing.assert_allclose([*low[:2], *high[:2]], [-0.8, -1.6, 0.8, 1.6], atol=0.1)
    assert run.driven_path[:, 1].max() > 0.5
    assert run.driven_path[:, 1].min() < -0.5
    found = check_bag(tmp_path / "bag")
    assert not found.wrong, found.wrong
    assert any(words.endswith("contexts") for words in found.proved), found
