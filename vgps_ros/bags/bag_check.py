# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks a bag by computing again what can be computed from its own content.

- Torques: from each recorded state and policy, within the executor's recorded limits. Ours have the
  same bits on every machine; those of an ONNX policy depend on the machine and agree within
  `onnx_policy.TOLERANCE`. Torques of the safe action count where the diagnostics say that it drove.
- States: in lock-step, x' = f(x, u) from each recorded state and torque, by MuJoCo and the recorded
  MJCF, within `STATE_TOLERANCE`: another processor or version of MuJoCo rounds otherwise.
- Contexts: the clock that the executor told its policy in each state, and the commands'
  ranges. Torques are computed with the recorded context.
- Commands in contexts: each is one that was recorded on `cmd_vel` or `command`, within its range,
  and was the newest within `COMMAND_WINDOW` of the answer; or at rest, where none was fresh.
- Policies: by the digests that their learner published, each of which holds the one before.
- Files: by the digests in `SHA256SUMS`.

What is missing is named, but is not called wrong: a recorder may have been paused, and may have
lost messages. A torque answers the state that has the same stamp. The topics reach a recorder
independently, so the bag may hold a state or a policy somewhat later than the torque that was
computed from it.
"""

from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from vgps_ros.bags.episode import GAP, recorded_states
from vgps_ros.bags.metadata import check_digests
from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.recorded_nodes import (
    SLACK,
    RecordedExecutor,
    Timeline,
    learned_policy,
    onnx_content,
    onnx_policy,
    policy_messages,
)
from vgps_ros.core.checks import quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.executed_control import FORGOTTEN, ExecutedPolicy, Policy
from vgps_ros.core.observation import NO_CONTEXT
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import (
    command_from_msg,
    commands_from_twist,
    distribution_from_msg,
    nanoseconds,
    signals_from_msg,
)
from vgps_ros.messages.names import (
    CMD_VEL,
    COMMAND,
    COMMANDS_SENT,
    CONTEXT,
    IS_ACTIVE,
    POSE,
    SAFE_ACTION,
)
from vgps_ros.messages.robot_state import IMU, JOINTS, ODOMETRY, StateMessages
from vgps_ros.policies.onnx_policy import TOLERANCE, OnnxPolicy
from vgps_ros.policies.policy_file import PolicyFile, policy_digest
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import compile_model, state_names

STATE_TOLERANCE = 1e-6  # between states, for each number relative to it where it is above 1
# What no recomputation proves, in the last sentence of a check.
UNPROVED = (
    "when, where and by whom it was recorded, the commit, and the costs of the training; a "
    "simulation that was computed elsewhere would pass too"
)
# Time between an answer and a command's receipt by which the recorder and the executor may have
# received them in another order [ns].
COMMAND_WINDOW = 250_000_000
_SHARE_OF_TIMEOUT = 0.4  # what of a command's timeout that may be at most
_PAUSE = 2 * 10**9  # no context for so long: the recorder may have missed commands, too [ns]
_CLOCK_TOLERANCE = 1e-9  # of a sine or cosine
# Versions whose executors did not count their commands computed torques by BLAS.
_OLD_TOLERANCE = 1e-9


@dataclass
class BagCheck:
    """The outcome of a check.

    Attributes:
        proved: what was computed again and agrees, and how much of it.
        wrong: a sentence on each kind of thing that differs, or is damaged.
        missing: a sentence on each kind of thing without which something could not be computed.
        unproved: what nothing in the bag proves.
        counts: the torques by what they agree with, for the user.
    """

    proved: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unproved: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)


class _State(NamedTuple):
    received: int  # [ns]
    stamp: int  # [ns]
    x: Array


class _Context(NamedTuple):
    received: int  # [ns]
    stamp: int  # of the state [ns]
    z: Array  # commands and clock


class _Command(NamedTuple):
    received: int  # [ns]
    stamp: int  # [ns]
    control: Array


def check_bag(
    path: Path, trusted: PolicyFile | None = None, namespace: str | None = None
) -> BagCheck:
    """Checks a whole bag.

    Args:
        path: folder of the bag.
        trusted: a policy that the executor was started with; None if all came from a learner.
        namespace: of the robot that is meant, for a bag of several.

    Raises:
        InvalidInputError: the bag cannot be read, or lacks a topic.
    """
    found = BagCheck()
    with BagReader(path, namespace) as bag:
        found.wrong += bag.damages
        model = compile_model(bag.mjcf())
        executor = RecordedExecutor(bag, model)
        states = _states(bag, executor, found)
        commands = _commands(bag, executor, found)
        contexts = _contexts(bag, executor, found)
        answered = sorted([*states, *_measured(bag, executor)], key=attrgetter("received"))
        _check_torques(bag, executor, answered, commands, contexts, found)
        period = _check_gaps(states, found)
        _check_contexts(executor, contexts, found)
        _check_commands(bag, executor, contexts, found)
        if executor.is_in_lock_step and period:
            _check_states(bag, executor, model, states, commands, period, found)
        else:
            found.unproved.append("the states, which no simulation in lock-step computed")
        _check_policies(bag, trusted, found)
    digests = check_digests(path)
    found.wrong += digests or []
    if digests is None:
        found.unproved.append("the files, which have no SHA256SUMS")
    elif not digests:
        found.proved.append("the digest of each file")
    return found


def _states(bag: BagReader, executor: RecordedExecutor, found: BagCheck) -> list[_State]:
    """Reads the states of which all messages have one stamp, in the order of their receipt."""
    messages_of = StateMessages(executor.model, **executor.frames)
    states, unusable = list[_State](), 0
    if executor.is_measured and not messages_of.topics.keys() <= bag.filled_topics.keys():
        return states  # of a robot without odometry
    for received, messages in recorded_states(bag, messages_of):
        try:
            stamp = nanoseconds(messages[JOINTS].header.stamp)
            states.append(_State(received, stamp, messages_of.join(messages)))
        except InvalidInputError:  # noqa: PERF203
            unusable += 1
    if unusable:
        found.missing.append(f"{unusable} states cannot be used")
    return states


def _measured(bag: BagReader, executor: RecordedExecutor) -> Iterator[_State]:
    """Yields the states that the executor may have joined of messages with stamps of their own.

    Which `imu` or `odom` was the newest, no message says. Those within the executor's tolerance of
    the stamp of `joint_states` are few, and only the right one gives the torques bit for bit.
    """
    model = executor.model
    for is_blind, base in ((True, IMU), (False, ODOMETRY)):
        messages_of = StateMessages(model, is_blind=is_blind, **executor.frames)
        if messages_of.sources.keys() != {base, JOINTS} or base not in bag.filled_topics:
            continue
        if base == ODOMETRY and not executor.is_measured:
            continue  # these states are known
        topics = {bag.needed_topic(name): name for name in (base, JOINTS)}
        recorded: dict[str, list[tuple[int, int, Any]]] = {name: [] for name in topics.values()}
        for message in bag.messages(list(topics)):
            decoded = bag.decode(message)
            stamp = nanoseconds(decoded.header.stamp)
            recorded[topics[message.topic]].append((stamp, message.stamp, decoded))
        of_base = sorted(recorded[base], key=itemgetter(0))
        stamps = [stamp for stamp, *_ in of_base]
        for stamp, received, joints in recorded[JOINTS]:
            first = bisect_left(stamps, stamp - executor.tolerance)
            last = bisect_right(stamps, stamp + executor.tolerance)
            for _, _, message in of_base[first:last]:
                with suppress(InvalidInputError):
                    x = messages_of.join({base: message, JOINTS: joints})
                    yield _State(received, stamp, x)


def _commands(bag: BagReader, executor: RecordedExecutor, found: BagCheck) -> list[_Command]:
    """Reads the commands in the order in which they were received."""
    commands, refused = [], list[str]()
    for received, message in bag.decoded(bag.needed_topic("joint_command"), refused=refused):
        stamp = nanoseconds(message.header.stamp)
        try:
            commands.append(_Command(received, stamp, command_from_msg(message, executor.controls)))
        except InvalidInputError as error:
            refused.append(f"At {stamp * 1e-9:.3f} s, {error}")
    if refused:
        found.wrong.append(_unreadable("commands", refused))
    return commands


def _contexts(bag: BagReader, executor: RecordedExecutor, found: BagCheck) -> list[_Context]:
    """Reads what the executor told its policy in each state, in the order of receipt."""
    names, contexts, refused = executor.signals.names, list[_Context](), list[str]()
    topic = bag.filled_topics.get(CONTEXT)
    if not names or topic is None:
        return contexts
    for received, message in bag.decoded(topic, refused=refused):
        stamp = nanoseconds(message.header.stamp)
        try:
            values = signals_from_msg(message)
            if tuple(values) != names:
                raise InvalidInputError(f"it tells {quoted(list(values))}, not {list(names)}.")
            contexts.append(_Context(received, stamp, np.array(list(values.values()))))
        except InvalidInputError as error:
            refused.append(f"At {stamp * 1e-9:.3f} s, {error}")
    if refused:
        found.wrong.append(_unreadable("contexts", refused))
    return contexts


def _check_contexts(executor: RecordedExecutor, contexts: list[_Context], found: BagCheck) -> None:
    """Computes the clock of each state again, and checks the commands' ranges."""
    signals = executor.signals
    commands = signals.commands
    different = list[str]()
    for each in contexts:
        told = each.z[: len(commands)]
        sentence = ""
        for command, value in zip(commands, told.tolist(), strict=True):
            if not command.lowest <= value <= command.highest:
                sentence = f"{command.name} is {value:g}, which its range does not hold"
        expected = signals.context(told, np.array(signals.phase_at(each.stamp)))
        if not sentence and not np.allclose(each.z, expected, rtol=0.0, atol=_CLOCK_TOLERANCE):
            clock = slice(len(commands), None)
            sentence = f"the clock is {each.z[clock].tolist()}, not {expected[clock].tolist()}"
        if sentence:
            different.append(f"at {each.stamp * 1e-9:.3f} s {sentence}")
    if agreeing := len(contexts) - len(different):
        found.proved.append(f"{agreeing} of {len(contexts)} contexts")
    if different:
        words = f"{len(different)} contexts are none that the executor tells"
        found.wrong.append(f"{words}: {different[0]}")


