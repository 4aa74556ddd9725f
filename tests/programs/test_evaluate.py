# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `evaluate`: figures of known policies, and what it refuses."""

import json

import mujoco
import numpy as np
import pytest

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

ROLLOUTS = ["--seconds", "1", "--rollouts", "3", "--seed", "5"]


def rest(task):
    """A policy without torques and with little noise."""
    shape = Architecture(task.observation.names, (), task.dynamics.control_dim)
    return GaussianPolicy(shape, np.zeros(shape.num_parameters), np.ones(shape.control_dim))


@pytest.fixture
def evaluated(tmp_path, capsys):
    def run(name, *arguments):
        save_policy(rest(make_task(name)), name, tmp_path / "policy.json")
        output = tmp_path / "evaluation.json"
        flags = ["--json", str(output), "--overwrite", *ROLLOUTS, *arguments]
        vgps(["evaluate", str(tmp_path), *flags])
        table = capsys.readouterr().out
        assert ("survival" in table) == (name == "walker")
        assert "speed [m/s]" in table
        vgps(["evaluate", str(tmp_path / "policy.json"), *flags, "--json", "-"])
        result = json.loads(output.read_text())
        assert json.loads(capsys.readouterr().out) == result
        return result

    return run


def test_a_walker_without_torques_falls_before_the_second_is_over(evaluated):
    result = evaluated("walker", "--seconds", "2")
    assert result["survival"] == 0.0
    assert 0.2 < result["time"]["smallest"] <= result["time"]["largest"] < 2.0


def test_a_swimmer_at_rest_stays_and_its_steps_cost_1(evaluated):
    result = evaluated("swimmer", "--perturbation", "0")
    assert result["survival"] == 1.0
    assert result["distance"]["mean"] == 0.0
    assert result["cost_per_step"]["mean"] == pytest.approx(1.0)
    assert result["time"]["median"] == pytest.approx(1.0)


def test_an_arm_is_judged_by_how_far_from_its_target_it_ends(evaluated):
    task = make_task("arm")
    data = mujoco.MjData(task.dynamics.model)
    data.qpos[:] = task.initial_state[: task.dynamics.model.nq]
    mujoco.mj_forward(task.dynamics.model, data)
    misses = np.abs(data.site("hand").xpos - [0.45, 0.35, 0.45])
    result = evaluated("arm", "--perturbation", "0", "--seconds", "0.02")
    found = [result["misses"][f"hand/{axis}"]["largest"] for axis in "xyz"]
    np.testing.assert_allclose(found, misses, atol=1e-9)
    assert evaluated("swimmer")["misses"] == {}


def test_noise_and_perturbations_are_drawn_from_the_seed(evaluated):
    first, again, other = (evaluated("swimmer", "--stochastic", "--seed", s) for s in "778")
    assert first == again
    assert first["distance"] != other["distance"]
    assert evaluated("swimmer")["distance"]["smallest"] != 0.0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--seconds", "0"], "seconds is 0.0, but it must be from 0.001"),
        (["--seconds", "1e9"], "seconds is 1000000000.0, but it must be from 0.001 to 100000"),
        (["--rollouts", "0"], "rollouts is 0"),
        (["--rollouts", "1000000000"], "rollouts is 1000000000, but it must be from 1 to 1000000"),
        (["--rollouts", "1000000", "--seconds", "1e5"], "steps are too many"),
        (["--perturbation", "-1"], "perturbation is -1.0, but it must be from 0"),
        (["--pushes", "1", "--plot", "x.doc"], "'x.doc' has no ending of a picture; name a file"),
        (["--pushes", "1", "--plot", "x"], "that ends in one of .png, .svg, .pdf"),
        (["--json", "x.png", "--plot", "./x.png"], "'x.png' is named for two files, of which"),
        (["--task", "walker"], "has 2 controls, but the task has 6"),
    ],
)
def test_bad_input_is_refused_with_a_sentence(evaluated, arguments, sentence, capsys):
    with pytest.raises(SystemExit) as stop:
        evaluated("swimmer", *arguments)
    assert sentence in str(stop.value.code) + capsys.readouterr().err


def test_what_is_there_is_kept_and_a_result_is_not_taken_for_a_policy(evaluated, tmp_path):
    evaluated("swimmer")
    with pytest.raises(SystemExit, match=r"evaluation\.json' exists already"):
        vgps(["evaluate", str(tmp_path), "--json", str(tmp_path / "evaluation.json")])
    with pytest.raises(SystemExit, match=r"is not a policy .*name the policy\.json of a run"):
        vgps(["evaluate", str(tmp_path / "evaluation.json")])
