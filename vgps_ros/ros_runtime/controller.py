# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A lifecycle node that answers each state with a command, which all controllers share.

Where its law must not drive, the safe action does; `safety.supervisor` decides.

| transition | what it does |
| --- | --- |
| configure | loads policy, distribution and task, and listens to the robot's sensors |
| activate | begins to answer states; refused during an emergency stop |
| deactivate | the safe action drives for `settle_duration`, and then a last command is sent |
| cleanup | frees what configure loaded, which may have other files next time |
"""

import time
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import Annotated, Any, Literal

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger
from vgps_msgs.msg import Signals as SignalsMsg

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.observation import StateReadings
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Range, Setting
from vgps_ros.messages.conversions import gains_to_msg, nanoseconds
from vgps_ros.messages.names import (
    COMMANDS_SENT,
    EMERGENCY_STOP,
    GAINS,
    IS_ACTIVE,
    MJCF,
    POSE,
    SAFE_ACTION,
)
from vgps_ros.messages.robot_state import (
    JOINTS,
    NewestMeasurements,
    StateMessages,
    readings_of_place,
)
from vgps_ros.policies.deployment_file import DEPLOYMENT, make_deployment
from vgps_ros.robot.controls import CONTROL_BOUND
from vgps_ros.robot.deployment import Deployment
from vgps_ros.ros_runtime.command_sender import AnswerTimes, CommandSender
from vgps_ros.ros_runtime.commands import Instructions
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, declare_settings, value
from vgps_ros.ros_runtime.qos import COMMANDED, LATEST, NEWEST, NEWEST_OF_SENSORS, PARTS_OF_SENSORS
from vgps_ros.ros_runtime.runner import end_with
from vgps_ros.ros_runtime.services import steady_timer
from vgps_ros.ros_runtime.shadow import SHADOW, Look
from vgps_ros.ros_runtime.training_results import DISTRIBUTION_FILE, POLICY_FILE, TrainingResults
from vgps_ros.safety.poses import PoseMotion, PoseSettings
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.state_limits import StateLimits
from vgps_ros.safety.supervisor import Answer, Supervisor
from vgps_ros.tasks.registry import TASK

DEPLOYED_TASK = Setting(
    TASK.name, TASK.default, f"{TASK.description}, or the file of 'vgps export --deployment'"
)
_PERIOD = 1.0  # over which figures are taken [s]
_RISE = 0.05  # time from rest to the largest torque, which a real robot's rate limit allows [s]
_OF_REAL_ROBOTS: dict[str, Any] = {
    "safe_action": "stand",
    "tilt_limit": 1.2,
    "joint_margin": 0.5,
    "joint_speed_limit": 100.0,
}


@dataclass(frozen=True)
class _ControllerSettings:
    """How a controller starts and ends, and which states it takes."""

    state_qos: Annotated[
        Literal["reliable", "sensor_data"],
        "reliable: no state of a simulation is lost, as lock-step needs, and all of a state has "
        "one stamp; sensor_data: best effort, which takes every driver of a real robot, whose "
        "sensors have stamps of their own, other than zero; by both, of states that come more "
        "often than once in a control period one is answered in each",
    ] = "reliable"
    autostart: Annotated[bool, "whether to configure and activate once, at start"] = True
    settle_duration: Annotated[
        float,
        Range(0.0, 60.0),
        "time after a deactivation in which the safe action answers states, before the last "
        "command, which leaves the robot at rest [s]",
    ] = 0.0


@dataclass(frozen=True)
class _SensorSettings:
    """How a robot's sensors are joined."""

    base_frame: Annotated[
        str,
        "name of the base's frame in odom, imu and cmd_vel, such as base_link; empty: the model's "
        "name of it",
    ] = ""
    imu_frame: Annotated[
        str,
        "the model's site or body at which the IMU sits; empty: the one that the messages on imu "
        "name",
    ] = ""
    sensor_tolerance: Annotated[
        float,
        Range(0.0, 10.0),
        "with state_qos sensor_data: largest difference between the stamp of joint_states and the "
        "newest imu, odom or else of the same state; a period of the slowest sensor, and its "
        "latency [s]",
    ] = 0.05
    velocity_filter: Annotated[
        float,
        Range(0.0, 10.0),
        "where joint_states have no velocities, those are differences of positions, through a "
        "low-pass filter of this time constant; with state_qos sensor_data a control period by "
        "default; 0: such states are refused [s]",
    ] = 0.0
    base_from: Annotated[
        Literal["auto", "imu", "odom"],
        "what tells of a free base: imu (sensor_msgs/Imu), how it is turned and turns, for a "
        "policy that reads no more of it; odom (nav_msgs/Odometry), all; auto: imu where it is "
        "enough",
    ] = "auto"


