# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 over real processes: the learner, its optimizers, and the program that asks."""

import json
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from unique_identifier_msgs.msg import UUID
from vgps_msgs.action import TrainPolicy
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.msg import OptimizerIteration, SolveStatus, TrajectoryDistribution
from vgps_msgs.srv import OptimizeTrajectory

from tests.nodes.conftest import remember
from vgps_ros.core.optimizer_settings import FitSettings
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.settings import settings_of
from vgps_ros.messages.optimization import request_from_msg, request_to_msg, result_to_msg
from vgps_ros.ros_runtime.qos import LATCHED, STREAM, lively
from vgps_ros.search.methods import search
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.settings import RenewalSettings, SearchSettings, search_settings
from vgps_ros.search.situations import initial_states
from vgps_ros.search.trajectory_optimization import optimize, optimize_all
from vgps_ros.storage.run_folder import load_policy
from vgps_ros.tasks import Task, make_task
from vgps_ros.tasks.disturbance import DisturbanceSettings

SHORT = SearchSettings(
    iterations=2, hidden_units=(4,), initial_ddp_iterations=3, evaluation_rollouts=2
)


def parameters(settings: SearchSettings) -> dict[str, object]:
    return {
        "initial_ddp_iterations": settings.initial_ddp_iterations,
        "ddp_iterations": settings.ddp_iterations,
        "evaluation_rollouts": settings.evaluation_rollouts,
        "situations": settings.situations,
        **{s.name: s.default for s in settings_of(settings.disturb, "disturb.") if s.default},
    }


def start_training(graph, settings: SearchSettings, seed: int, output: Path, *flags: str):
    return graph.start_program(
        "train_through_graph",
        *("--iterations", str(settings.iterations), "--seed", str(seed)),
        *("--hidden-units", *map(str, settings.hidden_units), "--output", str(output), *flags),
    )


def train_in_process(task: Task, settings: SearchSettings, seed: int, method: str = "vgps"):
    return list(search(method, task, settings, seed, partial(optimize_all, task)))


def without_times(entries: list[dict]) -> list[dict]:
    return [{k: v for k, v in e.items() if not k.endswith("_seconds")} for e in entries]


def same_bits(a: GaussianPolicy, b: GaussianPolicy) -> bool:
    return (
        a.architecture == b.architecture
        and a.parameters.tobytes() == b.parameters.tobytes()
        and a.noise_std.tobytes() == b.noise_std.tobytes()
    )


def checked(folder: Path, iterations: list) -> tuple[dict, GaussianPolicy, str]:
    """Returns a result, its policy and its task, which must be those of these iterations."""
    result = json.loads((folder / "result.json").read_text())
    entries = [iteration.entry() for iteration in iterations]
    assert without_times(result["iterations"]) == without_times(entries)
    policy, task = load_policy(folder / "policy.json")
    assert same_bits(policy, iterations[-1].policy)
    return result, policy, task


def test_graph_and_process_learn_the_same_bits(graph, swimmer, tmp_path):
    disturb = DisturbanceSettings(push=5.0, payload=1.0)
    settings = replace(SHORT, initial_ddp_iterations=10, situations=2, disturb=disturb)
    graph.start("trajectory_optimizer")
    graph.start("policy_learner", **parameters(settings))
    program = start_training(graph, settings, 7, tmp_path / "out")
    graph.ends(program)

    iterations = train_in_process(swimmer, settings, 7)
    result, _, task = checked(tmp_path / "out", iterations)
    assert result["initial_ddp_cost"] == iterations[-1].initial_ddp_cost
    assert result["num_parameters"] == 9 * 4 + 4 + 4 * 2 + 2
    assert task == "swimmer"


