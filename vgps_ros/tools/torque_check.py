"""Whether a bag's torques are those that its policy gives for its states, bit for bit.

A torque answers the state whose stamp it carries. Topics reach a recorder by ways of their own, so
a state or policy may stand in the bag somewhat after the torque that it led to.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml

from vgps_ros.bags import BagReader
from vgps_ros.core.checks import one_of
from vgps_ros.core.execution import executed_control
from vgps_ros.core.joints import actuated_joint_names, compile_model, joint_names
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import (
    command_from_msg,
    nanoseconds,
    policy_from_msg,
    state_from_msg,
)

_SLACK = 10**9  # by which a message may reach the recorder later than the one it led to [ns]
_NEEDED = ("robot_description", "policy", "joint_states", "joint_command")


@dataclass
class TorqueCheck:
    """What a check found.

    Attributes:
        deterministic: torques that are the policy's mean.
        stochastic: torques that are its mean plus the noise of the recorded seed.
        unanswered: states without a torque, between the first torque and the last.
        stateless: torques whose state is not in the bag, received after the first state that is.
        different: torques that the policy does not give.
        first_difference: a sentence on the first of those.
    """

    deterministic: int = 0
    stochastic: int = 0
    unanswered: int = 0
    stateless: int = 0
    different: int = 0
    first_difference: str = ""

    @property
    def is_good(self) -> bool:
        """Whether every torque has its state and is what the policy gives."""
        return not (self.different or self.stateless)


@dataclass
class _Timeline:
    """Values in the order in which they were received."""

    received: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    def add(self, received: int, value: Any) -> None:
        self.received.append(received)
        self.values.append(value)

    def around(self, time: int) -> list[Any]:
        """Values that may have been the latest at a time, the most likely one first."""
        first = max(0, int(np.searchsorted(self.received, time - _SLACK, side="right")) - 1)
        last = int(np.searchsorted(self.received, time + _SLACK, side="right"))
        now = int(np.searchsorted(self.received, time, side="right")) - 1
        return [self.values[i] for i in sorted(range(first, last), key=lambda i: abs(i - now))]


def check_torques(bag: BagReader) -> TorqueCheck:
    """Compares every recorded torque with what the recorded policy gives.

    Raises:
        InvalidInputError: the bag lacks a topic that is needed, or holds no torque.
    """
    names = {topic.rpartition("/")[2]: topic for topic in bag.topics if bag.counts[topic]}
    topics = {name: names[one_of("the topic to check", name, names)] for name in _NEEDED}
    model = compile_model(_first(bag, topics["robot_description"]).data)
    policies = _Timeline()
    for received, message in _decoded(bag, topics["policy"]):
        policies.add(received, (message.iteration, policy_from_msg(message)))
    states: dict[int, _Timeline] = defaultdict(_Timeline)
    for received, message in _decoded(bag, topics["joint_states"]):
        state = state_from_msg(message, joint_names(model))
        states[nanoseconds(message.header.stamp)].add(received, state)
    seed = _seed(bag)
    actuated = actuated_joint_names(model)
    first_state = min(timeline.received[0] for timeline in states.values())
    found = TorqueCheck()
    answered = set()
    for received, message in _decoded(bag, topics["joint_command"]):
        stamp = nanoseconds(message.header.stamp)
        torques = command_from_msg(message, actuated)
        answered.add(stamp)
        answered_states = states[stamp].around(received) if stamp in states else []
        if answered_states:
            # A policy that was latched long before may be recorded late, but there was one.
            known = policies.around(received) or policies.values[:1]
            _compare(found, torques, stamp, (known, answered_states), seed, actuated)
        elif received > first_state:
            found.stateless += 1
    between = [stamp for stamp in states if min(answered) <= stamp <= max(answered)]
    found.unanswered = len(set(between) - answered)
    return found


def _compare(
    found: TorqueCheck,
    torques: Array,
    stamp: int,
    possible: tuple[list[tuple[int, GaussianPolicy]], list[Array]],
    seed: int,
    actuated: list[str],
) -> None:
    policies, states = possible
    for state in states:
        for _, policy in policies:
            if np.array_equal(torques, executed_control(policy, state, stamp)):
                found.deterministic += 1
                return
            if np.array_equal(torques, executed_control(policy, state, stamp, seed)):
                found.stochastic += 1
                return
    found.different += 1
    if not found.first_difference:
        iteration, policy = policies[0]
        expected = executed_control(policy, states[0], stamp)
        joint = int(np.argmax(torques != expected))
        found.first_difference = (
            f"At {stamp * 1e-9:.3f} s the torque of {actuated[joint]} is {torques[joint]!r} N·m, "
            f"but the policy of iteration {iteration} gives {expected[joint]!r} N·m "
            f"(without noise)."
        )


def _decoded(bag: BagReader, topic: str) -> Iterator[tuple[int, Any]]:
    for message in bag.messages([topic]):
        yield message.stamp, bag.decode(message)


def _first(bag: BagReader, topic: str) -> Any:
    return next(_decoded(bag, topic))[1]


def _seed(bag: BagReader) -> int:
    """The seed of the executor's noise, from the parameters that the bag holds."""
    nodes = yaml.safe_load(bag.attachments().get("parameters.yaml", "")) or {}
    for node in nodes.values():
        parameters = node["ros__parameters"]
        if {"seed", "stochastic"} <= set(parameters):
            return int(parameters["seed"])
    return 0
