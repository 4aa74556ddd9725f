# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks a bag by computing again what can be computed from its own content.

- Controls: from each recorded state and policy, within the executor's recorded limits. Ours have
  the same bits on every machine; those of an ONNX policy depend on the machine and agree within
  `onnx_policy.TOLERANCE`. Those of the safe action count where the diagnostics say that it drove.
- States: in lock-step, x' = f(x, u) from each recorded state and control, by MuJoCo and the
  recorded MJCF, within `STATE_TOLERANCE`: another processor or version of MuJoCo rounds otherwise.
- Contexts: the clock that the executor told its policy in each state. A command is at rest, or was
  received on `cmd_vel` or `command` no longer before than `command_timeout`.
- Files: by the digests in `SHA256SUMS`.

What is missing is named, but is not called wrong: a recorder may have been paused, and may have
lost messages. A control answers the state that has the same stamp. The topics reach a recorder
independently, so the bag may hold a state or a policy somewhat later than the control that was
computed from it.
"""

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from vgps_ros.bags.control_check import BagCheck, Stamped, check_controls, unreadable
from vgps_ros.bags.episode import GAP, recorded_states
from vgps_ros.bags.metadata import check_digests
from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.recorded_nodes import SLACK, RecordedExecutor, Timeline
from vgps_ros.core.checks import quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.conversions import (
    command_from_msg,
    commands_from_twist,
    nanoseconds,
    signals_from_msg,
)
from vgps_ros.messages.names import CMD_VEL, COMMAND, CONTEXT
from vgps_ros.messages.robot_state import IMU, JOINTS, ODOMETRY, StateMessages
from vgps_ros.policies.policy_file import PolicyFile
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import compile_model, state_names

STATE_TOLERANCE = 1e-6  # between states, for each number relative to it where it is above 1
# What no recomputation proves, in the last sentence of a check.
UNPROVED = (
    "when, where and by whom it was recorded, the commit, and the training of its policies; a "
    "simulation that was computed elsewhere would pass too"
)
# Time by which a bag may hold a command and the answer that used it in another order [ns].
_COMMAND_WINDOW = 250_000_000
_CLOCK_TOLERANCE = 1e-9  # of a sine or cosine


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
        check_controls(bag, executor, trusted, (answered, commands, contexts), found)
        period = _check_gaps(states, found)
        _check_contexts(bag, executor, contexts, found)
        if executor.is_in_lock_step and period:
            _check_states(bag, executor, model, states, commands, period, found)
        else:
            found.unproved.append("the states, which no simulation in lock-step computed")
    digests = check_digests(path)
    found.wrong += digests or []
    if digests is None:
        found.unproved.append("the files, which have no SHA256SUMS")
    elif not digests:
        found.proved.append("the digest of each file")
    return found


def _states(bag: BagReader, executor: RecordedExecutor, found: BagCheck) -> list[Stamped]:
    """Reads the states of which all messages have one stamp, in the order of their receipt."""
    messages_of = StateMessages(state_layout(executor.model), **executor.frames)
    states, unusable = list[Stamped](), 0
    if executor.is_measured and not messages_of.topics.keys() <= bag.filled_topics.keys():
        return states  # of a robot without odometry
    for received, messages in recorded_states(bag, messages_of):
        try:
            stamp = nanoseconds(messages[JOINTS].header.stamp)
            states.append(Stamped(received, stamp, messages_of.join(messages)))
        except InvalidInputError:  # noqa: PERF203
            unusable += 1
    if unusable:
        found.missing.append(f"{unusable} states cannot be used")
    return states


def _measured(bag: BagReader, executor: RecordedExecutor) -> Iterator[Stamped]:
    """Yields the states that the executor may have joined of messages with stamps of their own.

    Which `imu` or `odom` was the newest, no message says. Those within the executor's tolerance of
    the stamp of `joint_states` are few, and only the right one gives the controls bit for bit.
    """
    model = executor.model
    for is_blind, base in ((True, IMU), (False, ODOMETRY)):
        messages_of = StateMessages(state_layout(model), is_blind=is_blind, **executor.frames)
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
                    yield Stamped(received, stamp, x)


def _commands(bag: BagReader, executor: RecordedExecutor, found: BagCheck) -> list[Stamped]:
    """Reads the commands in the order in which they were received."""
    commands, refused = [], list[str]()
    for received, message in bag.decoded(bag.needed_topic("joint_command"), refused=refused):
        stamp = nanoseconds(message.header.stamp)
        try:
            commands.append(Stamped(received, stamp, command_from_msg(message, executor.controls)))
        except InvalidInputError as error:
            refused.append(f"At {stamp * 1e-9:.3f} s, {error}")
    if refused:
        found.wrong.append(unreadable("commands", refused))
    return commands


def _contexts(bag: BagReader, executor: RecordedExecutor, found: BagCheck) -> list[Stamped]:
    """Reads what the executor told its policy in each state, in the order of receipt."""
    names, contexts, refused = executor.signals.names, list[Stamped](), list[str]()
    topic = bag.filled_topics.get(CONTEXT)
    if not names or topic is None:
        return contexts
    for received, message in bag.decoded(topic, refused=refused):
        stamp = nanoseconds(message.header.stamp)
        try:
            values = signals_from_msg(message)
            if tuple(values) != names:
                raise InvalidInputError(f"it tells {quoted(list(values))}, not {list(names)}.")
            contexts.append(Stamped(received, stamp, np.array(list(values.values()))))
        except InvalidInputError as error:
            refused.append(f"At {stamp * 1e-9:.3f} s, {error}")
    if refused:
        found.wrong.append(unreadable("contexts", refused))
    return contexts


def _check_contexts(
    bag: BagReader, executor: RecordedExecutor, contexts: list[Stamped], found: BagCheck
) -> None:
    """Computes the clock of each state again, and looks for what was commanded."""
    signals = executor.signals
    if not contexts:
        return
    given, longest = _commanded(bag, executor), _longest_hold(executor)
    different, strange = list[str](), list[str]()
    for each in contexts:
        told, at = each.values[: len(signals.commands)], f"at {each.stamp * 1e-9:.3f} s"
        expected = signals.context(told, np.array(signals.phase_at(each.stamp)))
        if not np.allclose(each.values, expected, rtol=0.0, atol=_CLOCK_TOLERANCE):
            clock = slice(len(signals.commands), None)
            is_not = f"{each.values[clock].tolist()}, not {expected[clock].tolist()}"
            different.append(f"{at} the clock is {is_not}")
        for command, own, value in zip(signals.commands, given, told.tolist(), strict=True):
            first = bisect_left(own.received, each.received - longest)
            last = bisect_right(own.received, each.received + _COMMAND_WINDOW)
            if value not in (command.rest, *own.values[first:last]):
                strange.append(f"{at} {command.name} is {value:g}")
    if agreeing := len(contexts) - len(different):
        found.proved.append(f"the clock of {agreeing} of {len(contexts)} contexts")
    if different:
        words = f"{len(different)} contexts are none that the executor tells"
        found.wrong.append(f"{words}: {different[0]}")
    if strange:
        words = f"{len(strange)} values in contexts were not commanded in the bag"
        found.missing.append(f"{words}: {strange[0]}")


def _commanded(bag: BagReader, executor: RecordedExecutor) -> list[Timeline]:
    """Reads the values of each command that the executor took."""
    signals = executor.signals
    given = [Timeline() for _ in signals.commands]
    topics = [bag.filled_topics[name] for name in (CMD_VEL, COMMAND) if name in bag.filled_topics]
    base_frame = StateMessages(state_layout(executor.model), **executor.frames).base_frame
    for received, message in bag.decoded(*topics, refused=[]) if topics else ():
        with suppress(InvalidInputError):  # which the executor refused, too
            told = (
                signals_from_msg(message)
                if hasattr(message, "names")
                else commands_from_twist(message, signals.commands, base_frame)
            )
            for i, value in signals.clamped(told)[0].items():
                given[i].add(received, value)
    return given


def _longest_hold(executor: RecordedExecutor) -> float:
    """Returns the time for which a command may have been held [ns].

    It is not known where the executor's clock was simulated.
    """
    parameters, node = executor.parameters, executor.node
    timeouts = parameters.values(node, "command_timeout")
    if not timeouts or True in parameters.values(node, "use_sim_time"):
        return float("inf")
    return 1e9 * max(timeouts) + _COMMAND_WINDOW


def _check_gaps(states: list[Stamped], found: BagCheck) -> int:
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
    states: list[Stamped],
    commands: list[Stamped],
    period: int,
    found: BagCheck,
) -> None:
    dynamics = Dynamics(model, max(1, round(period * 1e-9 / model.opt.timestep)), threads=1)
    controls: dict[int, list[Stamped]] = defaultdict(list)
    for command in commands:
        controls[command.stamp].append(command)
    pushed = _pushed(bag, executor, states)
    agreeing = different = unanswered = excused = 0
    first = ""
    before: list[Stamped] = []  # states of one stamp: a paused simulation repeats its state
    for state in states:
        if not before or state.stamp == before[-1].stamp:
            before = [*before[-9:], state]
            continue
        previous, before = before, [state]
        if abs(state.stamp - previous[-1].stamp - period) > 2:
            continue  # a reset, or a gap
        begin, end = previous[0].received - SLACK, state.received + SLACK
        answers = [c for c in controls[previous[-1].stamp] if begin <= c.received <= end]
        scale = np.maximum(1.0, np.abs(state.values))
        differences = [
            (dynamics.step(one.values, answer.values) - state.values) / scale
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
                f"{float(state.values[worst])!r}, which is off by "
                f"{float(np.abs(differences[0][worst])):.2g}"
            )
    total = agreeing + excused + unanswered + different
    if agreeing:
        found.proved.append(f"{agreeing} of {total} steps from state to state")
    if different:
        found.wrong.append(
            f"{different} states do not follow from the state and the control before them: {first}"
        )
    if unanswered:
        found.missing.append(f"{unanswered} states lack the control that answers them")
    if excused:
        found.unproved.append(f"{excused} steps under a push")


def _pushed(
    bag: BagReader, executor: RecordedExecutor, states: list[Stamped]
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
