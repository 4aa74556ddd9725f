"""Whether a bag's torques are those that its policy gives for its states, bit for bit.

They are compared within the limits that the executor had, by its recorded parameters. Torques of
its safe action are told apart from the policy's.

A torque answers the state whose stamp it carries. Topics reach a recorder by ways of their own, so
a state or policy may stand in the bag somewhat after the torque that it led to.
"""

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from vgps_ros.bags import BagReader
from vgps_ros.bags.recorded_executor import RecordedExecutor
from vgps_ros.bags.topics import filled_topics, needed_topic
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.execution import executed_control
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import (
    command_from_msg,
    distribution_from_msg,
    nanoseconds,
    policy_from_msg,
    state_from_msg,
)
from vgps_ros.safety import TrainingMarginals
from vgps_ros.simulation.model import actuated_joint_names, compile_model, joint_names

_SLACK = 10**9  # by which a message may reach the recorder later than the one it led to [ns]
_NEEDED = ("robot_description", "policy", "joint_states", "joint_command")


@dataclass
class TorqueCheck:
    """What a check found.

    Attributes:
        deterministic: torques that are the policy's mean.
        stochastic: torques that are its mean plus the noise of the recorded seed.
        clipped: how many of these two are at a limit of their size.
        rate_limited: how many of these two are at a limit of their change.
        safe: torques that are not the policy's, but those of the safe action, or zero.
        unchecked: torques under a limit of their change whose predecessor is not in the bag.
        unusable: states that no torque may answer, such as one that is not finite.
        unanswered: states without a torque, between the first torque and the last.
        stateless: torques whose state is not in the bag, received after the first state that is.
        different: torques that the policy does not give.
        first_difference: a sentence on the first of those.
    """

    deterministic: int = 0
    stochastic: int = 0
    clipped: int = 0
    rate_limited: int = 0
    safe: int = 0
    unchecked: int = 0
    unusable: int = 0
    unanswered: int = 0
    stateless: int = 0
    different: int = 0
    first_difference: str = ""

    @property
    def is_good(self) -> bool:
        """Whether every torque has its state and is what the policy or the safe action gives."""
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
    names = filled_topics(bag)
    topics = {name: needed_topic(bag, name) for name in _NEEDED}
    model = compile_model(next(bag.decoded(topics["robot_description"]))[1].data)
    policies = _Timeline()
    for received, message in bag.decoded(topics["policy"]):
        policies.add(received, (message.iteration, policy_from_msg(message)))
    joints, actuated = joint_names(model), actuated_joint_names(model)
    executor = RecordedExecutor(bag, joints, actuated)
    marginals = _marginals(bag, executor, names)
    found = TorqueCheck()
    states: dict[int, _Timeline] = defaultdict(_Timeline)
    for received, message in bag.decoded(topics["joint_states"]):
        if (state := _usable(message, joints)) is None:
            found.unusable += 1
        else:
            states[nanoseconds(message.header.stamp)].add(received, state)
    first_state = min((timeline.received[0] for timeline in states.values()), default=0)
    answered: set[int] = set()
    for received, message in bag.decoded(topics["joint_command"]):
        stamp = nanoseconds(message.header.stamp)
        torques = command_from_msg(message, actuated)
        answered_states = states[stamp].around(received) if stamp in states else []
        if answered_states:
            # A policy that was latched long before may be recorded late, but there was one.
            known = policies.around(received) or policies.values[:1]
            had = marginals.around(received) or [()]
            sent = _Sent(torques, stamp, known, answered_states, had, is_first=not answered)
            is_safe = _compare(found, sent, executor, actuated)
        else:
            found.stateless += received > first_state
            is_safe = False
        if is_safe:
            executor.limiter.note_safe(torques)
        else:
            executor.limiter.note(torques, stamp)
        answered.add(stamp)
    between = [stamp for stamp in states if min(answered) <= stamp <= max(answered)]
    found.unanswered = len(set(between) - answered)
    return found


@dataclass(frozen=True)
class _Sent:
    """Torques, and what they may have come from."""

    torques: Array
    stamp: int
    policies: list[tuple[int, GaussianPolicy]]
    states: list[Array]
    marginals: list[tuple[TrainingMarginals, ...]]
    is_first: bool


def _compare(
    found: TorqueCheck, sent: _Sent, executor: RecordedExecutor, actuated: list[str]
) -> bool:
    """Counts torques as what they are; returns whether they are those of the safe action."""
    limiter = executor.limiter
    for state in sent.states:
        for _, policy in sent.policies:
            for seed in (None, executor.seed):
                wanted = executed_control(policy, state, sent.stamp, seed)
                if not np.array_equal(sent.torques, limiter.limited(wanted, sent.stamp)):
                    continue
                if seed is None:
                    found.deterministic += 1
                else:
                    found.stochastic += 1
                clipped = limiter.clipped(wanted)
                found.clipped += not np.array_equal(clipped, wanted)
                found.rate_limited += not np.array_equal(clipped, sent.torques)
                return False
        if executor.is_safe(sent.torques, state, sent.marginals):
            found.safe += 1
            return True
    if sent.is_first and executor.limits_rates:
        found.unchecked += 1
        return False
    found.different += 1
    if not found.first_difference:
        iteration, policy = sent.policies[0]
        wanted = executed_control(policy, sent.states[0], sent.stamp)
        expected = limiter.limited(wanted, sent.stamp)
        joint = int(np.argmax(sent.torques != expected))
        found.first_difference = (
            f"At {sent.stamp * 1e-9:.3f} s the torque of {actuated[joint]} is "
            f"{sent.torques[joint]!r} N·m, but the policy of iteration {iteration} gives "
            f"{expected[joint]!r} N·m (without noise)."
        )
    return False


def _marginals(bag: BagReader, executor: RecordedExecutor, names: dict[str, str]) -> _Timeline:
    """What the executor knew of the training, where its safe action needs it."""
    timeline, latest = _Timeline(), dict[int, TrainingMarginals]()
    if executor.follows_distribution and "trajectory_distribution" in names:
        for received, message in bag.decoded(names["trajectory_distribution"]):
            q = distribution_from_msg(message)
            latest[message.trajectory_index] = executor.marginals(q)
            timeline.add(received, tuple(latest.values()))
    return timeline


def _usable(message: JointState, joints: list[str]) -> Array | None:
    try:
        return state_from_msg(message, joints)
    except InvalidInputError:
        return None