class _Given:
    """The values of one command as a bag holds them.

    Args:
        rest: the value where nothing is commanded.
        timeouts: after which the executor may have let a command rest [s]; empty: unknown.
    """

    def __init__(self, rest: float, timeouts: Sequence[float]):
        self._rest = rest
        self._received, self._values = list[int](), list[float]()  # times in [ns]
        self._longest = 1e9 * max(timeouts, default=np.inf)
        self._shortest = 1e9 * min(timeouts, default=0.0)

    def add(self, received: int, value: float) -> None:
        """Adds a value that came after all others at a time [ns]."""
        self._received.append(received)
        self._values.append(value)

    def between(self, first: float, last: float) -> list[float]:
        """Returns the values that were received between two times [ns]."""
        return self._values[bisect_left(self._received, first) : bisect_right(self._received, last)]

    def around(self, time: int) -> set[float]:
        """Returns the values that an executor may have used at a time [ns]."""
        newest = bisect_right(self._received, time - COMMAND_WINDOW) - 1
        begin = self._received[newest] if newest >= 0 else 0
        oldest = time - self._longest - COMMAND_WINDOW
        found = set(self.between(max(begin, oldest), time + COMMAND_WINDOW))
        slack = min(COMMAND_WINDOW, _SHARE_OF_TIMEOUT * self._shortest)
        if newest < 0 or not self.between(time - self._shortest + slack, time - slack):
            found.add(self._rest)
        return found


