# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Computes the controls of a bag again, from its states, contexts and policies."""

from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from vgps_ros.bags.episode import GAP, Stamped
from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.recorded_nodes import (
    ONNX,
    RecordedExecutor,
    Timeline,
    learned_policy,
    onnx_content,
    policy_messages,
)
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import NO_CONTEXT
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import check_robot, distribution_from_msg
from vgps_ros.messages.names import COMMANDS_SENT, IS_ACTIVE, POSE, SAFE_ACTION
from vgps_ros.policies.onnx_policy import TOLERANCE, OnnxPolicy
from vgps_ros.policies.policy_file import PolicyFile
from vgps_ros.robot.executed_control import FORGOTTEN, ExecutedPolicy, Policy
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.storage.run_folder import policy_digest


@dataclass
class BagCheck:
    """The outcome of a check.

    Attributes:
        proved: what was computed again and agrees, and how much of it.
        wrong: a sentence on each kind of thing that differs, or is damaged.
        missing: a sentence on each kind of thing without which something could not be computed.
        unproved: what nothing in the bag proves.
        counts: the controls by what they agree with, for the user.
    """

    proved: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unproved: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def prove(self, words: str, agreeing: int, total: int, kind: str) -> None:
        """Records the number of matches of a kind, if there are any."""
        if agreeing > 0:
            self.proved.append(f"{words} {agreeing} of {total} {kind}".lstrip())

    def blame(self, sentences: list[str], words: str, where: list[str] | None = None) -> None:
        """Notes how many things are wrong, or missing, and the sentence on the first, if any is."""
        if sentences:
            noted = f"{len(sentences)} {words}: {sentences[0].rstrip('.')}"
            (self.wrong if where is None else where).append(noted)


def check_controls(
    bag: BagReader,
    executor: RecordedExecutor,
    trusted: PolicyFile | None,
    recorded: tuple[list[Stamped], list[Stamped], list[Stamped]],
    found: BagCheck,
) -> None:
    """Computes the controls again, from states, commands and contexts in the order of receipt.

    Raises:
        InvalidInputError: the bag has no policy that its robot could use.
    """
    states, commands, contexts = recorded
    names = executor.signals.names
    by_stamp: dict[int, Timeline] = defaultdict(Timeline)
    told: dict[int, Timeline] = defaultdict(Timeline)
    for values_of, those in ((by_stamp, states), (told, contexts)):
        for each in those:
            values_of[each.stamp].add(each.received, each.values)
    check = _ControlCheck(bag, executor, _policies(bag, executor, trusted, found))
    different, counts = list[str](), found.counts
    for command in commands:
        around = told[command.stamp].around(command.received) if names else [NO_CONTEXT]
        answered = list(product(by_stamp[command.stamp].around(command.received), around))
        kind, sentence = check.kind_of(command, answered)
        counts[kind] += 1
        different += [sentence] if sentence else []
    found.prove("", sum(counts[kind] for kind in AGREEING), len(commands), "controls")
    found.blame(different, "controls are not what the policy gives for their states")
    if counts["posed"]:
        found.unproved.append(f"{counts['posed']} controls of standing up, holding or sitting down")
    for kind, words in {
        "stateless": "controls answer states that are not in the bag"
        + ", or whose context is not" * bool(names),
        "first": "controls are the first under a torque_rate_limit, so that none before is known",
        "remembering": "controls depend on steps that are not in the bag, which a policy remembers",
    }.items():
        if counts[kind]:
            found.missing.append(f"{counts[kind]} {words}")


# Kinds of controls that were computed again, with what they are.
AGREEING = {
    "mean": "controls are bit for bit what the policy gives for their states, without noise.",
    "noisy": "controls are bit for bit what the policy gives, with the noise of the seed.",
    "close": "controls are those of an ONNX policy within its rounding.",
    "safe": "controls are those of the safe action, or zero, while the policy did not drive.",
}


