# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Learning without a model from robots that are only topics: as in process, bit for bit."""

import shutil
import signal
from itertools import pairwise
from pathlib import Path

import pytest
from sensor_msgs.msg import JointState
from vgps_msgs.msg import LearningProgress

import vgps_ros.tasks
from tests.nodes.conftest import EACH_SIGNAL
from tests.nodes.test_namespaces import OWN_TOPICS
from tests.nodes.test_training import checked, start_training, train_in_process
from vgps_ros.core.settings import with_values
from vgps_ros.messages.conversions import nanoseconds
from vgps_ros.search.settings import search_settings
from vgps_ros.tasks import make_task

ROBOTS = ("robot_1", "robot_2")
STEPS = 40
OWN = {
    "mirror.dynamics": "fitted",
    "mirror.exploration": (10.0,),
    "mirror.first_steps": 2,
    "policy_rollouts": 6,
    "evaluation_rollouts": 2,
    "supervised_iterations": 50,
}
SEED = 3


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The file of the swimmer's task over 0.8 s."""
    own, folder = Path(vgps_ros.tasks.__file__).parent / "swimmer", tmp_path_factory.mktemp("task")
    shutil.copy(own / "swimmer.xml", folder)
    text = (own / "task.yaml").read_text().replace("horizon: 10.0", f"horizon: {0.02 * STEPS}")
    (folder / "task.yaml").write_text(text)
    return folder / "task.yaml"


class Training:
    """A learner, and robots under namespaces."""

    def __init__(self, graph, task, robots, **settings):
        self.graph, self.task, own = graph, task, OWN | settings
        chosen = {"iterations": 2, "hidden_units": (4,), **own}
        self.settings = with_values(search_settings(make_task(str(task))), chosen)
        self.states = {name: graph.messages(JointState, f"/{name}/joint_states") for name in robots}
        self.progress = graph.messages(LearningProgress, "learning_progress")
        self.robots = {name: self.start_robot(name) for name in robots}
        values = {k: list(v) if isinstance(v, tuple) else v for k, v in own.items()}
        parameters = {k.replace(".", "__"): v for k, v in values.items() if k != "iterations"}
        self.learner = graph.start(
            "policy_learner",
            task=task,
            method="mdgps",
            rollout_robots=f"[{', '.join(robots)}]",
            rollout_timeout=10.0,
            checkpoint_folder=graph.folder / "kept",
            **parameters,
        )

    def start_robot(self, name):
        """Starts a robot, and waits until it tells its state."""
        self.states[name].clear()
        given = ("--ros-args", "-r", f"__ns:=/{name}", *OWN_TOPICS, "-p", f"task:={self.task}")
        robot = self.graph.start("simulation", *given)
        self.graph.spin_until(lambda: self.states[name], what=f"the state of {name}")
        return robot

    def start(self, folder):
        return start_training(self.graph, self.settings, SEED, folder)

    def in_process(self):
        return train_in_process(make_task(str(self.task)), self.settings, SEED, "mdgps")

    def steps(self, name):
        """Returns how many control steps a robot has done that the test has seen."""
        stamps = [nanoseconds(message.header.stamp) for message in self.states[name]]
        return sum(after > before for before, after in pairwise(stamps))

    def await_iteration(self, k):
        is_there = lambda: self.progress and self.progress[-1].iteration >= k  # noqa: E731
        self.graph.spin_until(is_there, what=f"iteration {k}")


@pytest.mark.parametrize(
    ("objective", "count"), [pytest.param("average", 1, marks=pytest.mark.slow), ("likelihood", 2)]
)
def test_robots_and_process_learn_the_same_bits(graph, short, tmp_path, objective, count):
    training = Training(graph, short, ROBOTS[:count], **{"mirror.objective": objective})
    graph.ends(training.start(tmp_path / "out"))
    iterations = training.in_process()
    checked(tmp_path / "out", iterations)
    # One first motion, and then rollouts in which the noise explores, of first steps and of
    # iteration 2; each policy is tried without noise once and with it twice.
    learned, tried = 1 + 6 * (1 + 2 + 1), 2 * (1 + 2)
    substeps = make_task(str(short)).dynamics.substeps
    assert iterations[-1].simulator_steps == learned * STEPS * substeps
    done = [training.steps(name) for name in ROBOTS[:count]]
    assert sum(done) == (learned + tried) * STEPS
    assert min(done) > 0
    assert training.learner.output.count("Waiting for the service of") == 0


@pytest.mark.slow
def test_killed_robots_are_missed_and_the_training_goes_on_with_the_same_bits(
    graph, short, tmp_path
):
    training = Training(graph, short, ROBOTS, iterations=12)
    program = training.start(tmp_path / "out")
    training.await_iteration(3)
    first, second = training.robots.values()
    second.kill()
    graph.spin_until_output(
        training.learner, "/robot_2 is lost with a rollout, which is done again"
    )
    training.await_iteration(training.progress[-1].iteration + 2)
    first.kill()
    graph.ends(program, 1)
    assert "None of the robots /robot_1, /robot_2 did a step for 10 s: start" in program.output
    assert "Traceback" not in training.learner.output

    training.start_robot("robot_1")
    program = training.start(tmp_path / "out")
    graph.ends(program)
    assert "Going on from iteration" in training.learner.output
    checked(tmp_path / "out", training.in_process())


@EACH_SIGNAL
def test_a_training_on_robots_is_cancelled_and_its_learner_ends(graph, short, tmp_path, number):
    training = Training(graph, short, ROBOTS[:1], iterations=1000)
    program = training.start(tmp_path / "out")
    training.await_iteration(2)
    assert program.end(signal.SIGINT) == 1
    assert "The training was cancelled." in program.output
    begun = len(training.progress)
    program = training.start(tmp_path / "out")
    graph.spin_until(lambda: len(training.progress) > begun + 1, what="another iteration")
    assert training.learner.end(number, timeout=20.0) == 0
    assert "Traceback" not in training.learner.output
    program.kill()


def test_robots_are_refused_where_rollouts_are_not_enough(graph):
    learner = graph.start("policy_learner", rollout_robots="[robot_1]")
    assert learner.wait() == 1
    assert "rollout_robots is ['robot_1'], but rollouts are enough only for" in learner.output