@pytest.mark.slow
def test_another_method_learns_the_same_bits_through_the_graph(graph, tmp_path):
    rotor = make_task("rotor")
    graph.start("trajectory_optimizer", task="rotor")
    own = {"iterations": SHORT.iterations, "hidden_units": list(SHORT.hidden_units)}
    method = {"task": "rotor", "method": "adaptive_gps"}
    graph.start("policy_learner", **method, **own, **parameters(SHORT))
    # What the goal does not say is the learner's parameter.
    program = graph.start_program("train_through_graph", "--seed=2", f"--output={tmp_path / 'out'}")
    graph.ends(program)
    policies = graph.messages(GaussianPolicyMsg, "policy", LATCHED)
    graph.spin_until(lambda: policies, what="the policy, for one who comes late")
    assert policies[0].iteration == SHORT.iterations  # the newest comes first

    iterations = train_in_process(rotor, SHORT, 2, method="adaptive_gps")
    result, _, _ = checked(tmp_path / "out", iterations)
    assert result["method"] == "adaptive_gps"


def test_commands_clock_and_memory_reach_the_optimizer_and_situations_are_renewed(
    graph, told, tmp_path
):
    remember(Path(told), 2)
    task = make_task(told)  # with seed 1 the new situations have solutions
    settings = replace(
        search_settings(task),
        situations=3,
        iterations=SHORT.iterations,
        hidden_units=SHORT.hidden_units,
        initial_ddp_iterations=SHORT.initial_ddp_iterations,
        evaluation_rollouts=SHORT.evaluation_rollouts,
    )
    graph.start("trajectory_optimizer", task=told)
    graph.start("policy_learner", task=told, **parameters(settings))
    program = start_training(graph, settings, 1, tmp_path / "out")
    graph.ends(program)

    iterations = train_in_process(task, settings, 1)
    _, policy, name = checked(tmp_path / "out", iterations)
    assert name == told
    assert policy.observed[-4:] == ("command/angle", "command/lift", "clock/sin", "clock/cos")
    kept = train_in_process(task, replace(settings, renew=RenewalSettings()), 1)
    assert not same_bits(policy, kept[-1].policy)


def share(graph, task, settings, output):
    """Trains with two optimizers, and returns the indices of the trajectories that each solved."""
    for name in ("optimizer_a", "optimizer_b"):
        given = ("--ros-args", "-r", f"__node:={name}", "-p", f"task:={task}")
        graph.start("trajectory_optimizer", *given)
    named = {"task": task, "optimizers": "[optimizer_a, optimizer_b]"}
    graph.start("policy_learner", **named, **parameters(settings))
    solved = {
        name: graph.messages(OptimizerIteration, f"{name}/iterations")
        for name in ("optimizer_a", "optimizer_b")
    }
    graph.ends(start_training(graph, settings, 3, output))
    return [{message.trajectory_index for message in log} for log in solved.values()]


def test_four_initial_states_share_two_optimizers(graph, tmp_path):
    settings = replace(SHORT, situations=4)
    indices = share(graph, "rotor", settings, tmp_path / "out")
    assert all(indices)
    assert indices[0] | indices[1] == {0, 1, 2, 3}
    checked(tmp_path / "out", train_in_process(make_task("rotor"), settings, 3))


@pytest.mark.slow
def test_of_four_initial_states_and_two_optimizers_one_policy_swims_from_all(
    graph, swimmer, tmp_path
):
    settings = replace(
        SHORT, iterations=8, hidden_units=(10,), initial_ddp_iterations=25, situations=4
    )
    share(graph, "swimmer", settings, tmp_path / "out")
    policy, _ = load_policy(tmp_path / "out" / "policy.json")
    starts = initial_states(swimmer, settings, 3)
    assert np.std(starts, axis=0)[2:5].min() > 0.05
    for start in starts:
        law = lambda t, x: policy.mean(swimmer.observation(x))  # noqa: E731
        swim = swimmer.dynamics.rollout(start, law, swimmer.horizon)
        assert swim.states[-1, 0] > 5.0  # metres in 10 s; standing still gives 0
        assert swimmer.trajectory_cost(swim) < 220  # standing still costs 500, converged DDP 157


def test_learner_alone_says_once_what_it_waits_for_and_goes_on_when_it_comes(graph, tmp_path):
    learner = graph.start("policy_learner", task="rotor", wait_timeout=1.0, **parameters(SHORT))
    graph.diagnosis("policy_learner", DiagnosticStatus.ERROR, "trajectory_optimizer")
    program = start_training(graph, SHORT, 0, tmp_path / "out")
    assert learner.output.count("Waiting for the service of trajectory_optimizer") == 1
    graph.start("trajectory_optimizer", task="rotor")
    graph.ends(program)
    graph.diagnosis("policy_learner", DiagnosticStatus.OK)


