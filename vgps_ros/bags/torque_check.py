# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks that a bag's torques are those that its policy gives for its states, bit for bit.

The torques are computed again with the limits from the executor's recorded parameters. Those of the
safe action count only where the executor's diagnostics say that it drove, and zero torques also at
the end of its activity. Each state that came while a policy drove must have its answer. A network
of others, which onnxruntime executes, is computed again within a tolerance only, since its
arithmetic depends on the machine.

A torque answers the state that has the same stamp. The topics reach a recorder independently, so
the bag may hold a state or a policy somewhat later than the torque that was computed from it.
"""

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from vgps_ros.bags import BagReader, recorded_policies
from vgps_ros.bags.answered_states import AnsweredStates
from vgps_ros.bags.executor_log import ExecutorLog
from vgps_ros.bags.recorded_executor import RecordedExecutor
from vgps_ros.bags.recorded_policies import learned_policy, onnx_content, policy_messages
from vgps_ros.bags.timeline import SLACK, Timeline
from vgps_ros.bags.torque_counts import TorqueCheck
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.executed_control import ExecutedPolicy, Policy
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import (
    command_from_msg,
    distribution_from_msg,
    nanoseconds,
)
from vgps_ros.policies import onnx_policy
from vgps_ros.policies.onnx_policy import OnnxPolicy
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.simulation.model import actuated_joint_names, compile_model

_NEEDED = ("joint_states", "joint_command")
# Between the torques of two BLAS kernels, relative to the largest torque. Versions whose executors
# did not count their commands computed torques by BLAS.
TOLERANCE = 1e-9


def check_torques(bag: BagReader) -> TorqueCheck:
    """Compares every recorded torque with what the recorded policy gives.

    Raises:
        InvalidInputError: the bag lacks a topic that is needed, or holds no torque.
    """
    model = compile_model(bag.mjcf())
    topics = {name: bag.needed_topic(name) for name in _NEEDED}
    executor, actuated = RecordedExecutor(bag, model), actuated_joint_names(model)
    policies, marginals = _policies(bag, executor, actuated), _marginals(bag, executor)
    states, log = AnsweredStates(bag, model), ExecutorLog(bag, topics["joint_command"])
    contradictions = executor.parameters.contradictions()
    found = TorqueCheck(unusable=states.unusable, parameters=contradictions)
    commands, answered_stamps = list[int](), list[int]()
    before: _Sent | None = None
    for received, message in bag.decoded(topics["joint_command"], refused=found.refused):
        stamp = nanoseconds(message.header.stamp)
        try:
            torques = command_from_msg(message, actuated)
        except InvalidInputError as error:
            found.refused.append(f"At {stamp * 1e-9:.3f} s, {error}")
            continue
        is_safe = is_answer = False
        if answered := states.around(stamp, received):
            # Even the first policy may be recorded late, since it was published long before.
            known = policies.around(received) or policies.values[:1]
            had = marginals.around(received) or [()]
            sent = _Sent(torques, stamp, received, known, answered, had, before)
            is_safe, is_answer = _compare(found, sent, executor, log, actuated)
            before = replace(sent, before=None, is_last=is_safe and not is_answer)
        elif received < states.begin:
            found.early += 1
        else:
            found.stateless += 1
        if is_safe:
            executor.limiter.note_safe(torques)
        else:
            executor.limiter.note(torques, stamp)
            answered_stamps += [stamp] * is_answer
        commands.append(received)
        if is_answer:
            states.note_answer(stamp, received)
    found.counted = log.count(commands) if log.counts else None
    lock_step, begin = executor.is_in_lock_step, policies.received[0] + SLACK
    lacking, found.unknown = states.unanswered(log, begin, is_in_lock_step=lock_step)
    found.unanswered, found.skipped = (lacking, 0) if lock_step else (0, lacking)
    if lock_step and executor.control_period:
        found.absent = states.absent(executor.control_period)
    found.surplus = states.surplus(Counter(answered_stamps))
    found.disordered = states.disordered(answered_stamps)
    return found


@dataclass(frozen=True)
class _Sent:
    """Recorded torques, with the policies, states and marginals that may have led to them."""

    torques: Array
    stamp: int
    received: int
    policies: list[tuple[int, ExecutedPolicy]]
    states: list[Array]
    marginals: list[tuple[TrainingMarginals, ...]]
    before: "_Sent | None"  # the torques before; None for the first
    is_last: bool = False  # whether the executor ended its activity with them


def _compare(
    found: TorqueCheck, sent: _Sent, executor: RecordedExecutor, log: ExecutorLog, names: list[str]
) -> tuple[bool, bool]:
    """Counts torques as what they are.

    Returns:
        Whether they are of the safe action, and whether they answer their state.
    """
    limiter = executor.limiter
    for state in sent.states:
        for _, policy in sent.policies:
            for seed in executor.seeds(sent.received):
                inputs = executor.inputs(policy.policy, state)
                wanted = policy.control(inputs, sent.stamp, seed)
                expected = limiter.limited(wanted, sent.stamp)
                kind = _agreement(sent.torques, expected, policy, seed, is_old=not log.counts)
                if not kind:
                    continue
                setattr(found, kind, getattr(found, kind) + 1)
                clipped = limiter.clipped(wanted)
                found.clipped += not np.array_equal(clipped, wanted)
                found.rate_limited += not np.array_equal(clipped, expected)
                return False, True
        if executor.is_safe(sent.torques, state, sent.marginals):
            return True, _counts_safe(found, sent, log)
    if sent.before is None and executor.settings.torque_rate_limit:
        found.unchecked += 1
        return False, True
    found.different += 1
    if not found.first_difference:
        iteration, policy = sent.policies[0]
        wanted = policy.control(executor.inputs(policy.policy, sent.states[0]), sent.stamp)
        expected = limiter.limited(wanted, sent.stamp)
        joint = int(np.argmax(sent.torques != expected))
        found.first_difference = (
            f"At {sent.stamp * 1e-9:.3f} s the torque of {names[joint]} is "
            f"{float(sent.torques[joint])!r} N·m, but the policy of iteration {iteration} gives "
            f"{float(expected[joint])!r} N·m (without noise)."
        )
    return False, True


def _counts_safe(found: TorqueCheck, sent: _Sent, log: ExecutorLog) -> bool:
    """Counts torques of the safe action by what explains them; returns whether they answer."""
    before = sent.before
    repeats = before is not None and before.stamp == sent.stamp and not before.is_last
    if log.has_fault(sent.received):
        found.safe += 1
        return True
    if repeats and not sent.torques.any() and log.has_ended(sent.received):
        found.last += 1
        return False
    found.unexplained += 1
    found.first_difference = found.first_difference or (
        f"At {sent.stamp * 1e-9:.3f} s the torques are {sent.torques.tolist()} N·m as of the safe "
        "action, but the executor's diagnostics do not say that it drove."
    )
    return True


def _agreement(
    torques: Array, expected: Array, policy: ExecutedPolicy, seed: int | None, *, is_old: bool
) -> str:
    """Returns how recorded torques agree with the policy's, as the name of a count; empty if not.

    Args:
        torques: the recorded torques.
        expected: those of the policy, within the limits.
        policy: the policy.
        seed: of the noise in them; None without noise.
        is_old: whether the executor was one that computed torques by BLAS.
    """
    if np.array_equal(torques, expected):
        return "deterministic" if seed is None else "stochastic"
    is_onnx = isinstance(policy.policy, OnnxPolicy)
    allowed = onnx_policy.TOLERANCE if is_onnx else TOLERANCE if is_old else 0.0
    allowed *= max(1.0, float(np.abs(expected).max()))
    if not (np.abs(torques - expected) <= allowed).all():
        return ""
    return "close" if is_onnx else "rounded"


def _policies(bag: BagReader, executor: RecordedExecutor, joints: list[str]) -> Timeline:
    """Reads the policies that the executor could use, each with its iteration."""
    timeline = Timeline()
    for received, message in policy_messages(bag, refused=[]):
        policy: Policy
        with suppress(InvalidInputError):  # of which it kept the one before
            if (content := onnx_content(message)) is None:
                iteration, policy = message.iteration, executor.named(learned_policy(message))
            else:
                iteration, policy = 0, recorded_policies.onnx_policy(content, joints)
            executor.check_fits(policy)
            timeline.add(received, (iteration, ExecutedPolicy(policy)))
    if not timeline.values:
        raise InvalidInputError(
            f"'{bag.path}' has no policy that its robot could use; record a run with a policy."
        )
    return timeline


def _marginals(bag: BagReader, executor: RecordedExecutor) -> Timeline:
    """Reads the training marginals that the executor had, if its safe action needs them."""
    timeline, latest = Timeline(), dict[int, TrainingMarginals]()
    topic = bag.filled_topics.get("trajectory_distribution")
    if executor.settings.safe_action == "feedback" and topic:
        for received, message in bag.decoded(topic):
            q = distribution_from_msg(message)
            latest[message.trajectory_index] = executor.marginals(q)
            timeline.add(received, tuple(latest.values()))
    return timeline