def _check_commands(
    bag: BagReader, executor: RecordedExecutor, contexts: list[_Context], found: BagCheck
) -> None:
    """Compares the commands in contexts with those that the executor was given."""
    signals, parameters = executor.signals, executor.parameters
    if not (signals.commands and contexts):
        return
    is_simulated = True in parameters.values(executor.node, "use_sim_time")
    timeouts = [] if is_simulated else parameters.values(executor.node, "command_timeout")
    given = [_Given(rest, timeouts) for rest in signals.rest.tolist()]
    topics = [bag.filled_topics[name] for name in (CMD_VEL, COMMAND) if name in bag.filled_topics]
    base_frame = StateMessages(executor.model, **executor.frames).base_frame
    for received, message in bag.decoded(*topics, refused=[]) if topics else ():
        with suppress(InvalidInputError):  # which the executor refused, too
            told = (
                signals_from_msg(message)
                if hasattr(message, "names")
                else commands_from_twist(message, signals.commands, base_frame)
            )
            for i, value in signals.clamped(told)[0].items():
                given[i].add(received, value)
    agreeing, missed, different = 0, 0, list[str]()
    begin = latest = contexts[0].received
    for each in contexts:
        begin, latest = each.received if each.received - latest > _PAUSE else begin, each.received
        sentence, is_missed = "", False
        for command, own, value in zip(signals.commands, given, each.z.tolist(), strict=False):
            if value in (values := own.around(each.received)):
                continue
            if own.between(begin - COMMAND_WINDOW, each.received + COMMAND_WINDOW):
                sentence = f"{command.name} is {value:g}, but it was {quoted(sorted(values))}"
            else:
                is_missed = True
        if sentence:
            different.append(f"at {each.stamp * 1e-9:.3f} s {sentence}")
        missed += is_missed and not sentence
        agreeing += not (is_missed or sentence)
    if agreeing:
        found.proved.append(f"the commands of {agreeing} of {len(contexts)} contexts")
    if different:
        found.wrong.append(f"{len(different)} contexts tell what nobody commanded: {different[0]}")
    if missed:
        found.missing.append(f"{missed} contexts tell commands that are not in the bag")
    if not timeouts:
        found.unproved.append("which commands were too old, by a clock that was simulated")


