# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A graph at work whose nodes are killed, stopped and started anew at random.

Each training must end with the policy that it learns undisturbed. FAULTS sets how many faults there
are, FAULTS_SEED which.
"""

import os
import signal
from random import Random

import pytest

from tests.nodes.test_lost_learner import PARAMETERS, ROTOR, SETTINGS
from tests.nodes.test_training import same_bits, start_training, train_in_process
from vgps_ros.bags import BagReader
from vgps_ros.storage.run_folder import load_policy

pytestmark = pytest.mark.slow

COUNT = int(os.environ.get("FAULTS", "6"))
SEED = int(os.environ.get("FAULTS_SEED", "20131205"))
HUNG = (1.0, 6.0)  # time for which a node hangs [s]: others miss it, or do not
PATIENCE = 300.0  # with a training, which faults interrupt [s]


class System:
    """The graph: a training that never ends, a policy that drives, and a recorder."""

    def __init__(self, graph, folder, rng):
        self.graph, self.folder, self.rng = graph, folder, rng
        self.bags, self.trainings, self.processes = [], [], {}
        self.options = {
            "simulation": {"task": "rotor", "mode": "real_time"},
            "trajectory_optimizer": {"task": "rotor"},
            "policy_executor": {"task": "rotor"},
            "policy_learner": {**PARAMETERS, "checkpoint_folder": folder / "checkpoints"},
            "recorder": {},
        }
        for name in self.options:
            self.start(name)
        self.keep_training()

    def start(self, name):
        options = dict(self.options[name])
        if name == "recorder":
            self.bags.append(self.folder / f"bag_{len(self.bags)}")
            options["output"] = self.bags[-1]
        self.processes[name] = self.graph.start(name, **options)

    def keep_training(self):
        """Begins the next training where the last one has ended."""
        if not self.trainings or not self.trainings[-1][1].running:
            seed, folder = self.rng.randrange(10**6), self.folder / f"run_{len(self.trainings)}"
            flags = ("--timeout", "120")  # the machine may be busy
            program = start_training(self.graph, SETTINGS, seed, folder, *flags)
            self.trainings.append((seed, program))

    def strike(self):
        """Injects a fault; returns its name once the struck node works again."""
        name, fault = (
            self.rng.choice(list(self.processes)),
            self.rng.choice(["kill", "hang", "end"]),
        )
        process = self.processes[name]
        if fault == "hang":
            process.send(signal.SIGSTOP)
            self.graph.spin_for(self.rng.uniform(*HUNG))
            process.send(signal.SIGCONT)
        elif fault == "kill":
            process.kill()
        else:
            number = self.rng.choice([signal.SIGINT, signal.SIGTERM])
            assert process.end(number) == 0, process.output
        if fault != "hang":
            self.graph.spin_for(self.rng.uniform(0.0, 5.0))
            self.start(name)
        self.graph.diagnosis(name, None)
        return f"{name}: {fault}"


def test_trainings_end_with_the_same_policy_whatever_happens_to_the_nodes(graph, tmp_path):
    rng = Random(SEED)
    system = System(graph, tmp_path, rng)
    for number in range(COUNT):
        graph.spin_for(rng.uniform(1.0, 3.0))
        system.keep_training()
        print(f"{number + 1}/{COUNT}", system.strike(), flush=True)
        for name, process in system.processes.items():
            assert process.running, f"{name} ended too: {process.output}"
    last = system.trainings[-1][1]
    graph.spin_until(lambda: not last.running, PATIENCE, "the end of the last training")
    for number, (seed, program) in enumerate(system.trainings):
        assert program.wait() == 0, program.output
        learned, _ = load_policy(tmp_path / f"run_{number}" / "policy.json")
        expected = train_in_process(ROTOR, SETTINGS, seed)[-1].policy
        assert same_bits(learned, expected), f"The policy of seed {seed} is another one."
    assert system.processes["recorder"].end() == 0
    with BagReader(system.bags[-1]) as bag:
        assert sum(bag.counts.values()) > 0
