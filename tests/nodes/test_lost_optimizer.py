# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A training whose optimizer dies or hangs: said, waited for, and not one bit is different."""

import signal
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from vgps_msgs.msg import OptimizerIteration

from tests.nodes.conftest import EACH_SIGNAL
from tests.nodes.test_training import SHORT, parameters, same_bits, start_training, train_in_process
from vgps_ros.storage.run_folder import load_policy

# More solver iterations in the first solve, so that there is time to strike in the middle of it.
SETTINGS = {**parameters(SHORT), "initial_ddp_iterations": 40}
MISSED = "Waiting for the service of trajectory_optimizer"


@pytest.fixture(scope="module")
def expected(swimmer):
    return train_in_process(swimmer, replace(SHORT, initial_ddp_iterations=40), 7)[-1].policy


@pytest.fixture(scope="module")
def learner(shared_graph):
    """A learner that the trainings of this file have in common, one after another."""
    learner = shared_graph.start("policy_learner", **SETTINGS)
    shared_graph.diagnosis("policy_learner", DiagnosticStatus.OK, "Running")
    return learner


class Training:
    """A training in which one solve is under way."""

    def __init__(self, graph, learner, folder):
        self.graph, self.learner, self.folder = graph, learner, folder
        self._said = len(learner.output)
        self.solver = graph.messages(OptimizerIteration, "trajectory_optimizer/iterations")
        self.start_optimizer()
        self.program = start_training(graph, SHORT, 7, folder / "out")
        graph.spin_until(lambda: len(self.solver) >= 2, what="a solve")

    def start_optimizer(self):
        self.optimizer = self.graph.start("trajectory_optimizer")

    def loses_a_solve(self):
        """Whether the learner has said so in this training."""
        return "is lost with a solve, which is done again" in self.learner.output[self._said :]

    def end(self):
        self.graph.ends(self.program)
        return load_policy(self.folder / "out" / "policy.json")[0]


@pytest.fixture
def training(shared_graph, learner, tmp_path):
    training = Training(shared_graph, learner, tmp_path)
    yield training
    if training.program.running:  # the test has failed
        training.program.end()
    assert training.optimizer.end() == 0


@pytest.mark.slow
def test_one_that_is_killed_and_back_at_once_is_asked_again(training, expected):
    training.optimizer.kill()
    training.start_optimizer()
    assert same_bits(training.end(), expected)
    assert training.loses_a_solve()


@EACH_SIGNAL
def test_one_that_is_ended_in_a_solve_hands_it_back(shared_graph, training, expected, number):
    assert training.optimizer.end(number) == 0
    shared_graph.spin_until(training.loses_a_solve, what="the learner to miss it")
    training.start_optimizer()
    assert same_bits(training.end(), expected)


def test_one_that_is_killed_is_missed_and_waited_for(shared_graph, training, expected):
    training.optimizer.kill()
    shared_graph.diagnosis("policy_learner", DiagnosticStatus.OK, MISSED)
    shared_graph.spin_for(1.0)
    assert training.program.running
    training.start_optimizer()
    assert same_bits(training.end(), expected)
    shared_graph.diagnosis("policy_learner", DiagnosticStatus.OK)


@pytest.mark.slow
def test_one_that_hangs_is_missed_and_goes_on(shared_graph, training, expected):
    training.optimizer.send(signal.SIGSTOP)
    try:
        shared_graph.diagnosis("policy_learner", DiagnosticStatus.OK, MISSED)
    finally:
        training.optimizer.send(signal.SIGCONT)
    assert same_bits(training.end(), expected)


@pytest.mark.slow
def test_a_learner_that_was_stopped_itself_goes_on(shared_graph, training, expected):
    training.learner.send(signal.SIGSTOP)
    shared_graph.spin_for(6.0)
    training.learner.send(signal.SIGCONT)
    assert same_bits(training.end(), expected)


@pytest.mark.slow
def test_a_training_without_an_optimizer_fails_when_a_parameter_says_so(graph, tmp_path):
    graph.start("policy_learner", optimizer_timeout=1.0, **SETTINGS)
    program = start_training(graph, SHORT, 7, tmp_path / "out")
    assert program.wait() == 1
    assert "No optimizer was there for 1 s; start the service of" in program.output
