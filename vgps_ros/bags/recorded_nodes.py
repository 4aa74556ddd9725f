# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads what a bag holds of its nodes: their parameters, policies, and what the executor did."""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import mujoco
import numpy as np
from rclpy.parameter import parameter_value_to_python

from vgps_ros.bags.reader import BagReader
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.observation import NO_CONTEXT, Observation
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import settings_of, with_values
from vgps_ros.messages.conversions import policy_from_msg, robot_model
from vgps_ros.policies.deployment_file import DEPLOYMENT, make_deployment
from vgps_ros.policies.driver import observation_of
from vgps_ros.robot.controls import CONTROL_BOUND
from vgps_ros.robot.deployment import Reader
from vgps_ros.robot.executed_control import Policy, RememberingPolicy
from vgps_ros.robot.signals import Signals
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.supervisor import ControlLimiter, safe_control
from vgps_ros.safety.training_marginals import TrainingMarginals
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.dynamics import Simulations
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.readings import Readings
from vgps_ros.storage.files import read_yaml
from vgps_ros.tasks import recorded_task

SLACK = 10**9  # largest time by which the bag may hold one of two related messages late [ns]
ONNX = "onnx_policy"  # on which an executor that was started with such a file publishes it
_FILE = "parameters.yaml"


@dataclass
class Timeline:
    """Values with the times at which they were received [ns], in this order."""

    received: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)

    def add(self, received: int, value: Any) -> None:
        """Adds a value that came after all others."""
        self.received.append(received)
        self.values.append(value)

    def around(self, time: int) -> list[Any]:
        """Returns the values that may have been the latest at a time, the likeliest first.

        Of the joints of a state that came long before, with each IMU of their stamp, all do.
        """
        before = int(np.searchsorted(self.received, time - SLACK, side="right"))
        first = bisect_left(self.received, self.received[before - 1]) if before else 0
        last = int(np.searchsorted(self.received, time + SLACK, side="right"))
        now = int(np.searchsorted(self.received, time, side="right")) - 1
        return [self.values[i] for i in sorted(range(first, last), key=lambda i: abs(i - now))]


def policy_messages(bag: BagReader, refused: list[str] | None = None) -> Iterator[tuple[int, Any]]:
    """Returns the time of receipt [ns] and the message of each policy, in their order.

    Args:
        bag: the bag.
        refused: takes a sentence on each message that cannot be read; without it, one raises.

    Raises:
        InvalidInputError: the bag has no policy, or a message is none.
    """
    topics = [bag.filled_topics[name] for name in ("policy", ONNX) if name in bag.filled_topics]
    return bag.decoded(*(topics or [bag.needed_topic("policy")]), refused=refused)


def learned_policy(message: Any) -> GaussianPolicy:
    """Returns the policy that a message of a learner holds.

    Raises:
        InvalidInputError: it holds none.
    """
    try:
        return policy_from_msg(message)
    except InvalidInputError as error:
        raise InvalidInputError(
            f"The policy of iteration {message.iteration} cannot be read: {error}"
        ) from error


def onnx_content(message: Any) -> bytes | None:
    """Returns the bytes of an ONNX file, or None if the message is a policy of a learner."""
    return bytes(message.data) if hasattr(message, "data") else None


class RecordedParameters:
    """Parameters of the nodes of a bag's robot; a bag without parameters.yaml has none.

    Attributes:
        nodes: the parameters in parameters.yaml, by the full names of the nodes.

    Raises:
        InvalidInputError: parameters.yaml does not hold parameters.
    """

    def __init__(self, bag: BagReader):
        nodes = read_yaml(bag.attachments().get(_FILE, ""), _FILE) or {}
        try:
            self.nodes: dict[str, dict[str, Any]] = {
                name: dict(nodes[name]["ros__parameters"]) for name in bag.of_robot(nodes)
            }
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise InvalidInputError(f"{_FILE} does not hold nodes' parameters.") from error
        self._said: dict[tuple[str, str], list[Any]] = defaultdict(list)
        topic = bag.filled_topics.get("parameter_events")
        for _, message in bag.decoded(topic) if topic else ():
            for parameter in (*message.new_parameters, *message.changed_parameters):
                with suppress(RuntimeError):  # of a type that does not exist
                    value = parameter_value_to_python(parameter.value)
                    self._said[message.node, parameter.name].append(value)

    def find_node(self, *names: str) -> tuple[str, dict[str, Any]]:
        """Returns the first node that has these parameters, and all that it has; else nothing."""
        found = ((node, own) for node, own in self.nodes.items() if set(names) <= set(own))
        return next(found, ("", {}))

    def values(self, node: str, name: str) -> list[Any]:
        """Returns the values that a parameter had at some time."""
        own = self.nodes.get(node, {})
        return [*self._said[node, name], *([own[name]] if name in own else [])]


