# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The faults: each strikes the graph, checks what is promised for it, and undoes itself.

A promise that is not kept raises AssertionError or TimeoutError; whether the graph works again, and
whether anything was lost, is checked for all kinds alike by the campaign.
"""

import resource
import signal
import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import ResetSimulation, StepSimulation
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.srv import OptimizeTrajectory

from tests.faults.interrupts import has_begun
from tests.faults.listener import RESENT
from tests.faults.strangers import THERE
from tests.faults.system import BACK, ENDING, NODES, NOTICED, System
from tests.nodes.conftest import SMALL_MEMORY, Process, may_mount
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import command_to_msg, policy_to_msg, state_to_msg
from vgps_ros.ros_runtime.qos import LATCHED, STREAM
from vgps_ros.tasks import make_task

Fault = Callable[[System], None]

GROWTH = 600.0  # of a node's memory under a flood, most of which it gives back afterwards [MB]


def killed(name: str, system: System) -> None:
    """SIGKILL; the node is back after a while, late enough for the others to miss it, or not."""
    system.kill(name)
    if system.rng.random() < 0.5:
        system.wait_until_missed(name)
    system.spin(system.rng.uniform(0.0, 1.0))
    system.start(name)
    if name == "simulation":
        system.play()


def hung(name: str, system: System) -> None:
    """SIGSTOP, until the others have missed it and a while longer."""
    process = system.processes[name]
    process.send(signal.SIGSTOP)
    try:
        system.wait_until_missed(name)
        system.spin(system.rng.uniform(0.0, 2.0))
    finally:
        process.send(signal.SIGCONT)
    if name == "recorder":  # publishers send again what it has missed
        system.spin(1.0 + RESENT)


def ended(name: str, system: System) -> None:
    """INT or TERM, once or twice, and a start anew."""
    system.end(name)
    system.start(name)
    if name == "simulation":
        system.play()


def interrupted_early(system: System) -> None:
    """INT or TERM in the first second of a node, also where a script's shell has INT ignored."""
    name = system.rng.choice(NODES)
    system.end(name)
    system.start(name, system.rng.choice(((), ("env", "--ignore-signal=INT"))))
    begun = [partial(has_begun, system.processes[name].pid, number) for number in ENDING]
    system.wait_for(lambda: all(one() for one in begun), f"the first instruction of {name}")
    system.spin(system.rng.random())
    system.end(name)
    system.start(name)
    if name == "simulation":
        system.play()


def broken_checkpoint(system: System) -> None:
    """SIGKILL of the learner, whose newest checkpoint then turns out to be cut off."""
    system.kill("policy_learner")
    files = [file for file in system.graph.folder.glob("checkpoints/**/*") if file.is_file()]
    files.sort(key=lambda file: file.stat().st_mtime)
    if files:
        with files[-1].open("r+b") as file:
            file.truncate(system.rng.randrange(files[-1].stat().st_size))
    system.start("policy_learner")


