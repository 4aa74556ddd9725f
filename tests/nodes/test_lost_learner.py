# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A training whose learner dies or hangs: it goes on, and not one bit is different."""

import json
import signal
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from vgps_msgs.msg import GaussianPolicy, LearningProgress

from tests.nodes.test_training import (
    SHORT,
    parameters,
    start_training,
    train_in_process,
    without_times,
)
from vgps_ros.ros_runtime.qos import LATCHED
from vgps_ros.search.checkpoints import Run
from vgps_ros.search.settings import search_settings
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

ROTOR = make_task("rotor")
SETTINGS = replace(
    search_settings(ROTOR),
    iterations=40,
    hidden_units=SHORT.hidden_units,
    initial_ddp_iterations=3,
    evaluation_rollouts=2,
)
PARAMETERS = {"task": "rotor", **parameters(SETTINGS)}
SEED = 7


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The entries of result.json, and the bytes of policy.json."""
    iterations = train_in_process(ROTOR, SETTINGS, SEED)
    path = tmp_path_factory.mktemp("expected") / "policy.json"
    save_policy(iterations[-1].policy, "rotor", path)
    return without_times([i.entry() for i in iterations]), path.read_bytes()


class Training:
    """A training that is some iterations old."""

    def __init__(self, graph, folder, *, keeps=True, **optimizer):
        self.graph = graph
        self.folder = folder
        self.options = {**PARAMETERS, "checkpoint_folder": folder / "kept" if keeps else "''"}
        self.optimizer = graph.start("trajectory_optimizer", task="rotor", **optimizer)
        self.progress = graph.messages(LearningProgress, "learning_progress")
        self.policies = graph.messages(GaussianPolicy, "policy", LATCHED)
        self.start_learner()
        self.program = start_training(graph, SETTINGS, SEED, folder / "out")
        self.wait_for_iterations(5)

    def start_learner(self):
        self.learner = self.graph.start("policy_learner", **self.options)

    def wait_for_iterations(self, count):
        begin = len(self.progress)
        self.graph.spin_until(lambda: len(self.progress) >= begin + count, 120, "iterations")

    def outcome(self):
        graph, program = self.graph, self.program
        graph.ends(program)
        result = json.loads((self.folder / "out" / "result.json").read_text())
        return without_times(result["iterations"]), (
            self.folder / "out" / "policy.json"
        ).read_bytes()


@pytest.mark.slow
def test_a_training_outlives_the_program_that_asked_for_it(graph, tmp_path, expected):
    training = Training(graph, tmp_path)
    training.program.kill()
    refused = start_training(graph, SETTINGS, SEED, tmp_path / "out")
    assert refused.wait() == 1
    assert "busy" in refused.output
    graph.spin_until(lambda: training.progress[-1].iteration == SETTINGS.iterations, 120)
    begin = len(training.progress)
    training.program = start_training(graph, SETTINGS, SEED, tmp_path / "out")
    assert training.outcome() == expected
    assert len(training.progress) <= begin + 1  # from the checkpoints, not learned again


@pytest.mark.slow
def test_one_that_is_killed_goes_on_where_it_was(graph, tmp_path, expected):
    training = Training(graph, tmp_path)
    for _ in range(2):
        training.learner.kill()
        graph.spin_for(0.5)  # for what is still on its way
        before = training.progress[-1].iteration
        training.policies.clear()
        seen = len(training.progress)
        training.start_learner()
        training.wait_for_iterations(1)
        first = training.progress[seen].iteration
        assert first >= before
        graph.spin_until(lambda: training.policies, what="the last policy")
        assert training.policies[0].iteration == first  # at once, so that an executor has one
        assert f"Going on from iteration {first} of 40." in training.learner.output
        training.wait_for_iterations(3)
    assert training.outcome() == expected
    assert training.program.output.count("does not know the goal any more") == 2


@pytest.mark.slow
def test_one_that_keeps_nothing_begins_anew(graph, tmp_path, expected):
    training = Training(graph, tmp_path, keeps=False)
    training.learner.kill()
    training.start_learner()
    assert training.outcome() == expected
    assert [p.iteration for p in training.progress].count(1) == 2
    assert not (tmp_path / "kept").exists()


@pytest.mark.slow
def test_one_that_is_missed_is_waited_for_and_one_that_hangs_goes_on(graph, tmp_path, expected):
    training = Training(graph, tmp_path)
    training.learner.send(signal.SIGSTOP)
    graph.spin_until_output(training.program, "/policy_learner has ended, was killed, or hangs")
    graph.spin_for(1.0)
    training.learner.send(signal.SIGCONT)
    training.wait_for_iterations(3)
    assert "does not know the goal" not in training.program.output
    training.learner.kill()
    graph.spin_for(5.0)
    assert training.program.running
    training.start_learner()
    assert training.outcome() == expected


@pytest.mark.slow
def test_one_whose_optimizer_comes_back_with_other_settings_is_refused(graph, tmp_path):
    training = Training(graph, tmp_path, policy_samples=1)
    training.learner.kill()
    training.optimizer.kill()
    graph.start("trajectory_optimizer", task="rotor")
    training.start_learner()
    assert training.program.wait() == 1
    assert "Going on from iteration" in training.learner.output
    assert (
        "A trajectory optimizer solves with policy_samples 10, but the training was begun with "
        "policy_samples 1: start it with these values, or name another folder"
    ) in training.program.output


@pytest.mark.slow
def test_without_another_learner_the_program_gives_up_in_time(graph, tmp_path):
    graph.start("trajectory_optimizer", task="rotor")
    learner = graph.start("policy_learner", **PARAMETERS)
    iterations = graph.messages(LearningProgress, "learning_progress")
    program = graph.start_program(
        "train_through_graph",
        *("--iterations", "10000", "--output", str(tmp_path / "out"), "--lost-timeout", "1"),
    )
    graph.spin_until(lambda: iterations, what="an iteration")
    learner.kill()
    assert program.wait() == 1
    assert "There was no policy_learner for 1 s; start one, and give this command" in program.output


@pytest.mark.slow
def test_the_same_goal_again_is_answered_from_what_is_kept(graph, tmp_path, expected):
    training = Training(graph, tmp_path)
    assert training.outcome() == expected
    count = len(training.progress)
    training.program = start_training(graph, SETTINGS, SEED, tmp_path / "out", "--overwrite")
    assert training.outcome() == expected
    graph.spin_until(lambda: len(training.progress) > count, what="the last iteration")
    assert [p.iteration for p in training.progress[count:]] == [40]
    training.program = start_training(graph, SETTINGS, SEED + 1, tmp_path / "other")
    training.wait_for_iterations(1)
    assert training.program.wait() == 0
    assert len(list((tmp_path / "kept").iterdir())) == 2  # each training has a folder


@pytest.mark.slow
def test_a_full_disk_is_an_error_and_the_training_goes_on(graph, tmp_path, expected):
    folder = tmp_path / "kept" / Run("vgps", ROTOR, SETTINGS, SEED).name()
    folder.mkdir(parents=True)
    (folder / "checkpoint-0.npz.part").symlink_to("/dev/full")
    graph.start("trajectory_optimizer", task="rotor")
    graph.start("policy_learner", checkpoint_folder=tmp_path / "kept", **PARAMETERS)
    program = start_training(graph, SETTINGS, SEED, tmp_path / "out")
    status = graph.diagnosis("policy_learner", DiagnosticStatus.ERROR, "no checkpoint can be")
    assert f"'{folder}' (No space left on device): make room" in status.message
    graph.diagnosis("policy_learner", DiagnosticStatus.OK)  # it is there again
    assert program.wait() == 0
    entries = json.loads((tmp_path / "out" / "result.json").read_text())["iterations"]
    assert without_times(entries) == expected[0]
