"""Checks that a bag's torques are those that its policy gives for its states, bit for bit.

The torques are computed again with the limits from the executor's recorded parameters. Torques of
the safe action are counted separately from the policy's.

A torque answers the state that has the same stamp. The topics reach a recorder independently, so
the bag may hold a state or a policy somewhat later than the torque that was computed from it.
"""

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vgps_ros.bags import BagReader
from vgps_ros.bags.recorded_executor import RecordedExecutor
from vgps_ros.bags.states import recorded_states
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy, executed_control
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import (
    command_from_msg,
    distribution_from_msg,
    nanoseconds,
    policy_from_msg,
)
from vgps_ros.messages.robot_state import JOINTS, StateMessages
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.simulation.model import actuated_joint_names, compile_model

_SLACK = 10**9  # largest delay with which the bag holds a state after its torque [ns]
_NEEDED = ("robot_description", "policy", "joint_states", "joint_command")


@dataclass
class TorqueCheck:
    """The outcome of a check, as numbers of torques and states.

    Attributes:
        deterministic: torques that equal the policy's mean.
        stochastic: torques that equal the policy's mean plus the noise of the recorded seed.
        clipped: torques among these two kinds that are at a limit of their size.
        rate_limited: torques among these two kinds that are at a limit of their change.
        safe: other torques that are zero, or equal those of the safe action.
        unchecked: torques whose change is limited, but whose predecessor is not in the bag.
        unusable: states that no torque may answer, such as one that is not finite.
        unanswered: states without a torque, between the first torque and the last.
        stateless: torques whose state is not in the bag, although earlier states are.
        different: torques that neither the policy nor the safe action gives.
        first_difference: a sentence on the first different torque.
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
        """True if every torque has a state, and is what the policy or the safe action gives."""
        return not (self.different or self.stateless)


@dataclass
class _Timeline:
    """Values with the times at which they were received [ns], in this order."""

    received: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    def add(self, received: int, value: Any) -> None:
        self.received.append(received)
        self.values.append(value)

    def around(self, time: int) -> list[Any]:
        """Returns the values that may have been the latest at a time, the likeliest first."""
        first = max(0, int(np.searchsorted(self.received, time - _SLACK, side="right")) - 1)
        last = int(np.searchsorted(self.received, time + _SLACK, side="right"))
        now = int(np.searchsorted(self.received, time, side="right")) - 1
        return [self.values[i] for i in sorted(range(first, last), key=lambda i: abs(i - now))]


def check_torques(bag: BagReader) -> TorqueCheck:
    """Compares every recorded torque with what the recorded policy gives.

    Raises:
        InvalidInputError: the bag lacks a topic that is needed, or holds no torque.
    """
    topics = {name: bag.needed_topic(name) for name in _NEEDED}
    model = compile_model(next(bag.decoded(topics["robot_description"]))[1].data)
    executor = RecordedExecutor(bag, model)
    policies = _Timeline()
    for received, message in bag.decoded(topics["policy"]):
        policies.add(received, (message.iteration, executor.named(policy_from_msg(message))))
    robot_states, actuated = StateMessages(model), actuated_joint_names(model)
    marginals = _marginals(bag, executor)
    found = TorqueCheck()
    states: dict[int, _Timeline] = defaultdict(_Timeline)
    for received, messages in recorded_states(bag, robot_states):
        try:
            state = robot_states.join(messages)
        except InvalidInputError:  # noqa: PERF203
            found.unusable += 1
        else:
            states[nanoseconds(messages[JOINTS].header.stamp)].add(received, state)
    first_state = min((timeline.received[0] for timeline in states.values()), default=0)
    answered: set[int] = set()
    for received, message in bag.decoded(topics["joint_command"]):
        stamp = nanoseconds(message.header.stamp)
        torques = command_from_msg(message, actuated)
        answered_states = states[stamp].around(received) if stamp in states else []
        if answered_states:
            # Even the first policy may be recorded late, since it was published long before.
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
    """Recorded torques, with the policies, states and marginals that may have led to them."""

    torques: Array
    stamp: int
    policies: list[tuple[int, GaussianPolicy]]
    states: list[Array]
    marginals: list[tuple[TrainingMarginals, ...]]
    is_first: bool


def _compare(
    found: TorqueCheck, sent: _Sent, executor: RecordedExecutor, actuated: list[str]
) -> bool:
    """Counts torques as what they are. Returns True for torques of the safe action."""
    limiter = executor.limiter
    for state in sent.states:
        for _, policy in sent.policies:
            for seed in (None, executor.seed):
                inputs = executor.inputs(policy, state)
                wanted = executed_control(policy, inputs, sent.stamp, seed)
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
    if sent.is_first and executor.settings.torque_rate_limit:
        found.unchecked += 1
        return False
    found.different += 1
    if not found.first_difference:
        iteration, policy = sent.policies[0]
        inputs = executor.inputs(policy, sent.states[0])
        wanted = executed_control(policy, inputs, sent.stamp)
        expected = limiter.limited(wanted, sent.stamp)
        joint = int(np.argmax(sent.torques != expected))
        found.first_difference = (
            f"At {sent.stamp * 1e-9:.3f} s the torque of {actuated[joint]} is "
            f"{sent.torques[joint]!r} N·m, but the policy of iteration {iteration} gives "
            f"{expected[joint]!r} N·m (without noise)."
        )
    return False


def _marginals(bag: BagReader, executor: RecordedExecutor) -> _Timeline:
    """Reads the training marginals that the executor had, if its safe action needs them."""
    timeline, latest = _Timeline(), dict[int, TrainingMarginals]()
    topic = bag.filled_topics.get("trajectory_distribution")
    if executor.settings.safe_action == "feedback" and topic:
        for received, message in bag.decoded(topic):
            q = distribution_from_msg(message)
            latest[message.trajectory_index] = executor.marginals(q)
            timeline.add(received, tuple(latest.values()))
    return timeline
