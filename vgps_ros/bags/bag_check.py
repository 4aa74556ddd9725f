# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks a bag by computing again what can be computed from its own content.

docs/how_to/recordings.md tells what. Controls of ours have the same bits on every machine; those of
an ONNX policy agree within `onnx_policy.TOLERANCE`. States and costs agree within tolerances below:
another processor or version of MuJoCo rounds otherwise.

What is missing is named, but is not called wrong: a recorder may have been paused, and may have
lost messages. A control answers the state that has the same stamp. The topics reach a recorder
independently, so the bag may hold a state or a policy somewhat later than the control that was
computed from it.
"""

import math
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from itertools import chain, pairwise, product
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from vgps_ros.bags.control_check import BagCheck, check_controls
from vgps_ros.bags.episode import Stamped, read_motions
from vgps_ros.bags.metadata import check_digests
from vgps_ros.bags.reader import BagReader
from vgps_ros.bags.recorded_nodes import (
    SLACK,
    RecordedExecutor,
    Timeline,
    learned_policy,
    onnx_content,
    policy_messages,
)
from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.messages.conversions import (
    command_from_msg,
    commands_from_twist,
    efforts_from_msg,
    nanoseconds,
    signals_from_msg,
    wrench_from_msg,
)
from vgps_ros.messages.names import CMD_VEL, COMMAND, CONTEXT, MJCF
from vgps_ros.messages.robot_state import IMU, JOINTS, ODOMETRY, StateMessages
from vgps_ros.policies.policy_file import PolicyFile
from vgps_ros.search.settings import search_settings
from vgps_ros.search.situations import situations
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.forces import AppliedForce, BodyFrames, JointForces
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import compile_model, joint_names, state_names
from vgps_ros.tasks.task import Task

STATE_TOLERANCE = 1e-6  # between states, for each number relative to it where it is above 1
# What no recomputation proves, in the last sentence of a check.
UNPROVED = (
    "the first state of a motion, when, where and by whom it was recorded, when and how often each "
    "message came, the noise of policies that drove without it, that commands told at rest were at "
    "rest, the commit, all other topics, and all else of the training; a simulation that was "
    "computed elsewhere would pass too"
)
# Time by which a bag may hold a command and the answer that used it in another order [ns].
_COMMAND_WINDOW = 250_000_000
_CLOCK_TOLERANCE = 1e-9  # of a sine or cosine
_ROUNDING = 2  # of a time between two stamps [ns]
_MOST_STEPS = 100_000  # of all rollouts
_NUDGE = 1e-9  # of a start, by far more than rounding
_COST_TOLERANCE = 1e-2  # a cost that the nudge changes by a larger share of it proves nothing


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
        model = compile_model(bag.mjcf())
        robots = {message.data for _, message in bag.decoded(bag.needed_topic(MJCF))}
        if len(robots) > 1:
            found.wrong.append(f"{len(robots)} different robots are on {MJCF}")
        executor = RecordedExecutor(bag, model)
        robot, motions = StateMessages(state_layout(model), **executor.frames), []
        # A real robot may have no odometry.
        if not executor.is_measured or robot.topics.keys() <= bag.filled_topics.keys():
            motions = read_motions(bag, robot, found.missing)
        states = [*chain(*motions), *_measured(bag, executor)]
        command_of = partial(command_from_msg, controls=executor.controls)
        commands = _stamped(bag, "joint_command", command_of, found)
        contexts = _contexts(bag, executor, found)
        answered = sorted(states, key=attrgetter("received"))
        check_controls(bag, executor, trusted, (answered, commands, contexts), found)
        _check_contexts(bag, executor, contexts, found)
        if executor.is_in_lock_step and executor.period:
            _check_steps(bag, executor, motions, commands, found)
        else:
            found.unproved.append("the states, which no simulation in lock-step computed")
        _check_costs(bag, executor, found)
    digests = check_digests(path)
    found.wrong += digests or []
    if digests is None:
        found.unproved.append("the files, which have no SHA256SUMS")
    elif not digests:
        found.proved.append("the digest of each file")
    return found


def _measured(bag: BagReader, executor: RecordedExecutor) -> Iterator[Stamped]:
    """Yields the states that the executor may have joined of messages with stamps of their own.

    Which `imu` or `odom` was the newest, no message says. Those within the executor's tolerance of
    the stamp of `joint_states` are few, and only the right one gives the controls bit for bit.
    """
    model = executor.model
    known = [] if executor.is_measured else [ODOMETRY]
    for is_blind, base in ((True, IMU), (False, ODOMETRY)):
        messages_of = StateMessages(state_layout(model), is_blind=is_blind, **executor.frames)
        topics = bag.filled_topics.keys() - known
        if messages_of.sources.keys() != {base, JOINTS} or base not in topics:
            continue
        of_base = [message for _, message in bag.decoded(bag.needed_topic(base))]
        of_base.sort(key=lambda message: nanoseconds(message.header.stamp))
        stamps = [nanoseconds(message.header.stamp) for message in of_base]
        for received, joints in bag.decoded(bag.needed_topic(JOINTS)):
            stamp = nanoseconds(joints.header.stamp)
            first = bisect_left(stamps, stamp - executor.tolerance)
            last = bisect_right(stamps, stamp + executor.tolerance)
            for message in of_base[first:last]:
                with suppress(InvalidInputError):
                    x = messages_of.join({base: message, JOINTS: joints})
                    yield Stamped(received, stamp, x)


def _stamped(
    bag: BagReader, name: str, values_of: Callable[[Any], Array], found: BagCheck
) -> list[Stamped]:
    """Reads the messages of a topic, which answer states, in the order of their receipt."""
    read, refused = list[Stamped](), list[str]()
    for received, message in bag.decoded(bag.needed_topic(name), refused=refused):
        stamp = nanoseconds(message.header.stamp)
        try:
            read.append(Stamped(received, stamp, values_of(message)))
        except InvalidInputError as error:
            refused.append(f"At {stamp * 1e-9:.3f} s, {error}")
    found.blame(refused, f"{name.removeprefix('joint_')}s cannot be read; of the first one")
    return read


def _contexts(bag: BagReader, executor: RecordedExecutor, found: BagCheck) -> list[Stamped]:
    """Reads what the executor told its policy in each state, in the order of receipt."""
    names = executor.signals.names

    def commands_of(message: Any) -> Array:
        values = signals_from_msg(message)
        if tuple(values) != names:
            raise InvalidInputError(f"it tells {quote(list(values))}, not {list(names)}.")
        return np.array(list(values.values()))

    is_told = names and CONTEXT in bag.filled_topics
    return _stamped(bag, CONTEXT, commands_of, found) if is_told else []


def _check_contexts(
    bag: BagReader, executor: RecordedExecutor, contexts: list[Stamped], found: BagCheck
) -> None:
    """Computes the clock of each state again, and looks for what was commanded."""
    signals = executor.signals
    if not contexts:
        return
    given, values_of = _commanded(bag, executor), partial(executor.parameters.values, executor.node)
    # A command may have been held for so long [ns], which no message tells in simulated time.
    is_simulated = True in values_of("use_sim_time")
    timeout = max(values_of("command_timeout"), default=math.inf)
    longest = math.inf if is_simulated else 1e9 * timeout + _COMMAND_WINDOW
    different, strange = list[str](), list[str]()
    for each in contexts:
        told, at = each.values[: len(signals.commands)], f"at {each.stamp * 1e-9:.3f} s"
        phase = np.array(signals.phase_at(each.stamp))
        expected, turning = signals.context(told, phase), signals.turning.context(told, phase)
        if not any(
            np.allclose(each.values, one, rtol=0.0, atol=_CLOCK_TOLERANCE)
            for one in (expected, turning)
        ):
            clock = slice(len(signals.commands), None)
            is_not = f"{each.values[clock].tolist()}, not {expected[clock].tolist()}"
            different.append(f"{at} the clock is {is_not}")
        for command, own, value in zip(signals.commands, given, told.tolist(), strict=True):
            first = bisect_left(own.received, each.received - longest)
            last = bisect_right(own.received, each.received + _COMMAND_WINDOW)
            if value not in (command.rest, *own.values[first:last]):
                strange.append(f"{at} {command.name} is {value:g}")
    found.prove("the clock of", len(contexts) - len(different), len(contexts), "contexts")
    found.blame(different, "contexts are none that the executor tells")
    found.blame(strange, "values in contexts were not commanded in the bag", found.missing)


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


def _check_steps(
    bag: BagReader,
    executor: RecordedExecutor,
    motions: list[list[Stamped]],
    commands: list[Stamped],
    found: BagCheck,
) -> None:
    """Computes each state of a motion but the first one again, and the efforts that led to it."""
    pairs = [pair for motion in motions for pair in pairwise(motion)]
    found.unproved += [f"how {len(motions)} motions begin"] * (len(motions) > 1)
    if not pairs:
        return
    model, period = executor.model, executor.period
    dynamics = Dynamics(model, max(1, round(period * 1e-9 / model.opt.timestep)), threads=1)
    forces, joints, names = JointForces(model), joint_names(model), state_names(model)
    controls = defaultdict[int, list[Stamped]](list)
    for command in commands:
        controls[command.stamp].append(command)
    pushes = _pushes(bag, executor, list(chain(*motions)))
    wrong, efforts, unanswered = list[str](), list[str](), 0
    for before, after in pairs:
        at, off = f"at {after.stamp * 1e-9:.3f} s", list[Array]()
        first, last = before.received - SLACK, after.received + SLACK
        answers = [c.values for c in controls[before.stamp] if first <= c.received <= last]
        scale = np.maximum(1.0, np.abs(after.values))
        for control, push in product(answers, [None, *pushes(before)]):
            off.append((dynamics.step(before.values, control, push) - after.values) / scale)
            if np.abs(off[-1]).max() > STATE_TOLERANCE:
                continue
            due, told = forces(before.values, control), np.array(np.nan)
            if len(after.joints.effort):
                told = efforts_from_msg(after.joints, joints)
            if not np.allclose(told, due, rtol=STATE_TOLERANCE, atol=STATE_TOLERANCE):
                efforts.append(f"{at} they are {told.tolist()}, not {due.tolist()}")
            break
        else:
            unanswered += not off
            if off:
                worst = int(np.argmax(np.abs(off[0])))
                is_now = f"{names[worst]} is {float(after.values[worst])!r}"
                wrong.append(f"{at} {is_now}, which is off by {abs(off[0][worst]):.2g}")
        if abs(late := after.stamp - before.stamp - period) > _ROUNDING:
            wrong.append(f"{at} a state comes {late * 1e-9:g} s too late")
    agreeing = len(pairs) - unanswered - len(wrong)
    found.prove("", agreeing, len(pairs), "steps from state to state")
    found.blame(wrong, "states do not follow from the state and the control before them")
    found.blame(efforts, "states tell efforts that are not those of their controls")
    found.missing += [f"{unanswered} states lack the control that answers them"] * bool(unanswered)


def _pushes(
    bag: BagReader, executor: RecordedExecutor, states: list[Stamped]
) -> Callable[[Stamped], Iterator[AppliedForce]]:
    """Returns a function that yields the pushes that may have acted from a state on."""
    bodies, found = BodyFrames(executor.model), list[tuple[int, int, tuple[int, Array, Array]]]()
    node, _ = executor.parameters.find_node("push_duration")
    duration = max(executor.parameters.values(node, "push_duration"), default=0.0)
    topic = bag.filled_topics.get("push")
    for received, message in bag.decoded(topic) if topic else ():
        around = [s.stamp for s in states if abs(s.received - received) <= SLACK]
        with suppress(InvalidInputError):  # which the simulation refused
            body, wrench = bodies.body(message.header.frame_id), wrench_from_msg(message.wrench)
            if around:
                last = max(around) + round(1e9 * duration)
                found.append((min(around), last, (body, wrench[:3], wrench[3:])))

    def acting(state: Stamped) -> Iterator[AppliedForce]:
        for first, last, push in found:
            if first <= state.stamp <= last:
                yield bodies.applied(state.values, *push)

    return acting


def _check_costs(bag: BagReader, executor: RecordedExecutor, found: BagCheck) -> None:
    """Rolls the policies of a training out again, without noise, the newest ones first."""
    topic = bag.filled_topics.get("learning_progress")
    progress = [message for _, message in bag.decoded(topic)] if topic else []
    policies = defaultdict[int, list[GaussianPolicy]](list)
    for _, message in policy_messages(bag, []) if progress else ():
        with suppress(InvalidInputError):  # which was named
            if onnx_content(message) is None:
                policies[message.iteration].append(learned_policy(message))
    tasks_of = cache(partial(_situations, executor))
    wrong, agreeing, steps = list[str](), 0, 0
    for message in reversed(progress):
        tasks, told = tasks_of(message.seed), message.deterministic_cost
        steps += sum(task.horizon for task in tasks)
        if not tasks or steps > _MOST_STEPS:
            break
        costs = [c for policy in policies[message.iteration] if (c := _cost(tasks, policy))]
        if any(abs(told - cost) <= error or told == cost for cost, error in costs):
            agreeing += 1
        elif costs:
            wrong.append(f"that of iteration {message.iteration} is {told!r}, not {costs[-1][0]!r}")
    found.prove("the cost without noise of", agreeing, len(progress), "policies")
    found.blame(wrong, "costs without noise are not the policies'")
    if unknown := len(progress) - agreeing - len(wrong):
        found.unproved.append(f"the costs of {unknown} policies")


def _situations(executor: RecordedExecutor, seed: int) -> list[Task]:
    """Returns the task in each situation of a training; none where the bag does not tell them."""
    task, (_, own) = executor.task, executor.parameters.find_node("evaluation_rollouts")
    if task is None or own.get("demonstration"):
        return []
    settings = search_settings(task)
    names = [s.name for s in settings_of(settings) if s.name in own]
    lists = {name: tuple(own[name]) for name in names if isinstance(own[name], list)}
    settings = with_values(settings, {name: own[name] for name in names} | lists)
    if settings.renew.share or settings.disturb.start_before:
        return []
    return [situation.of(task) for situation, _ in situations(task, settings, seed)]


def _cost(tasks: list[Task], policy: GaussianPolicy) -> tuple[float, float] | None:
    """Returns the mean cost without noise, and what rounding may change; None if that is much."""
    costs = np.zeros(2)
    for task in tasks:
        dynamics, nudges = task.dynamics, np.zeros((2, task.dynamics.space.tangent_dim))
        nudges[1] = _NUDGE
        noise = np.zeros((2, task.horizon, len(policy.noise_std)))
        starts = dynamics.space.add(task.initial_state, nudges)
        starts[0] = task.initial_state
        try:
            motions = dynamics.execute(policy, task.observation, starts, noise)
        except InvalidInputError:  # a policy of another robot
            return None
        costs += task.rollout_costs(*motions) / len(tasks)
    cost, nudged = costs.tolist()
    error = abs(nudged - cost) + STATE_TOLERANCE * abs(cost)
    return (cost, error) if cost == nudged or error <= _COST_TOLERANCE * abs(cost) else None
