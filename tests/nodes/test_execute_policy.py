# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `execute_policy`, with the real simulation and executor."""

import json

import numpy as np
import pytest

from tests.nodes.conftest import EACH_SIGNAL
from vgps_ros.core.records import Trajectory


def test_its_figures_are_those_of_a_rollout_in_process_each_time(
    graph, swimmer, random_policy, tmp_path
):
    policy, steps = random_policy(5), 53
    graph.publish_policy(policy)
    graph.start("simulation")
    graph.start("policy_executor")
    (states,), (controls,) = swimmer.dynamics.execute(
        policy, swimmer.observation, swimmer.initial_state[None], np.zeros((1, steps, 2))
    )
    rollout = Trajectory(states, controls)
    distance = rollout.states[-1, 0] - rollout.states[0, 0]
    # A course is of no account to a task without commands, as in the demo.
    for course in ([], ["--course", "figure_of_eight", "--picture", str(tmp_path / "none.png")]):
        figures = tmp_path / "figures.json"
        words = ["--steps", str(steps), "--json", str(figures), *course]
        program = graph.start_program("execute_policy", *words)
        graph.ends(program)
        written = json.loads(figures.read_text())
        assert written["cost"] == swimmer.trajectory_cost(rollout)
        assert written["distance"] == distance
        assert written["mean_speed"] == pytest.approx(distance / (steps * 0.02))
        assert f"{written['cost']:.3f}" in program.output
        assert not (tmp_path / "none.png").exists()
        figures.unlink()


def test_it_ends_with_a_sentence_where_something_is_missing(graph, random_policy):
    def ends_with(*arguments, code=1):
        program = graph.start("execute_policy", *arguments)
        graph.ends(program, code)
        assert "Traceback" not in program.output
        return program.output

    assert "There is no task 'crawler'" in ends_with("--task", "crawler")
    assert "steps is 0, but it must be from 1" in ends_with("--steps", "0", code=2)
    assert "No simulation is there" in ends_with("--timeout", "1")
    graph.start("simulation")
    assert "No policy came" in ends_with("--timeout", "3")
    graph.publish_policy(random_policy(0))
    assert "Is policy_executor running" in ends_with("--timeout", "3")


@EACH_SIGNAL
def test_a_signal_ends_it_with_a_sentence(graph, number):
    program = graph.start("execute_policy")
    graph.spin_until(lambda: "execute_policy" in graph.node.get_node_names())
    program.end(number)
    assert "Traceback" not in program.output
    assert "vgps execute-policy: interrupted." in program.output