def test_interrupted_program_cancels_the_training_and_the_learner_takes_the_next(graph, tmp_path):
    graph.start("trajectory_optimizer")
    graph.start("policy_learner", initial_ddp_iterations=100_000)
    graph.start("policy_executor", wait_timeout=1.0)
    iterations = graph.messages(OptimizerIteration, "trajectory_optimizer/iterations")
    graph.diagnosis("policy_executor", DiagnosticStatus.ERROR, "Still waiting for policy")
    first = start_training(graph, SHORT, 0, tmp_path / "first")
    graph.spin_until(lambda: iterations, what="the first iteration of DDP")
    second = start_training(graph, SHORT, 0, tmp_path / "second")
    assert second.wait() == 1
    assert "busy" in second.output
    assert first.end(signal.SIGINT) == 1
    assert "The training was cancelled." in first.output
    graph.diagnosis("policy_executor", DiagnosticStatus.ERROR, "Still waiting for policy")
    count = len(iterations)
    third = start_training(graph, SHORT, 0, tmp_path / "third")
    graph.spin_until(lambda: len(iterations) > count + 2, what="iterations of the next training")
    third.end(signal.SIGINT)


def test_a_cancelled_training_cancels_no_request_of_another_client(graph, swimmer, tmp_path):
    graph.start("trajectory_optimizer")
    graph.start("policy_learner", initial_ddp_iterations=100_000)
    iterations = graph.messages(OptimizerIteration, "trajectory_optimizer/iterations")
    program = start_training(graph, SHORT, 0, tmp_path / "out")
    graph.spin_until(lambda: iterations, what="the first iteration of DDP")
    request = request_to_msg(first_request(swimmer, 0, 2), swimmer, Time())
    other = graph.call_async(OptimizeTrajectory, "trajectory_optimizer/optimize", request)
    graph.spin_for(0.5)
    assert not other.done()
    assert program.end(signal.SIGINT) == 1
    graph.spin_until(other.done, what="the answer to the other client")
    assert other.result().outcome.code == SolveStatus.ITERATION_LIMIT
    assert {bytes(i.request_id.uuid) for i in other.result().iterations} == {
        bytes(request.request_id.uuid)
    }


@pytest.mark.slow
def test_a_second_interrupt_does_not_wait_for_a_learner_that_hangs(graph, tmp_path):
    graph.start("trajectory_optimizer")
    learner = graph.start("policy_learner", initial_ddp_iterations=100_000)
    iterations = graph.messages(OptimizerIteration, "trajectory_optimizer/iterations")
    program = start_training(graph, SHORT, 0, tmp_path / "out")
    graph.spin_until(lambda: iterations, what="the first iteration of DDP")
    learner.send(signal.SIGSTOP)
    try:
        program.send(signal.SIGINT)
        graph.spin_until_output(program, "Cancelling the training")
        assert program.end(signal.SIGINT, timeout=10.0) == 1  # the learner has 15 s
        assert "did not confirm the cancellation" in program.output
    finally:
        learner.send(signal.SIGCONT)


@pytest.mark.slow
def test_a_second_learner_disturbs_no_training(graph, tmp_path):
    graph.start("trajectory_optimizer")
    graph.start("policy_learner", **parameters(SHORT), checkpoint_folder=tmp_path / "kept")
    program = start_training(graph, replace(SHORT, iterations=12), 0, tmp_path / "out")
    graph.spin_until_output(program, "2/12")
    second = graph.start("policy_learner", **parameters(SHORT))
    assert second.wait() == 1
    assert "/policy_learner publishes /learning_progress already" in second.output
    graph.ends(program)
    assert "has died" not in program.output


