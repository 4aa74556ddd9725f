# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import json
from pathlib import Path

import pytest
import yaml

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import settings_of
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.programs.command_line import with_parameters_of
from vgps_ros.search.settings import SearchSettings, search_settings
from vgps_ros.tasks import make_task

FILE = """
policy_learner:
  ros__parameters:
    iterations: 2
    hidden_units: [3]
    alphas: [2.0, 1.0]
    optimizers: [trajectory_optimizer]
    fit:
      samples_per_step: 4
trajectory_optimizer:
  ros__parameters:
    marginals:
      initial_std_factor: 2.0
"""


def main(arguments):
    vgps(["train", *arguments])


def test_a_block_replaces_settings_nested_ones_too_and_leaves_the_nodes_own_parameters(tmp_path):
    path = tmp_path / "parameters.yaml"
    path.write_text(FILE)
    found = with_parameters_of(SearchSettings(), "policy_learner", path)
    assert (found.iterations, found.hidden_units, found.alphas) == (2, (3,), (2.0, 1.0))
    assert found.fit.samples_per_step == 4
    assert found.alpha_iterations == SearchSettings().alpha_iterations
    assert with_parameters_of(SearchSettings(), "recorder", path) == SearchSettings()
    path.write_text(FILE + "/**: {ros__parameters: {hidden_units: [2], evaluation_rollouts: 3}}")
    found = with_parameters_of(SearchSettings(), "policy_learner", path)
    assert (found.hidden_units, found.evaluation_rollouts) == ((3,), 3)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("- a list", "is no parameter file"),
        ("policy_learner: {iterations: 3}", "is no parameter file"),
        ("policy_learner: [", "is no parameter file"),
        ("\x00", "is no parameter file"),
        ("[" * 10_000 + "]" * 10_000, "is no parameter file"),
        ("{a: " * 10_000 + "1" + "}" * 10_000, "is no parameter file"),
        ("policy_learner: {ros__parameters: {hidden_units: []}}", "hidden_units is empty"),
        ("policy_learner: {ros__parameters: {iterations: 0}}", "iterations is 0"),
        ("policy_learner: {ros__parameters: {iterations: soon}}", "iterations is 'soon'"),
        ("policy_learner: {ros__parameters: {hidden_units: 5}}", "hidden_units is 5"),
        ("policy_learner: {ros__parameters: {alfas: [1.0]}}", "'alfas', .* Did you mean 'alphas'"),
        ("policy_lerner: {ros__parameters: {}}", "'policy_lerner', .* mean 'policy_learner'"),
    ],
)
def test_a_file_of_another_form_or_a_wrong_value_is_refused(tmp_path, content, sentence):
    path = tmp_path / "parameters.yaml"
    path.write_text(content)
    with pytest.raises(InvalidInputError, match=sentence):
        with_parameters_of(SearchSettings(), "policy_learner", path)


def test_train_takes_the_graphs_file_and_a_flag_goes_before_it(tmp_path, capsys):
    path = tmp_path / "parameters.yaml"
    path.write_text(FILE)

    def train(name, *flags):
        arguments = ["--task", "rotor", "--evaluation-rollouts", "2", "--output"]
        main([*arguments, str(tmp_path / name), *flags])
        return json.loads((tmp_path / name / "result.json").read_text())

    file, flags = ["--params-file", str(path)], ["--marginals-initial-std-factor", "1.0"]
    widened, narrow = train("widened", *file), train("narrow", *file, *flags)
    assert len(widened["iterations"]) == len(narrow["iterations"]) == 2
    assert widened["hidden_units"] == [3]
    assert widened["iterations"][0]["alpha"] > 1.4
    costs = [r["iterations"][-1]["deterministic_cost"] for r in (widened, narrow)]
    assert costs[0] != costs[1]  # the optimizer's block was heard, and the flag


@pytest.mark.parametrize("name", ["swimmer", "walker"])
def test_a_tasks_own_file_repeats_what_the_task_names(name):
    path = Path(__file__).parents[2] / "config" / f"{name}.yaml"
    record = search_settings(make_task(name))
    assert with_parameters_of(record, "policy_learner", path) == record


def test_each_line_of_the_five_unit_walkers_file_changes_a_setting():
    path = Path(__file__).parents[2] / "config" / "walker" / "five_units.yaml"
    (block,) = yaml.safe_load(path.read_text()).values()
    record = search_settings(make_task("walker"))
    before = settings_of(record)
    after = settings_of(with_parameters_of(record, "policy_learner", path))
    changed = sum(a.default != b.default for a, b in zip(before, after, strict=True))
    assert changed == len(block["ros__parameters"])


def test_train_refuses_a_file_that_is_not_there(tmp_path):
    with pytest.raises(SystemExit, match=r"none\.yaml' cannot be read .*; name a parameter file"):
        main(["--params-file", str(tmp_path / "none.yaml"), "--output", str(tmp_path / "run")])