class RecordedExecutor:
    """Applies the limits and the safe action of a recorded executor.

    Attributes:
        parameters: those of all nodes.
        node: name of the executor; empty if there is none.
        is_in_lock_step: whether a simulation waited for the answer to each state.
        model: the robot.
        robot: what messages say of it.
        seeds: those of the noise that controls may have; None is no noise.
        settings: safety settings of the executor.
        controls: what the robot's controls are.
        limiter: limits of the controls, which depend on those that were noted before.
        task: its task; None if it is not known, as where another node drove, or deployed.
        deployment: what it knew of its task; None if that is not known.
        signals: the commands and the clock of its task.
        frames: its names of the base's and of the IMU's frame.
        is_measured: whether its sensors had stamps of their own.
        tolerance: by which they differed at most [ns].
        period: its control period [ns]; 0 if its task is not known.

    Raises:
        InvalidInputError: a recorded parameter has a value that no executor accepts.
    """

    def __init__(self, bag: BagReader, model: mujoco.MjModel):
        self.parameters = RecordedParameters(bag)
        node, parameters = self.parameters.find_node("seed", "stochastic")
        self.node, self.seeds = node, self._seeds(node)
        _, simulated = self.parameters.find_node("mode", "real_time_factor")
        self.is_in_lock_step = simulated.get("mode") == "lock_step"
        self.model = model
        self._resting: Array | None = None  # what the safe action holds, while it drives
        self._standing: list[Array] = []  # controls by which it may stand
        self._observations: dict[tuple[str, ...], Observation] = {}
        self.task, self.deployment = None, None
        if {"safe_action", "task"} <= set(parameters):
            reference = str(parameters["task"])
            if not reference.endswith(DEPLOYMENT):
                self.task = recorded_task(reference)
            self.deployment = self.task.deployment if self.task else make_deployment(reference)
        self._layout = self.deployment.layout if self.deployment else state_layout(model)
        self._read: Reader = partial(Readings, Simulations(model, threads=1))
        if self.deployment and not self.task:
            self._read = self.deployment.read
        self.signals = self.deployment.signals if self.deployment else Signals()
        self.frames: dict[str, Any] = {
            name: str(parameters.get(name, "")) for name in ("base_frame", "imu_frame")
        }
        self.is_measured = parameters.get("state_qos") == "sensor_data"
        period = self.deployment.time_step if self.deployment else 0.0
        own = float(parameters.get("sensor_tolerance", 0.0))
        self.tolerance = round(1e9 * (own if self.is_measured else period / 2))
        self.controls = controls_of(model)
        self.robot = robot_model(bag.recorded_mjcf(), self._layout.names, self.controls.names)
        defaults = SafetySettings(torque_limits=(CONTROL_BOUND,) * model.nu)
        known = {s.name for s in settings_of(defaults)} & set(parameters)
        values = {name: parameters[name] for name in known}
        if "torque_limits" in values:
            limits = values["torque_limits"]
            values["torque_limits"] = tuple(limits if isinstance(limits, list) else [limits])
        self.settings = with_values(defaults, values)
        if self.deployment and self.settings.safe_action == "stand":
            keyframe = str(parameters.get("stand_keyframe", ""))
            standing = self.deployment.standing(keyframe, self.controls)
            self._standing = [] if standing is None else [standing]
        self.period = round(1e9 * period)
        self.limiter = ControlLimiter(self.settings, self.controls, period)

    def _seeds(self, node: str) -> list[int | None]:
        """Returns the seeds of the noise that controls may have; None is no noise."""
        noisy = set(self.parameters.values(node, "stochastic")) or {False}
        seeds = set(self.parameters.values(node, "seed"))
        for seed in seeds:
            SEED.check(seed)
        found = [*([None] if False in noisy else []), *(seeds if True in noisy else [])]
        return found or [None]

    def remembering_policy(self, policy: GaussianPolicy) -> Policy:
        """Returns the policy, with what it remembers of former steps, if its task names any."""
        observation = self.deployment.observation if self.deployment else None
        if observation and observation.past and policy.observed == observation.names:
            return RememberingPolicy(policy, observation.past)
        return policy

    def inputs(self, policy: Policy, state: Array, context: Array = NO_CONTEXT) -> Array:
        """Returns what the policy reads of a state in its context (n_z,), shape (n_o,)."""
        return self._observation_of(policy).within(context)(state)

    def check_fits(self, policy: Policy) -> None:
        """Refuses a policy that no executor of this robot could use.

        Raises:
            InvalidInputError: the robot lacks what it reads, or has another number of controls.
        """
        self._observation_of(policy)
        wanted = len(self.controls.names)
        if (given := len(policy.noise_std)) != wanted:
            raise InvalidInputError(f"The policy has {given} controls, but the robot has {wanted}.")

    def _observation_of(self, policy: Policy) -> Observation:
        names = tuple(policy.observed)
        if names not in self._observations:
            observation = observation_of(
                policy, self._layout, self._read, self.signals, "The policy"
            )
            self._observations[names] = observation
        return self._observations[names]

    def marginals(self, distribution: TrajectoryDistribution) -> TrainingMarginals:
        """Returns the training marginals that the executor computed from a distribution."""
        assert self.deployment is not None
        observation, scored = (
            self.deployment.observation,
            distribution.first(self.deployment.horizon),
        )
        told = self.signals.spread(observation.told)
        return TrainingMarginals(scored, observation, len(self.controls.names), told)

    def is_safe(
        self,
        control: Array,
        state: Array,
        marginals: Iterable[Iterable[TrainingMarginals]],
        context: Array = NO_CONTEXT,
    ) -> bool:
        """Returns True if a control is that at rest, or that of the safe action in a state.

        Args:
            control: recorded control, shape (n_u,).
            state: recorded state, shape (n_x,).
            marginals: the sets of training marginals that the executor may have had at the time.
            context: commands and clock in that state, shape (n_z,).
        """
        if self.deployment is None:
            return False
        rests = [self.controls.holding(state), *self._standing]
        if self._resting is not None:
            rests.append(self._resting)
        for resting in rests:
            safe = [
                resting,
                *(
                    safe_control(self.settings, state, self.controls, resting, had, context)
                    for had in marginals
                ),
            ]
            if any(self.agrees(control, self.limiter.clipped(each, state)) for each in safe):
                self._resting = resting
                return True
        return False

    def drove(self) -> None:
        """Notes that the policy drove, so that the next safe action holds another state."""
        self._resting = None

    def agrees(self, control: Array, expected: Array) -> bool:
        """Returns True if a control is bit for bit the expected one, as a message has it."""
        sent = self.controls.from_joints(self.controls.at_joints(expected))
        return np.array_equal(control, sent)