@pytest.mark.slow
def test_a_training_tells_which_iterations_had_trouble(graph, tmp_path):
    settings = SearchSettings(
        iterations=6,
        hidden_units=(2,),
        initial_ddp_iterations=2,
        evaluation_rollouts=2,
        alphas=(1.0, 10.0),
        visited_limit=0.0,
        fit=FitSettings(optimizer="lbfgs", samples_per_step=10),
    )
    given = {"alphas": [1.0, 10.0], "visited_limit": 0.0}
    given |= {"fit.optimizer": "lbfgs", "fit.samples_per_step": 10}
    graph.start("trajectory_optimizer", task="rotor")
    graph.start("policy_learner", task="rotor", **parameters(settings), **given)
    program = start_training(graph, settings, 0, tmp_path / "out")
    graph.diagnosis("policy_learner", DiagnosticStatus.WARN, "found nothing better")
    graph.ends(program)
    warned = [i.k for i in train_in_process(make_task("rotor"), settings, 0) if i.warnings]
    assert f"{len(warned)} had trouble, last iteration {warned[-1]}: " in program.output


def test_an_optimizer_whose_answer_is_none_ends_the_training_with_a_sentence(graph, tmp_path):
    task, changes = make_task("rotor"), {}

    def answer(message, _):
        request = request_from_msg(message, task)
        response = result_to_msg(optimize(task, request), request, UUID(), task, Time())
        for name, value in changes.items():
            setattr(response, name, value)
        return response

    name = "trajectory_optimizer"
    graph.node.create_publisher(OptimizerIteration, f"{name}/iterations", lively(STREAM))
    graph.node.create_service(GetParameters, f"{name}/get_parameters", lambda _, none: none)
    graph.node.create_service(OptimizeTrajectory, f"{name}/optimize", answer)
    learner = graph.start("policy_learner", task="rotor", **parameters(SHORT))
    for changes, sentence in (  # noqa: B007
        ({"cost": float("nan")}, "costs is nan at index 0"),
        ({"outcome": SolveStatus(code=99)}, "outcome.code is 99, but that of a solution"),
        ({"distribution": TrajectoryDistribution()}, "n_x=0 and n_u=0"),
    ):
        program = start_training(graph, SHORT, 0, tmp_path / "out")
        graph.diagnosis("policy_learner", DiagnosticStatus.ERROR, sentence)
        assert program.wait() == 1
        assert sentence in program.output
        assert learner.running
    assert "Traceback" not in learner.output


def test_goals_out_of_range_are_rejected_with_a_sentence_and_leave_no_error(graph, tmp_path):
    learner = graph.start("policy_learner")
    client = ActionClient(graph.node, TrainPolicy, "policy_learner/train")
    graph.spin_until(client.server_is_ready)
    for goal, sentence in (
        (TrainPolicy.Goal(hidden_units=[0]), "hidden_units is 0, but it must be from 1 to 10000"),
        (TrainPolicy.Goal(iterations=[0]), "iterations is 0, but it must be from 1 to 100000"),
    ):
        sent = client.send_goal_async(goal)
        graph.spin_until(sent.done)
        assert not sent.result().accepted
        assert learner.output.count(sentence) == 1
    client.destroy()
    program = start_training(
        graph, replace(SHORT, hidden_units=(10_000, 10_000)), 0, tmp_path / "out"
    )
    assert program.wait() == 1
    assert "The policy_learner refused the goal" in program.output
    assert learner.output.count("it must have at most") == 1
    assert graph.diagnosis("policy_learner", DiagnosticStatus.OK).message != ""
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [{}, {"alphas": (3.0, 1.0), "alpha_iterations": (0, 1)}])
def test_graph_and_process_learn_the_same_bits_for_the_walker(graph, tmp_path, chosen):
    """Each node makes its own demonstration: no request carries one."""
    path, walker = Path(__file__).parents[2] / "config" / "walker.yaml", make_task("walker")
    settings = replace(
        search_settings(walker),
        **chosen,
        iterations=2,
        hidden_units=(4,),
        initial_ddp_iterations=2,
        evaluation_rollouts=2,
    )
    given = ("--ros-args", "--params-file", str(path))
    graph.start("trajectory_optimizer", *given, task="walker")
    own = {name: list(v) if isinstance(v, tuple) else v for name, v in chosen.items()}
    graph.start("policy_learner", *given, task="walker", **parameters(settings), **own)
    program = start_training(graph, settings, 7, tmp_path / "out")
    graph.ends(program)

    iterations = train_in_process(walker, settings, 7)
    assert checked(tmp_path / "out", iterations)[2] == "walker"