def _unreadable(kind: str, sentences: list[str]) -> str:
    return f"{len(sentences)} {kind} cannot be read; of the first one: {sentences[0].rstrip('.')}"


# Torques


def _check_torques(
    bag: BagReader,
    executor: RecordedExecutor,
    states: list[_State],
    commands: list[_Command],
    contexts: list[_Context],
    found: BagCheck,
) -> None:
    by_stamp: dict[int, Timeline] = defaultdict(Timeline)
    told: dict[int, Timeline] = defaultdict(Timeline)
    for state in states:
        by_stamp[state.stamp].add(state.received, state.x)
    for context in contexts:
        told[context.stamp].add(context.received, context.z)
    check = _TorqueCheck(bag, executor)
    first = ""
    counts = found.counts
    for command in commands:
        answered = [
            (x, z)
            for x in by_stamp[command.stamp].around(command.received)
            for z in (
                told[command.stamp].around(command.received)
                if executor.signals.names
                else [NO_CONTEXT]
            )
        ]
        kind, sentence = check.kind_of(command, answered)
        counts[kind] += 1
        first = first or sentence
    agreeing = sum(counts[kind] for kind in AGREEING)
    if agreeing:
        found.proved.append(f"{agreeing} of {len(commands)} torques")
    if counts["different"]:
        words = f"{counts['different']} torques are not what the policy gives for their states"
        found.wrong.append(f"{words}: {first}")
    if counts["posed"]:
        found.unproved.append(f"{counts['posed']} torques of standing up, holding or sitting down")
    for kind, words in (
        (
            "stateless",
            "torques answer states that are not in the bag"
            + ", or whose context is not" * bool(executor.signals.names),
        ),
        ("first", "torques are the first under a torque_rate_limit, so that none before is known"),
        (
            "remembering",
            "torques depend on steps that are not in the bag, which a policy remembers",
        ),
        ("unsaid", "torques may be of the safe action, of which this version says nothing"),
    ):
        if counts[kind]:
            found.missing.append(f"{counts[kind]} {words}")