def full_disk(system: System) -> None:
    """The recorder may write no further, as on a disk that is full, for a while."""
    recording = system.recordings[-1]
    used = max(file.stat().st_size for file in recording.path.glob("*.mcap"))
    recording.close(slack=1.0)
    limit = partial(resource.prlimit, system.processes["recorder"].pid, resource.RLIMIT_FSIZE)
    limit((used, resource.RLIM_INFINITY))
    try:
        system.wait_for_word("File too large")
    finally:
        limit((resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def twin(name: str, system: System) -> None:
    """A second node of a kind that may be there once is refused."""
    second = system.graph.start(name, task=system.task)
    system.wait_for(lambda: not second.running, f"the refusal of a second {name}")
    assert second.wait() == 1, second.output
    assert "publishes" in second.output, second.output


def bad_state(system: System) -> None:
    """A robot's driver that sends what is no state."""
    task = make_task(system.task)
    state = np.zeros(task.dims["n_x"])
    state[system.rng.randrange(len(state))] = system.rng.choice([np.nan, np.inf, -np.inf])
    message = state_to_msg(state, task.joint_names, Time(sec=2**31 - 1))
    if system.rng.random() < 0.5:
        message.name = message.name[:-1]
    _publish(system, JointState, "joint_states", message, ("policy_executor", "the safe action"))


def bad_command(system: System) -> None:
    """Torques that the simulation must not take."""
    task = make_task(system.task)
    torques = np.full(task.dynamics.control_dim, system.rng.choice([np.nan, 1e300]))
    message = command_to_msg(torques, task.actuated_joint_names, Time())
    answer = ("simulation", "Ignored a joint_command")
    _publish(system, JointState, "joint_command", message, answer)


def bad_policy(system: System) -> None:
    """A policy of another robot."""
    shape = Architecture(("wing/position",), (3,), 1)
    policy = GaussianPolicy(shape, np.zeros(shape.num_parameters), np.ones(1))
    message = policy_to_msg(policy, "other", 1, Time())
    answer = ("policy_executor", "Refused a policy")
    _publish(system, GaussianPolicyMsg, "policy", message, answer, LATCHED)


def bad_request(system: System) -> None:
    """A request that no solver can take."""
    request = OptimizeTrajectory.Request(task=system.task, cost_scale=float("nan"))
    answer = system.graph.call(OptimizeTrajectory, "trajectory_optimizer/optimize", request)
    assert not answer.success
    assert answer.message


def bad_parameter(system: System) -> None:
    """A value of the wrong type for a parameter of any node."""
    name = system.rng.choice(NODES)
    parameter = Parameter("wait_timeout", value="soon").to_parameter_msg()
    assert parameter.value.type == ParameterType.PARAMETER_STRING
    request = SetParameters.Request(parameters=[parameter])
    result = system.graph.call(SetParameters, f"{name}/set_parameters", request).results[0]
    assert not result.successful
    assert result.reason


def reset(system: System) -> None:
    """Time jumps back to zero."""
    answer = system.graph.call(ResetSimulation, "simulation/reset_simulation")
    assert answer.result.result == 1, answer.result.error_message


def impossible_step(system: System) -> None:
    """A service that is asked for what it cannot do now."""
    answer = system.graph.call(StepSimulation, "simulation/step_simulation")
    assert answer.result.error_message


def hostile_rates(system: System) -> None:
    """A stranger floods the topics: no node's memory grows far, and all answer again."""
    before = {name: process.memory for name, process in system.processes.items()}
    strangers = _strangers(system, "flood", 5)
    while strangers.running:
        system.spin(0.2)
        for name, process in system.processes.items():
            grown = process.memory - before[name]
            if grown > GROWTH:
                strangers.kill()
            assert grown <= GROWTH, f"{name} grew by {grown:.0f} MB under a flood."
    assert strangers.wait() == 0, strangers.output
    name = system.rng.choice(NODES)
    request = GetParameters.Request(names=["peer_timeout"])
    system.graph.call(GetParameters, f"{name}/get_parameters", request, BACK)


def crowd(system: System) -> None:
    """A node that is started beside thirty strange participants finds the others."""
    strangers = _strangers(system, "crowd", 30)
    system.wait_for(lambda: THERE in strangers.output, "thirty strangers")
    ended(system.rng.choice(NODES), system)
    system.wait_until_it_works()
    strangers.send(signal.SIGINT)
    system.wait_for(lambda: not strangers.running, "the end of the strangers")
    assert strangers.wait() == 0, strangers.output


def damaged_bag(system: System) -> None:
    """Copies of the bag just recorded are damaged, and each reader takes what is whole in them."""
    ended("recorder", system)
    bag, seed = system.recordings[-2].path, system.rng.randrange(10**6)
    words = ["-m", "tests.bags.damage", "--bag", str(bag), "--count", "5", "--seed", str(seed)]
    readers = system.graph.start_command("damage", [sys.executable, *words])
    system.wait_for(lambda: not readers.running, "the readers of damaged bags", 3 * BACK)
    assert readers.wait() == 0, readers.output


def full_memory(system: System) -> None:
    """A node that finds /dev/shm full to all but the last pages works."""
    name = system.rng.choice(("recorder", "visualizer"))
    system.end(name)
    system.start(name, (*SMALL_MEMORY, "1M", "960K"))
    system.wait_until_it_works()
    ended(name, system)


def _strangers(system: System, what: str, number: int) -> Process:
    command = [sys.executable, "-m", "tests.faults.strangers", what, str(number)]
    return system.graph.start_command("strangers", command)


def _publish(
    system: System,
    kind: type,
    topic: str,
    message: object,
    answer: tuple[str, str],
    qos: object = STREAM,
) -> None:
    """Publishes until a node answers on /diagnostics with certain words.

    A controller and its robot take the newest message alone, so that a single bad one may be
    overtaken by a good one, which does no harm.
    """
    publisher = system.graph.publisher(kind, topic, qos)
    name, words = answer
    end = time.monotonic() + NOTICED
    answered = False
    while not answered:
        assert time.monotonic() < end, f"After {NOTICED:g} s /{name} does not say '{words}'."
        publisher.publish(message)
        system.spin(0.2)
        answered = f"/{name}" in system.listener.who_said(words)
    publisher.wait_for_all_acked(Duration(seconds=3))  # one that was killed counts for a while
    system.graph.node.destroy_publisher(publisher)


FAULTS: dict[str, Fault] = {
    **{f"{name} killed": partial(killed, name) for name in NODES},
    **{f"{name} hangs": partial(hung, name) for name in NODES},
    **{f"{name} started anew": partial(ended, name) for name in NODES},
    "checkpoint cut off": broken_checkpoint,
    "disk full": full_disk,
    "second policy_learner": partial(twin, "policy_learner"),
    "second policy_executor": partial(twin, "policy_executor"),
    "bad state": bad_state,
    "bad command": bad_command,
    "bad policy": bad_policy,
    "bad request": bad_request,
    "bad parameter": bad_parameter,
    "time jumps back": reset,
    "impossible step": impossible_step,
    "hostile rates": hostile_rates,
    "30 strangers, a node started anew": crowd,
    "early INT, a node started anew": interrupted_early,
    "damaged bag, recorder started anew": damaged_bag,
}
if may_mount():
    FAULTS["/dev/shm full, a node started anew"] = full_memory