class Controller(LifecycleNode):
    """Answers each state with a command, while it is active.

    Attributes:
        robot: what it has to know of the task.
        needs_policy: whether no state is answered before there is a policy.
        sender: sends its commands.
        is_real: whether its robot is no simulation.
        is_shadow: whether it looks only, and sends nothing.
        sensors: how its sensors are joined.
        safety: when its law may drive.
        poses: how the robot gets to its poses.
        health: the node's diagnostics.
        instructions: what it is told as it runs, commands and a clock.
    """

    def __init__(self, name: str, *, needs_policy: bool):
        super().__init__(name)
        self.robot = robot = _robot(declare(self, DEPLOYED_TASK))
        self.needs_policy = needs_policy
        self._settings = settings = declare_settings(self, _ControllerSettings())
        self.is_real = is_real = settings.state_qos == "sensor_data"
        self.is_shadow = declare(self, SHADOW)
        self.sender = CommandSender(self, robot.controls.names, is_silent=self.is_shadow)
        smoothing = robot.time_step if is_real else 0.0
        self.sensors = declare_settings(self, _SensorSettings(velocity_filter=smoothing))
        self.prepare_law()
        declare(self, POLICY_FILE, may_change=True)
        declare(self, DISTRIBUTION_FILE, may_change=True)
        when_alone = self._start if settings.autostart else self._tell_how_to_start
        limits = tuple(robot.controls.largest.tolist())
        rate = max(limits) / _RISE if max(limits) < CONTROL_BOUND else 0.0
        usual = {**_OF_REAL_ROBOTS, "torque_rate_limit": rate} if is_real else {}
        self.safety = declare_settings(self, SafetySettings(torque_limits=limits, **usual))
        if self.is_shadow:  # which judges each state anew
            self.safety = replace(self.safety, recovery="automatic")
        self.poses = declare_settings(self, PoseSettings())
        Instructions.declare(self, robot.signals)
        owns = [] if self.is_shadow else self.sender.topics
        self.health = Health(self, owns=owns, when_alone=when_alone)
        base_frame = self.sensors.base_frame or robot.layout.base_frame
        self.instructions = Instructions(self, self.health, robot, base_frame)
        for key in (IS_ACTIVE, SAFE_ACTION):
            self.health.set_value(key, False)
        if not self.is_shadow:
            self.health.set_value(COMMANDS_SENT, self.sender.sent)
        self._session: _Session | None = None  # while it is configured
        self._closing = ExitStack()  # what the session's end does
        self._is_first = True  # whether no session was before, after which files may be others
        self._is_starting = False  # True while it configures itself, and ends where it cannot
        self._refusal = "The node could not be configured."
        self._stop = _EmergencyStop(self, self._freeze)
        for name in ("drive", "stand", "hold", "sit"):
            self.create_service(Trigger, f"~/{name}", partial(self._answer_pose, name))

    @abstractmethod
    def prepare_law(self) -> None:
        """Declares the parameters that only this controller has, and prepares its law."""

    @abstractmethod
    def law(self, training: TrainingResults, state: Array, stamp: int) -> Array:
        """Returns the control in a usable state, shape (n_u,), whose context `instructions` has.

        Args:
            training: the policy, and what it reads.
            state: x, shape (n_x,).
            stamp: its stamp [ns].

        Raises:
            InvalidInputError: the law must not drive now; the safe action does.
        """

    def _tell_how_to_start(self) -> None:
        command = f"ros2 lifecycle set {self.get_fully_qualified_name()}"
        self.get_logger().info(
            f"Waiting to be configured and activated: `{command} configure`, then `activate`."
        )

    def _start(self) -> None:
        """Configures and activates the node at its start; what prevents it ends the node."""
        self._is_starting = True
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            end_with(VgpsError(self._refusal))
        elif not self._stop.reason:
            self.trigger_activate()
        self._is_starting = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Loads the policy and the task, and listens to the robot's sensors."""
        self._end_session()
        kept = {*self.subscriptions, *self.publishers, *self.timers}
        self._closing.callback(self._destroy_all_but, kept)
        try:
            if not self._is_first:
                self._read_robot_again()
            self._is_first = False
            self._session = session = _Session(self)
        except Exception as error:  # rclpy would swallow one that nobody foresaw
            unforeseen = f"It cannot be configured ({type(error).__name__}: {error})."
            self._refusal = str(error) if isinstance(error, VgpsError) else unforeseen
            self._end_session()
            if not self._is_starting:  # then it is the last that the node says
                self.health.report("configuration", error=f"Not configured: {self._refusal}")
            return TransitionCallbackReturn.FAILURE
        self._closing.callback(session.close)
        self.health.clear("configuration")
        return super().on_configure(state)

    def _read_robot_again(self) -> None:
        robot, before = _robot(value(self, DEPLOYED_TASK)), self.robot
        if (robot.signals, robot.controls.names) != (before.signals, before.controls.names):
            raise InvalidInputError(
                f"The task {robot.name} has other commands, clock or controls than at the node's "
                "start, from which its parameters are: start the node again."
            )
        self.robot = robot

    def _end_session(self) -> None:
        self._closing.close()
        self._session = None

    def _destroy_all_but(self, kept: set[Any]) -> None:
        for kind in ("subscription", "publisher", "timer"):
            for each in [each for each in getattr(self, f"{kind}s") if each not in kept]:
                getattr(self, f"destroy_{kind}")(each)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Frees what was loaded."""
        self._end_session()
        return super().on_cleanup(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Starts the commands, unless there is an emergency stop."""
        if self._stop.reason:
            self.get_logger().error(f"Not activated: {self._stop.reason} Release it first.")
            return TransitionCallbackReturn.FAILURE
        assert self._session  # as the lifecycle has it
        self._session.activate()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lets the safe action drive for a while, and then stops the commands."""
        assert self._session
        self._session.deactivate(self._settings.settle_duration)
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops the commands, at the lifecycle's end and where a transition failed."""
        self.stop()
        return super().on_shutdown(state)

    on_error = on_shutdown

    def stop(self) -> None:
        """Stops the commands: the last one leaves the robot at rest, since motors may hold it."""
        if self._session:
            self._session.deactivate(0.0)
            self._session.finish()

    def _freeze(self) -> None:
        if self._session:
            self._session.freeze()

    def _answer_pose(
        self, name: str, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        session = self._session
        if self.is_shadow:
            response.message = "It is a shadow, which moves nothing: start it without shadow."
        elif session is None or not session.drives:
            response.message = self._stop.reason or "Nothing moves: activate the node again first."
        else:
            response.success, response.message = session.take_pose(name)
        return response


class _EmergencyStop:
    """Takes an emergency stop and its release, by a topic and by a service.

    Attributes:
        reason: why nothing may move; empty where it may.
    """

    def __init__(self, node: Node, when_stopped: Callable[[], object]):
        self.reason, self._when_stopped = "", when_stopped
        for qos in (LATEST, COMMANDED):  # whatever its sender guarantees
            node.create_subscription(Bool, EMERGENCY_STOP, self._take, qos)
        node.create_service(SetBool, f"~/{EMERGENCY_STOP}", self._answer)

    def _take(self, wanted: Bool | SetBool.Request) -> None:
        before, self.reason = self.reason, "There is an emergency stop." * wanted.data
        if self.reason and not before:
            self._when_stopped()

    def _answer(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._take(request)
        response.success = True
        response.message = self.reason or "Released; deactivate and activate, to drive again."
        return response


class _Session:
    """A controller that is configured: what it has loaded, and its answers while it is active.

    Args:
        node: the controller, which destroys the subscriptions, publishers and timers of a session.

    Raises:
        InvalidInputError: what the node's parameters name is wrong, or does not suit the robot.
    """

    def __init__(self, node: Controller):
        robot, health, settings = node.robot, node.health, node.poses
        self._node, self._health = node, health
        self._times = AnswerTimes(health, robot.time_step)
        # A policy that comes before activation is kept for it.
        needs = node.needs_policy, node.safety.needs_distribution
        self._training = TrainingResults(node, robot, health, *needs)
        self._controls = controls = self._training.controls
        self._interfaces = node.sender.interfaces(controls)
        sitting = robot.pose("sit_keyframe", settings.sit_keyframe)
        self._sitting = sitting if settings.sit_keyframe else None
        self._standing = robot.pose("stand_keyframe", settings.stand_keyframe)
        self._carrying = carrying = robot.standing(settings.stand_keyframe, controls)
        limits = StateLimits(node.safety, robot.layout, robot.initial_state)
        of_robot = controls, robot.time_step, robot.limits.broken, limits, carrying
        self._supervisor = Supervisor(node.safety, *of_robot, self._training.marginals)
        # Of a real robot no other node of this project tells it, and a bag needs it.
        node.create_publisher(String, MJCF, LATEST).publish(String(data=robot.mjcf))
        self._sensors = _Sensors(node, self._training.observation.readings, self._take_measurement)
        self._look: Look | None = None
        if node.is_shadow:
            states = self._sensors.states
            self._look = Look(node, health, robot, states, node.sender, self._training)
        else:
            gains = gains_to_msg(controls, node.get_clock().now().to_msg())
            node.create_publisher(SignalsMsg, GAINS, LATEST).publish(gains)
        self._motion: PoseMotion | None = None  # what the robot does in place of the law
        self._is_active = False
        self._since = 0.0  # when it was activated [s]
        self._until: float | None = None  # when a deactivation ends, by the steady clock [s]
        self._watchdog = steady_timer(node, robot.time_step, self._watch)
        self._watchdog.cancel()  # until there is a first answer
        # With use_sim_time; the state of the time 0, which says so too, may be lost.
        self._clock_jumps = node.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            post_callback=lambda _: self._supervisor.forget_time(),
        )

    def close(self) -> None:
        """Stops listening; a deactivation that settles ends."""
        self.finish()
        self._clock_jumps.unregister()
        self._health.clear("qos")

    def activate(self) -> None:
        """Begins to answer states."""
        self.finish()
        self._supervisor.begin()
        self._set_active(True)
        self._set_motion(self._motion_to("drive", is_driven=False))
        if self._look:
            self._look.begin()
        self._training.wait()
        self._health.wait_for(self._sensors.awaited)
        self._since = time.monotonic()

    def deactivate(self, settle: float) -> None:
        """Lets the safe action drive for a time [s], where the law did."""
        if not self._is_active:
            return
        self._set_active(False)
        self._set_motion(None)
        self._until = time.monotonic() + settle
        self._supervisor.stop_driving("the node is deactivated.")
        self._training.stop_waiting()
        self._health.stop_waiting(self._sensors.awaited)
        if self._watchdog.is_canceled() or not settle:  # or no state was answered
            self.finish()

    def finish(self) -> None:
        """Ends a deactivation: sends the last command."""
        if self._until is None:
            return
        self._until = None
        if self._look:
            self._look.end()
        self._watchdog.cancel()
        self._health.clear("state", "distance", "sensors")
        if last := self._supervisor.stop():
            self._health.publish()  # a recording must know that this command is no policy's
            self._send(last)

    def freeze(self) -> None:
        """Lets the safe action drive until the node is activated again."""
        if self._is_active:
            self._supervisor.stop_driving("there is an emergency stop.", is_frozen=True)
            self._watch()

    @property
    def drives(self) -> bool:
        """Whether it is active, and nothing has stopped it until it is activated again."""
        return self._is_active and not self._supervisor.has_stopped

    def take_pose(self, name: str) -> tuple[bool, str]:
        """Lets the robot go to a pose, or be driven; returns whether it does, and a sentence."""
        if self._supervisor.is_latched:
            return False, f"Deactivate and activate the node first: {self._supervisor.fault}"
        self._set_motion(self._motion_to(name, is_driven=self._motion is None))
        return True, f"It {self._motion.name}." if self._motion else "It is driven."

    def _motion_to(self, name: str, *, is_driven: bool) -> PoseMotion | None:
        """Returns the motion stand, hold, sit, or drive, which stands up before the law drives.

        One on a free base that the law drives has feet in the air: it begins as it stands.
        """
        poses, is_before_law = self._node.poses, name == "drive"
        says, goal, duration = {
            "drive": ("stands up", self._standing, poses.stand_duration),
            "stand": ("stands up", self._standing, poses.stand_duration),
            "hold": ("holds its pose", None, 0.0),
            "sit": ("sits down", self._sitting, poses.sit_duration),
        }[name]
        if self._look or (is_before_law and not duration):
            return None
        first = self._standing if is_driven and self._carrying is not None else None
        last = self._carrying if is_driven else self._supervisor.last_control
        given = says, self._controls, poses, goal, duration, first, last
        return PoseMotion(*given, is_before_law=is_before_law)

    def _set_motion(self, motion: PoseMotion | None) -> None:
        self._motion = motion
        if policy := self._training.policy:
            policy.forget()  # when it drives next, it begins anew
        self._sensors.newest.takes_all = motion is not None  # PD chatters where it is slow
        self._health.set_value(POSE, motion.name if motion else "")
        self._health.publish()  # a recording must know when the law drives

    def _set_active(self, is_active: bool) -> None:
        self._is_active = is_active
        self._health.set_value(IS_ACTIVE, is_active)
        self._health.set_value(SAFE_ACTION, False)

    def _take_measurement(self, topic: str, message: Any) -> None:
        if not self._is_active and self._until is None:
            return
        messages, newest = None, self._sensors.newest
        for each in self._sensors.waiting(topic, message):
            if self._look:
                self._look.hear(topic, each)
            messages = newest.add(topic, each) or messages
        if messages:
            self._health.clear("sensors")
            self._take_state(messages)
        elif (
            self._watchdog.is_canceled()
            and time.monotonic() - self._since > _PERIOD
            and (missing := newest.missing())
        ):
            self._health.report("sensors", error=f"No state is complete: {missing} did not come.")

    def _take_state(self, messages: dict[str, Any]) -> None:
        node, health, supervisor = self._node, self._health, self._supervisor
        health.arrived(self._sensors.awaited)
        health.clear("qos")
        has_policy = self._training.policy is not None or not node.needs_policy
        if (motion := self._motion) and motion.is_reached and motion.is_before_law and has_policy:
            self._set_motion(motion := None)
        if not (motion or has_policy):
            return
        if self._watchdog.is_canceled():
            self._watchdog.reset()
        began, law = time.monotonic(), partial(node.law, self._training)
        try:
            state = self._sensors.states.join(messages)
            stamp = nanoseconds(messages[JOINTS].header.stamp)
            if self._look:
                self._look.see(state, stamp)
            if node.is_real and stamp == 0:
                raise InvalidInputError(
                    "the state's stamp is 0, but it must be the time of the measurement; let the "
                    "robot's driver set it."
                )
            command = supervisor.answer(
                state,
                stamp,
                lambda: (node.get_clock().now().nanoseconds - stamp) * 1e-9,
                time.monotonic(),
                lambda: (motion.control if motion else law)(state, stamp),
                lambda: node.instructions.at(stamp, state),
                is_policy=motion is None,
            )
        except InvalidInputError as error:
            command = supervisor.refuse(str(error), time.monotonic())
        self._send(command)
        if command and not supervisor.fault:
            self._times.answered(command.stamp, time.monotonic() - began)
        self._report()

    def _watch(self) -> None:
        """Sends the safe action where it is due without a state, once a control period."""
        now, missing = time.monotonic(), self._sensors.newest.missing() or JOINTS
        if self._until is not None and now >= self._until:
            self.finish()
        elif command := self._supervisor.watch(now, missing):
            self._send(command)
            self._report()

    def _send(self, command: Answer | None) -> None:
        if command and self._look:
            self._look.compare(command.control)
        elif command:
            sender = self._node.sender
            sender.send(command, self._controls, self._interfaces)
            self._health.set_value(COMMANDS_SENT, sender.sent)

    def _report(self) -> None:
        """Shows on /diagnostics who drives, and why."""
        supervisor, settings = self._supervisor, self._node.safety
        self._health.set_value(SAFE_ACTION, supervisor.fault is not None)
        sentence = ""
        if supervisor.fault:
            sentence = f"Safe action active ({settings.safe_action}): {supervisor.fault}"
            if self._look:
                sentence = f"The policy would not drive: {supervisor.fault}"
            if settings.recovery == "manual":
                sentence += " It stays until the node is deactivated and activated."
        self._health.report("state", error=sentence)
        self._health.report("distance", warning=supervisor.warning or "")
        if supervisor.distance is not None:
            self._health.set_value("distance from training", f"{supervisor.distance:.2f}")


class _Sensors:
    """Subscribes to the topics that tell of a robot's state.

    Args:
        node: the controller.
        read: what its policy reads of a state.
        take: called with a topic and each message on it.

    Attributes:
        states: which topics there are, and how their messages make a state.
        newest: the measurements that wait for others.
        awaited: what the controller waits for, in words.

    Raises:
        InvalidInputError: base_from is imu, but more is read than an IMU measures.
    """

    def __init__(self, node: Controller, read: StateReadings, take: Callable[[str, Any], None]):
        robot, settings, self._is_real = node.robot, node.sensors, (is_real := node.is_real)
        self._node, self._health, self._filter = node, node.health, settings.velocity_filter
        self.states = states = StateMessages(
            robot.layout,
            is_blind=_is_blind(node, read),
            base_frame=settings.base_frame,
            imu_frame=settings.imu_frame,
        )
        self.newest = NewestMeasurements(
            states,
            settings.sensor_tolerance if is_real else robot.time_step / 2,
            robot.time_step,
            self._filter,
            self._tell_differences,
            is_simulated=not is_real,
        )
        also = " (and odom, if they lack the base)" * (states.sources != states.needed)
        source = "the robot's drivers" if is_real else "simulation"
        self.awaited = f"{' and '.join(states.needed)}{also} from {source}"
        self._subscriptions = {}
        for topic, kind in states.sources.items():
            has_many = topic == JOINTS or node.is_shadow
            real = PARTS_OF_SENSORS if has_many else NEWEST_OF_SENSORS
            events = SubscriptionEventCallbacks(incompatible_qos=partial(self._report_qos, topic))
            taken, qos = partial(take, topic), real if is_real else NEWEST
            made = node.create_subscription(kind, topic, taken, qos, event_callbacks=events)
            self._subscriptions[topic] = made

    def waiting(self, topic: str, message: Any) -> Iterator[Any]:
        """Yields a message and, since a robot's newest state counts, what waits behind it."""
        yield message
        handle = self._subscriptions[topic].handle
        while self._is_real and (taken := handle.take_message(type(message), False)):
            yield taken[0]

    def _tell_differences(self) -> None:
        """Says that velocities of joints are none that a sensor measures."""
        words = f"differences of positions, filtered over {self._filter:g} s (velocity_filter)"
        self._health.set_value("joint velocities", words)
        self._node.get_logger().warning(f"joint_states have no velocities: they are {words}.")

    def _report_qos(self, topic: str, _: object) -> None:
        """Reports which nodes publish a sensor less reliably than this node takes it."""
        topic = self._node.resolve_topic_name(topic)
        names = [
            f"{sender.node_namespace.rstrip('/')}/{sender.node_name}"
            for sender in self._node.get_publishers_info_by_topic(topic)
            if sender.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        ]
        sentence = (
            f"{' and '.join(names) or 'A node'} sends {topic} by best effort, but this node takes "
            "it reliably only, so that nothing arrives; start it with state_qos:=sensor_data."
        )
        self._health.report("qos", error=sentence)


def _is_blind(node: Controller, read: StateReadings) -> bool:
    """Returns whether the IMU alone tells of a free base."""
    robot, wanted, base = node.robot, node.sensors.base_from, node.robot.layout.base
    if wanted == "odom" or base is None:
        return False
    place = ["plans"]  # which follow the whole state
    if node.needs_policy:
        place = readings_of_place(base, robot.initial_state, read, robot.limits.readings)
    if place and wanted == "imu":
        raise InvalidInputError(
            f"base_from is imu, but {', '.join(place)} need the place or the velocity of the base, "
            "which no IMU measures: set base_from to odom."
        )
    return not place


def _robot(reference: str) -> Deployment:
    """Returns what a controller has to know of a task; of a deployment file without MuJoCo."""
    try:
        if not reference.endswith(DEPLOYMENT):
            import_module("vgps_ros.simulation.warnings").silence_mujoco()
        return make_deployment(reference)
    except ModuleNotFoundError as error:
        raise InvalidInputError(
            f"The task {quote(reference)} needs the package {error.name}, which is not installed; "
            "install it, or name the file of 'vgps export --deployment', which needs none."
        ) from error