# Kinds of torques that were computed again, with what they are.
AGREEING = {
    "mean": "torques are bit for bit what the policy gives for their states, without noise.",
    "noisy": "torques are bit for bit what the policy gives, with the noise of the seed.",
    "close": "torques are those of an ONNX policy within its rounding.",
    "rounded": "torques of an old version agree within its rounding.",
    "safe": "torques are those of the safe action, or zero, while the policy did not drive.",
}


class _TorqueCheck:
    """Computes torques again."""

    def __init__(self, bag: BagReader, executor: RecordedExecutor):
        self._executor = executor
        self._names = list(executor.controls.names)
        self._log = _executor_log(bag)
        self._policies = _policies(bag, executor)
        self._marginals = _marginals(bag, executor)
        # Steps after which a policy remembers none from before the bag but by its actions.
        steps = max((policy.steps for _, policy in self._policies.values), default=0)
        self._steps = 1 + steps if steps else 0
        self._is_first = True
        # Steps whose answers may depend on steps that are not in the bag, and the newest stamp.
        self._unsure, self._stamp, self._is_limited = 0, -1, False

    def kind_of(self, command: _Command, states: list[tuple[Array, Array]]) -> tuple[str, str]:
        """Returns what recorded torques are, and a sentence if they are wrong.

        Args:
            command: the torques.
            states: the states that they may answer, each with its context, the likeliest first.
        """
        limiter = self._executor.limiter
        control = command.control
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
        self, command: _Command, states: list[tuple[Array, Array]]
    ) -> tuple[str, str, Array]:
        """Returns the same, and the control as the executor had it before it sent it."""
        executor, control = self._executor, command.control
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
                    return kind, "", expected if kind in ("mean", "noisy") else control
            policy.remembered = kept
            policy.control(inputs, command.stamp, seed)
        marginals = self._marginals.around(command.received) or [()]
        may_be_safe = any(executor.is_safe(control, x, marginals, z) for x, z in states)
        if may_be_safe and (is_said := self._did_not_drive(command.received)) is not False:
            return ("safe" if is_said else "unsaid"), "", control
        if self._log and any(isinstance(w, str) and w for w in self._log.around(command.received)):
            return "posed", "", control
        if self._is_first and executor.settings.torque_rate_limit:
            return "first", "", control
        if self._unsure and self._recalled(policy, inputs, command, state[0]):
            return "remembering", "", control
        sent, due = executor.controls.at_joints(control), executor.controls.at_joints(expected)
        joint = int(np.argmax(control != expected))
        said = " The diagnostics do not say that the safe action drove." if may_be_safe else ""
        return (
            "different",
            (
                f"at {command.stamp * 1e-9:.3f} s the {executor.controls.kinds[joint]} of "
                f"{self._names[joint]} is {float(sent[joint])!r}, but the policy of iteration "
                f"{iteration} gives {float(due[joint])!r}.{said}"
            ).rstrip("."),
            control,
        )

    def _recalled(
        self, policy: ExecutedPolicy, inputs: Array, command: _Command, state: Array
    ) -> bool:
        """Lets a policy remember the action that a control tells, and what it reads of the state.

        Returns False where it remembers nothing. Of a control at a limit, what it tells is wrong.
        """
        if not policy.steps:
            return False
        control, limited = command.control, self._executor.limiter.limited
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
        is_onnx = isinstance(policy.policy, OnnxPolicy)
        allowed = TOLERANCE if is_onnx else 0.0 if self._log else _OLD_TOLERANCE
        allowed *= max(1.0, float(np.abs(expected).max()))
        if not (np.abs(control - expected) <= allowed).all():
            return ""
        return "close" if is_onnx else "rounded"

    def _did_not_drive(self, time: int) -> bool | None:
        """Returns whether the executor says that the policy may not have driven at a time [ns].

        None is returned of a version that does not say so.
        """
        said = self._log.around(time) if self._log else [None]
        return None if None in said else any(said)