class _ControlCheck:
    """Computes controls again."""

    def __init__(self, bag: BagReader, executor: RecordedExecutor, policies: Timeline):
        self._executor = executor
        self._log = _executor_log(bag)
        self._policies = policies
        self._marginals = _marginals(bag, executor)
        # Steps after which a policy remembers none from before the bag but by its actions.
        steps = max((policy.steps for _, policy in self._policies.values), default=0)
        self._steps = 1 + steps if steps else 0
        self._is_first = True
        # Steps whose answers may depend on steps that are not in the bag, and the newest stamp.
        self._unsure, self._stamp, self._is_limited = 0, -1, False

    def kind_of(self, command: Stamped, states: list[tuple[Array, Array]]) -> tuple[str, str]:
        """Returns what recorded controls are, and a sentence if they are wrong.

        They may answer the states, each of which has its context, the likeliest first.
        """
        limiter = self._executor.limiter
        control = command.values
        if command.stamp != self._stamp:
            is_next = 0 < command.stamp - self._stamp <= GAP * self._executor.period
            self._unsure = max(0, self._unsure - (not self._is_limited))
            if self._stamp < 0 or not is_next or not states:
                self._unsure = self._steps
            self._stamp = command.stamp
        kind, sentence = "stateless", ""
        if states:
            kind, sentence, control = self._compared(command, states)
        self._is_first = False
        if kind == "safe":
            limiter.note_safe(control)
        else:
            self._executor.drove()
            limiter.note(control, command.stamp)
        return kind, sentence

    def _compared(
        self, command: Stamped, states: list[tuple[Array, Array]]
    ) -> tuple[str, str, Array]:
        """Returns the same, and the control as the executor had it before it sent it."""
        executor, control = self._executor, command.values
        # Even the first policy may be recorded late, since it was published long before.
        policies = self._policies.around(command.received) or self._policies.values[:1]
        tries = [
            (state, iteration, policy, seed)
            for state in states
            for iteration, policy in policies
            for seed in executor.seeds
        ]
        for state, iteration, policy, seed in reversed(tries):  # noqa: B007
            inputs = executor.inputs(policy.policy, *state)
            kept = policy.remembered
            for memory in (kept, FORGOTTEN) if policy.steps else (kept,):
                policy.remembered = memory  # or none, as after an activation
                wanted = policy.control(inputs, command.stamp, seed)
                expected = executor.limiter.limited(wanted, command.stamp, state[0])
                if kind := self._agreement(control, expected, policy, seed):
                    if memory is FORGOTTEN:
                        self._unsure = 0  # it began here
                    return kind, "", expected if kind in ("mean", "noisy") else control
            policy.remembered = kept
            policy.control(inputs, command.stamp, seed)
        marginals = self._marginals.around(command.received) or [()]
        may_be_safe = any(executor.is_safe(control, x, marginals, z) for x, z in states)
        instead = self._log.around(command.received)
        if may_be_safe and any(instead):
            return "safe", "", control
        if any(isinstance(words, str) and words for words in instead):
            return "posed", "", control
        if self._is_first and executor.settings.torque_rate_limit:
            return "first", "", control
        if self._unsure and self._recalled(policy, inputs, command, state[0]):
            return "remembering", "", control
        sent, due = executor.controls.at_joints(control), executor.controls.at_joints(expected)
        joint = int(np.argmax(control != expected))
        what = f"{executor.controls.kinds[joint]} of {executor.controls.names[joint]}"
        said = " The diagnostics do not say that the safe action drove." if may_be_safe else ""
        return (
            "different",
            (
                f"at {command.stamp * 1e-9:.3f} s the {what} is {float(sent[joint])!r}, but the "
                f"policy of iteration {iteration} gives {float(due[joint])!r}.{said}"
            ).rstrip("."),
            control,
        )

    def _recalled(
        self, policy: ExecutedPolicy, inputs: Array, command: Stamped, state: Array
    ) -> bool:
        """Lets a policy remember the action that a control tells, and what it reads of the state.

        Returns False where it remembers nothing. Of a control at a limit, what it tells is wrong.
        """
        if not policy.steps:
            return False
        control, limited = command.values, self._executor.limiter.limited
        around = 1e-6 * np.maximum(1.0, np.abs(control))
        self._is_limited = not all(
            np.allclose(limited(each, command.stamp, state), each, rtol=0.0, atol=1e-9)
            for each in (control - around, control + around)
        )
        policy.recall(control, inputs)
        return True

    def _agreement(
        self, control: Array, expected: Array, policy: ExecutedPolicy, seed: int | None
    ) -> str:
        """Returns how a recorded control agrees with the policy's; "" if it does not."""
        if self._executor.agrees(control, expected):
            return "mean" if seed is None else "noisy"
        allowed = TOLERANCE * max(1.0, float(np.abs(expected).max()))
        is_onnx = isinstance(policy.policy, OnnxPolicy)
        return "close" if is_onnx and (np.abs(control - expected) <= allowed).all() else ""


def _executor_log(bag: BagReader) -> Timeline:
    """Reads what the robot did where the policy did not drive, or True if nothing says what."""
    log = Timeline()
    topic = bag.filled_topics.get("diagnostics")
    for received, message in bag.decoded(topic) if topic else ():
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            # All robots of a domain share the topic.
            if COMMANDS_SENT in values and bag.of_robot([status.name]):
                drove = values.get(IS_ACTIVE) == "True" and values.get(SAFE_ACTION) == "False"
                log.add(received, not drove or values.get(POSE, ""))
    return log


def _policies(
    bag: BagReader, executor: RecordedExecutor, trusted: PolicyFile | None, found: BagCheck
) -> Timeline:
    """Reads the policies that the executor could use, each with its iteration."""
    timeline, refused, same = Timeline(), list[str](), 0
    wanted = policy_digest(trusted.gaussian) if trusted and trusted.gaussian else ""
    for received, message in policy_messages(bag, refused):
        content, policy = onnx_content(message), None
        if content is None:
            try:
                policy = learned_policy(message)
            except InvalidInputError as error:
                refused.append(str(error))
                continue
            same += policy_digest(policy) == wanted
        elif trusted:
            same += content == trusted.content
        with suppress(InvalidInputError):  # of which it kept the one before
            usable: Policy
            if policy:
                check_robot("The policy", message.robot, executor.robot)
                usable = executor.remembering_policy(policy)
            else:
                usable = OnnxPolicy(content or b"", f"The message on {ONNX}", executor.controls)
            executor.check_fits(usable)
            iteration = message.iteration if policy else 0
            timeline.add(received, (iteration, ExecutedPolicy(usable)))
    found.blame(refused, "policies cannot be read; of the first one")
    if same:
        found.proved.append(f"{same} policies by the file")
    elif trusted:
        found.unproved.append("the policies, of which none is the file's")
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
            with suppress(InvalidInputError):  # of which it kept the one before
                check_robot("The distribution", message.mean.robot, executor.robot)
                q = distribution_from_msg(message)
                latest[message.trajectory_index] = executor.marginals(q)
                timeline.add(received, tuple(latest.values()))
    return timeline