def _executor_log(bag: BagReader) -> Timeline | None:
    """Reads whether the policy did not drive, or what the robot did instead, as it was said.

    None stands for that of an old version.
    """
    log = Timeline()
    topic = bag.filled_topics.get("diagnostics")
    for received, message in bag.decoded(topic) if topic else ():
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            # All robots of a domain share the topic.
            if COMMANDS_SENT in values and bag.of_robot([status.name]):
                is_said = SAFE_ACTION in values
                drove = values.get(IS_ACTIVE) == "True" and values.get(SAFE_ACTION) == "False"
                log.add(received, (not drove or values.get(POSE, "")) if is_said else None)
    return log if log.values else None


def _policies(bag: BagReader, executor: RecordedExecutor) -> Timeline:
    """Reads the policies that the executor could use, each with its iteration."""
    timeline = Timeline()
    for received, message in policy_messages(bag, refused=[]):
        policy: Policy
        with suppress(InvalidInputError):  # of which it kept the one before
            if (content := onnx_content(message)) is None:
                iteration, policy = message.iteration, executor.learned(learned_policy(message))
            else:
                iteration, policy = 0, onnx_policy(content, executor.controls)
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


# States


def _check_gaps(states: list[_State], found: BagCheck) -> int:
    """Names the stretches in which states are missing; returns the period of the states [ns]."""
    steps = [(a, b) for a, b in pairwise(states) if b.stamp > a.stamp]
    period = round(np.median([b.stamp - a.stamp for a, b in steps])) if steps else 0
    for a, b in steps:
        if b.stamp - a.stamp > GAP * period:
            count = round((b.stamp - a.stamp) / period) - 1
            found.missing.append(
                f"{count} states from {a.stamp * 1e-9:.3f} to {b.stamp * 1e-9:.3f} s are not in "
                "the bag: they were not recorded, or were cut out"
            )
    return period


def _check_states(
    bag: BagReader,
    executor: RecordedExecutor,
    model: mujoco.MjModel,
    states: list[_State],
    commands: list[_Command],
    period: int,
    found: BagCheck,
) -> None:
    dynamics = Dynamics(model, max(1, round(period * 1e-9 / model.opt.timestep)), threads=1)
    torques: dict[int, list[_Command]] = defaultdict(list)
    for command in commands:
        torques[command.stamp].append(command)
    pushed = _pushed(bag, executor, states)
    agreeing = different = unanswered = excused = 0
    first = ""
    before: list[_State] = []  # states of one stamp: a paused simulation repeats its state
    for state in states:
        if not before or state.stamp == before[-1].stamp:
            before = [*before[-9:], state]
            continue
        previous, before = before, [state]
        if abs(state.stamp - previous[-1].stamp - period) > 2:
            continue  # a reset, or a gap
        begin, end = previous[0].received - SLACK, state.received + SLACK
        answers = [c for c in torques[previous[-1].stamp] if begin <= c.received <= end]
        differences = [
            (dynamics.step(one.x, answer.control) - state.x) / np.maximum(1.0, np.abs(state.x))
            for one in reversed(previous)
            for answer in answers
        ]
        if any((np.abs(difference) <= STATE_TOLERANCE).all() for difference in differences):
            agreeing += 1
        elif any(a <= previous[-1].stamp <= b for a, b in pushed):
            excused += 1
        elif not differences:
            unanswered += 1
        else:
            different += 1
            worst = int(np.argmax(np.abs(differences[0])))
            first = first or (
                f"at {state.stamp * 1e-9:.3f} s {state_names(model)[worst]} is "
                f"{float(state.x[worst])!r}, which is off by "
                f"{float(np.abs(differences[0][worst])):.2g}"
            )
    total = agreeing + excused + unanswered + different
    if agreeing:
        found.proved.append(f"{agreeing} of {total} steps from state to state")
    if different:
        found.wrong.append(
            f"{different} states do not follow from the state and the torque before them: {first}"
        )
    if unanswered:
        found.missing.append(f"{unanswered} states lack the torque that answers them")
    if excused:
        found.unproved.append(f"{excused} steps under a push")


def _pushed(
    bag: BagReader, executor: RecordedExecutor, states: list[_State]
) -> list[tuple[int, int]]:
    """Returns the first and last stamps [ns] of the states from which a push may have acted."""
    topic = bag.filled_topics.get("push")
    _, simulated = executor.parameters.having("push_duration")
    duration = round(float(simulated.get("push_duration", 0.0)) * 1e9)
    stretches = []
    for message in bag.messages([topic] if topic else []):
        around = [s.stamp for s in states if abs(s.received - message.stamp) <= SLACK]
        if around:
            stretches.append((min(around), max(around) + duration))
    return stretches


# Policies


def _check_policies(bag: BagReader, trusted: PolicyFile | None, found: BagCheck) -> None:
    """Compares each policy with the chain of digests in `learning_progress`."""
    said = _digests(bag)
    named = policy_digest(trusted.gaussian) if trusted and trusted.gaussian else ""
    refused, agreeing, unknown, total = list[str](), 0, 0, 0
    for received, message in policy_messages(bag, refused):
        total += 1
        if (content := onnx_content(message)) is not None:
            agreeing += trusted is not None and content == trusted.content
            unknown += trusted is None or content != trusted.content
            continue
        try:
            k, policy = int(message.iteration), learned_policy(message)
        except InvalidInputError as error:
            refused.append(str(error))
            continue
        own = said[message.task, k]
        digests = {policy_digest(policy, before) for _, _, before in own if before is not None}
        if digests & {digest for _, digest, _ in own} or policy_digest(policy) == named:
            agreeing += 1
        # One that a learner keeps for late subscribers may be of a training before the bag.
        elif any(b is not None and abs(time - received) <= SLACK for time, _, b in own):
            found.wrong.append(f"the policy of iteration {k} is not its learner's")
        else:
            unknown += 1
    if agreeing:
        found.proved.append(f"{agreeing} of {total + len(refused)} policies by their digests")
    if refused:
        found.wrong.append(_unreadable("policies", refused))
    if unknown:
        found.unproved.append(f"{unknown} policies, of which no learner says a digest")


def _digests(bag: BagReader) -> dict[tuple[str, int], list[tuple[int, str, str | None]]]:
    """Reads when the learner published a digest, that digest, and the one before, if it is there.

    Returns:
        The same by task and iteration; a bag may hold several trainings.
    """
    links: dict[tuple[str, int], list[tuple[int, str, str | None]]] = defaultdict(list)
    latest: dict[str, tuple[int, str]] = {}  # the newest iteration of a task, and its digest
    topic = bag.filled_topics.get("learning_progress")
    for received, message in bag.decoded(topic) if topic else ():
        digest, task, k = getattr(message, "policy_digest", ""), message.task, message.iteration
        iteration, newest = latest.get(task, (0, ""))
        before = "" if k == 1 else newest if iteration == k - 1 else None
        if digest:
            links[task, k].append((received, digest, before))
        latest[task] = (k, digest)
    return links
