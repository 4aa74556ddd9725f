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
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any

from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger
from vgps_msgs.msg import Signals as SignalsMsg

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.observation import NO_CONTEXT
from vgps_ros.core.records import Array
from vgps_ros.core.settings import Setting
from vgps_ros.messages.conversions import (
    gains_to_msg,
    nanoseconds,
)
from vgps_ros.messages.names import (
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
from vgps_ros.policies.deployment import Deployment
from vgps_ros.robot.controls import CONTROL_BOUND
from vgps_ros.robot.unrest import Unrest, Waking
from vgps_ros.ros_runtime.command_sender import AnswerTimes, CommandSender
from vgps_ros.ros_runtime.commands import Instructions
from vgps_ros.ros_runtime.health import Health
from vgps_ros.ros_runtime.parameters import declare, declare_settings, value
from vgps_ros.ros_runtime.qos import (
    COMMANDED,
    LATEST,
    NEWEST,
    NEWEST_OF_SENSORS,
    PARTS_OF_SENSORS,
)
from vgps_ros.ros_runtime.runner import end_with
from vgps_ros.ros_runtime.services import steady_timer
from vgps_ros.ros_runtime.shadow import Look
from vgps_ros.ros_runtime.training_results import DISTRIBUTION_FILE, POLICY_FILE, TrainingResults
from vgps_ros.safety.poses import PoseMotion, PoseSettings
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.state_limits import StateLimits
from vgps_ros.safety.supervisor import Answer, Supervisor
from vgps_ros.tasks import DEPLOYMENT, make_deployment
from vgps_ros.tasks.registry import TASK

DEPLOYED_TASK = replace(
    TASK, description=f"{TASK.description}, or the file of 'vgps export --deployment'"
)
AUTOSTART = Setting("autostart", True, "whether to configure and activate once, at start")
SETTLE_DURATION = Setting(
    "settle_duration",
    0.0,
    "time after a deactivation in which the safe action answers states, before the last command, "
    "which leaves the robot at rest [s]",
    minimum=0.0,
    maximum=60.0,
)
STATE_QOS = Setting(
    "state_qos",
    "reliable",
    "reliable: no state of a simulation is lost, as lock-step needs, and all of a state has one "
    "stamp; sensor_data: best effort, which takes every driver of a real robot, whose sensors have "
    "stamps of their own, other than zero; by both, of states that come more often than once in a "
    "control period one is answered in each",
    choices=("reliable", "sensor_data"),
)

SENSOR_TOLERANCE = Setting(
    "sensor_tolerance",
    0.05,
    "with state_qos sensor_data: largest difference between the stamp of joint_states and the "
    "newest imu, odom or else of the same state; a period of the slowest sensor, and its latency "
    "[s]",
    minimum=0.0,
    maximum=10.0,
)
VELOCITY_FILTER = Setting(
    "velocity_filter",
    0.0,
    "where joint_states have no velocities, those are differences of positions, through a low-pass "
    "filter of this time constant; with state_qos sensor_data a control period by default; 0: "
    "such states are refused [s]",
    minimum=0.0,
    maximum=10.0,
)
BASE_FROM = Setting(
    "base_from",
    "auto",
    "what tells of a free base: imu (sensor_msgs/Imu), how it is turned and turns, for a policy "
    "that reads no more of it; odom (nav_msgs/Odometry), all; auto: imu where it is enough",
    choices=("auto", "imu", "odom"),
)
BASE_FRAME = Setting(
    "base_frame",
    "",
    "name of the base's frame in odom, imu and cmd_vel, such as base_link; empty: the model's name "
    "of it",
)
IMU_FRAME = Setting(
    "imu_frame",
    "",
    "the model's site or body at which the IMU sits; empty: the one that the messages on imu name",
)
SHADOW = Setting(
    "shadow",
    False,
    "whether to command nothing and to say what is wrong with a robot that runs: its sensors, its "
    "joints' order, and the policy's answers beside what drives it now",
)
_PERIOD = 1.0  # over which figures are taken [s]
_RISE = 0.05  # time from rest to the largest torque, which a real robot's rate limit allows [s]
_OF_REAL_ROBOTS: dict[str, Any] = {
    "safe_action": "stand",
    "tilt_limit": 1.2,
    "joint_margin": 0.5,
    "joint_speed_limit": 100.0,
}
_LOADED = {"robot", "training", "_supervisor", "_states", "_collector", "_sensors", "_times"}
_LOADED |= {"_clock_jumps"}


class Controller(LifecycleNode):
    """Answers each state with a command, while it is active.

    With `needs_policy` no state is answered before there is a policy.

    Attributes:
        robot: what it has to know of the task.
        health: the node's diagnostics.
        instructions: what it is told as it runs, commands and a clock.
        training: the policy and the trajectory distributions of a training.
    """

    def __init__(self, name: str, *, needs_policy: bool):
        super().__init__(name)
        self.robot = _robot(declare(self, DEPLOYED_TASK))
        self._needs_policy = needs_policy
        self._sender = CommandSender(self, self.robot.controls.names)
        self._is_real = declare(self, STATE_QOS) == "sensor_data"
        self._is_shadow = declare(self, SHADOW)
        self._frames = {s.name: declare(self, s) for s in (BASE_FRAME, IMU_FRAME)}
        smoothing = self.robot.time_step if self._is_real else 0.0
        filtered = replace(VELOCITY_FILTER, default=smoothing)
        for setting in (SENSOR_TOLERANCE, filtered, BASE_FROM):
            declare(self, setting)
        self.prepare_law()
        for setting in (POLICY_FILE, DISTRIBUTION_FILE):
            declare(self, setting, may_change=True)
        declare(self, SETTLE_DURATION)
        when_alone = self._start if declare(self, AUTOSTART) else self._tell_how_to_start
        limits = tuple(self.robot.controls.largest.tolist())
        rate = max(limits) / _RISE if max(limits) < CONTROL_BOUND else 0.0
        usual = {**_OF_REAL_ROBOTS, "torque_rate_limit": rate} if self._is_real else {}
        settings = SafetySettings(torque_limits=limits, **usual)
        self._settings = declare_settings(self, settings)
        if self._is_shadow:  # which judges each state anew
            self._settings = replace(self._settings, recovery="automatic")
        self._poses = declare_settings(self, PoseSettings())
        base_frame = StateMessages(self.robot.layout, **self._frames).base_frame
        robot = self.robot
        unrest = Unrest.of(robot.signals, robot.layout, robot.initial_state)
        waking = Waking(unrest, robot.time_step) if unrest else None
        self.instructions = Instructions(self, self.robot.signals, base_frame, waking)
        self._told_of = self.robot.signals, self.robot.controls.names
        owns = [] if self._is_shadow else self._sender.topics
        self.health = Health(self, owns=owns, when_alone=when_alone)
        self.instructions.report_to(self.health)
        self._until: float | None = None  # when a deactivation ends, by the steady clock [s]
        self._set_active(False)
        if not self._is_shadow:
            self._sender.open(self.health)
        self._watchdog = steady_timer(self, self.robot.time_step, self._watch)
        self._watchdog.cancel()  # until there is a first answer
        self._emergency = ""  # why nothing may move
        self._is_starting = False  # True while it configures itself, and ends where it cannot
        self._since = 0.0  # when it was activated [s]
        stop = self._take_emergency_stop
        for qos in (LATEST, COMMANDED):  # whatever its sender guarantees
            self.create_subscription(Bool, EMERGENCY_STOP, stop, qos)
        self.create_service(SetBool, f"~/{EMERGENCY_STOP}", self._answer_emergency_stop)
        self._pose: PoseMotion | None = None  # what the robot does in place of the law
        self._has_law = True  # whether the law drives once the pose is reached
        for name in ("drive", "stand", "hold", "sit"):
            self.create_service(Trigger, f"~/{name}", partial(self._answer_pose, name))

    @abstractmethod
    def prepare_law(self) -> None:
        """Declares the parameters that only this controller has, and prepares its law."""

    @abstractmethod
    def law(self, state: Array, stamp: int, context: Array) -> Array:
        """Returns the control in a usable state, shape (n_u,).

        Args:
            state: x, shape (n_x,).
            stamp: its stamp [ns].
            context: the commands and the clock in it, shape (n_z,).

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
        elif not self._emergency:
            self.trigger_activate()
        self._is_starting = False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Loads the policy and the task, and listens to the robot's sensors."""
        try:
            self._load()
        except VgpsError as error:
            self._refusal = str(error)
            self._free()
            if not self._is_starting:  # then it is the last that the node says
                self.health.report("configuration", error=f"Not configured: {error}")
            return TransitionCallbackReturn.FAILURE
        self.health.clear("configuration")
        return super().on_configure(state)

    def _load(self) -> None:
        self._kept = {*self.subscriptions, *self.publishers}
        if "robot" not in vars(self):  # it was freed
            self.robot = _robot(value(self, DEPLOYED_TASK))
            if (self.robot.signals, self.robot.controls.names) != self._told_of:
                raise InvalidInputError(
                    f"The task {self.robot.name} has other commands, clock or controls than at the "
                    "node's start, from which its parameters are: start the node again."
                )
        settings, poses, robot = self._settings, self._poses, self.robot
        time_step = robot.time_step
        self._times = AnswerTimes(self.health, time_step)
        self._standing = robot.pose("stand_keyframe", poses.stand_keyframe)
        self._sitting = robot.pose("sit_keyframe", poses.sit_keyframe)
        # A policy that comes before activation is kept for it.
        self.training = TrainingResults(
            self,
            robot,
            self.health,
            needs_policy=self._needs_policy,
            needs_distribution=settings.needs_distribution,
        )
        self._controls = controls = self.training.controls
        self._sender.configure(controls)
        self._carrying = robot.standing(poses.stand_keyframe, controls)
        self._supervisor = Supervisor(
            settings,
            controls,
            time_step,
            robot.limits.broken,
            StateLimits(settings, robot.layout, robot.initial_state),
            self._carrying,
            self.training.marginals,
        )
        # Of a real robot no other node of this project tells it, and a bag needs it.
        self.create_publisher(String, MJCF, LATEST).publish(String(data=robot.mjcf))
        self._states = StateMessages(robot.layout, is_blind=self._is_blind(), **self._frames)
        self._look: Look | None = None
        if self._is_shadow:
            given = robot, self._states, self._sender, self.training
            self._look = Look(self, self.health, *given)
        else:
            gains = gains_to_msg(controls, self.get_clock().now().to_msg())
            self.create_publisher(SignalsMsg, GAINS, LATEST).publish(gains)
        also = " (and odom, if they lack the base)" * (self._states.sources != self._states.needed)
        source = "the robot's drivers" if self._is_real else "simulation"
        self._awaited = f"{' and '.join(self._states.needed)}{also} from {source}"
        self._collector = NewestMeasurements(
            self._states,
            value(self, SENSOR_TOLERANCE) if self._is_real else time_step / 2,
            time_step,
            value(self, VELOCITY_FILTER),
            self._tell_differences,
            is_simulated=not self._is_real,
        )
        self._sensors = {}
        for name, sensor in self._states.sources.items():
            has_many = name == JOINTS or self._is_shadow
            real = PARTS_OF_SENSORS if has_many else NEWEST_OF_SENSORS
            events = SubscriptionEventCallbacks(incompatible_qos=partial(self._tell_qos, name))
            take, qos = partial(self._take_measurement, name), real if self._is_real else NEWEST
            made = self.create_subscription(sensor, name, take, qos, event_callbacks=events)
            self._sensors[name] = made
        # With use_sim_time; the state of the time 0, which says so too, may be lost.
        self._clock_jumps = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            post_callback=lambda _: self._supervisor.forget_time(),
        )

    def _tell_differences(self) -> None:
        """Says that velocities of joints are none that a sensor measures."""
        time = value(self, VELOCITY_FILTER)
        words = f"differences of positions, filtered over {time:g} s (velocity_filter)"
        self.health.set_value("joint velocities", words)
        self.get_logger().warning(f"joint_states have no velocities: they are {words}.")

    def _tell_qos(self, topic: str, _: object) -> None:
        """Reports who sends measurements that never arrive: only reliability can differ."""
        topic = self.resolve_topic_name(topic)
        names = [
            f"{sender.node_namespace.rstrip('/')}/{sender.node_name}"
            for sender in self.get_publishers_info_by_topic(topic)
            if sender.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
        ]
        sentence = (
            f"{' and '.join(names) or 'A node'} sends {topic} by best effort, but this node takes "
            "it reliably only, so that nothing arrives; start it with state_qos:=sensor_data."
        )
        self.health.report("qos", error=sentence)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Frees what was loaded."""
        self._free()
        return super().on_cleanup(state)

    def _free(self) -> None:
        self._finish()
        for subscription in [each for each in self.subscriptions if each not in self._kept]:
            self.destroy_subscription(subscription)
        for publisher in [each for each in self.publishers if each not in self._kept]:
            self.destroy_publisher(publisher)
        if jumps := vars(self).get("_clock_jumps"):
            jumps.unregister()
        self.health.clear("qos")
        for name in _LOADED & vars(self).keys():
            delattr(self, name)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Starts the commands, unless there is an emergency stop."""
        if self._emergency:
            self.get_logger().error(f"Not activated: {self._emergency} Release it first.")
            return TransitionCallbackReturn.FAILURE
        self._finish()
        self._supervisor.begin()
        self._set_active(True)
        self._take_pose("drive")
        if self._look:
            self._look.begin()
        self.training.wait()
        self.health.wait_for(self._awaited)
        self._since = time.monotonic()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lets the safe action drive for a while, and then stops the commands."""
        self._leave(value(self, SETTLE_DURATION))
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops the commands, at the lifecycle's end and where a transition failed."""
        self.stop()
        return super().on_shutdown(state)

    on_error = on_shutdown

    def stop(self) -> None:
        """Stops the commands: the last one leaves the robot at rest, since motors may hold it."""
        self._leave(0.0)
        self._finish()

    def _leave(self, settle: float) -> None:
        """Lets the safe action drive for a time [s], where the law did."""
        if not self._active:
            return
        self._set_active(False)
        self._set_pose(None)
        self._until = time.monotonic() + settle
        self._supervisor.stop_driving("the node is deactivated.")
        self.training.stop_waiting()
        self.health.stop_waiting(self._awaited)
        if self._watchdog.is_canceled() or not settle:  # or no state was answered
            self._finish()

    def _finish(self) -> None:
        """Ends a deactivation: sends the last command."""
        if self._until is None:
            return
        self._until = None
        if self._look:
            self._look.end()
        self._watchdog.cancel()
        self.health.clear("state", "distance", "sensors")
        if last := self._supervisor.stop():
            self.health.publish()  # a recording must know that this command is no policy's
            self._send(last)

    def _take_emergency_stop(self, wanted: Bool | SetBool.Request) -> None:
        """Lets the safe action drive until the stop is released and the node activated again."""
        before, self._emergency = self._emergency, "There is an emergency stop." * wanted.data
        if self._active and self._emergency and not before:
            self._supervisor.stop_driving("there is an emergency stop.", is_frozen=True)
            self._watch()

    def _answer_emergency_stop(
        self, request: SetBool.Request, response: SetBool.Response
    ) -> SetBool.Response:
        self._take_emergency_stop(request)
        response.success = True
        response.message = self._emergency or "Released; deactivate and activate, to drive again."
        return response

    def _answer_pose(
        self, name: str, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        is_driving = self._active and not self._is_shadow
        response.success = is_driving and not self._supervisor.is_latched
        if response.success:
            self._take_pose(name, is_driven=self._pose is None)
            response.message = f"It {self._pose.name}." if self._pose else "It is driven."
        elif self._is_shadow:
            response.message = "It is a shadow, which moves nothing: start it without shadow."
        elif self._active and not self._supervisor.has_stopped:
            fault = self._supervisor.fault
            response.message = f"Deactivate and activate the node first: {fault}"
        else:
            response.message = self._emergency or "Nothing moves: activate the node again first."
        return response

    def _take_pose(self, name: str, *, is_driven: bool = False) -> None:
        """Lets the robot go to a pose and stay there, or then be driven by the law.

        One on a free base that the law drives has feet in the air: it begins as it stands.
        """
        poses, controls, self._has_law = self._poses, self._controls, name == "drive"
        says, goal, duration = {
            "drive": ("stands up", self._standing, poses.stand_duration),
            "stand": ("stands up", self._standing, poses.stand_duration),
            "hold": ("holds its pose", None, 0.0),
            "sit": ("sits down", self._sitting if poses.sit_keyframe else None, poses.sit_duration),
        }[name]
        is_short = self._is_shadow or (self._has_law and not duration)
        first = self._standing if is_driven and self.robot.layout.base else None
        last = self._carrying if is_driven else self._supervisor.last_control
        given = says, controls, poses, goal, duration, first, last
        self._set_pose(None if is_short else PoseMotion(*given))

    def _set_pose(self, pose: PoseMotion | None) -> None:
        self._pose = pose
        if policy := self.training.policy:
            policy.forget()  # when it drives next, it begins anew
        self._collector.takes_all = pose is not None  # PD chatters where it is slow
        self.health.set_value(POSE, pose.name if pose else "")
        self.health.publish()  # a recording must know when the law drives

    def _set_active(self, is_active: bool) -> None:
        self._active = is_active
        self.health.set_value(IS_ACTIVE, is_active)
        self.health.set_value(SAFE_ACTION, False)

    def _is_blind(self) -> bool:
        """Returns whether the IMU alone tells of a free base.

        Raises:
            InvalidInputError: base_from says so, but something reads the base's place or velocity.
        """
        wanted, base = value(self, BASE_FROM), self.robot.layout.base
        if wanted == "odom" or base is None:
            return False
        place = ["plans"]  # which follow the whole state
        if self._needs_policy:
            read = self.training.observation.readings, self.robot.limits.readings
            place = readings_of_place(base, self.robot.initial_state, *read)
        if place and wanted == "imu":
            raise InvalidInputError(
                f"base_from is imu, but {', '.join(place)} need the place or the velocity of the "
                "base, which no IMU measures: set base_from to odom."
            )
        return not place

    def _take_measurement(self, topic: str, message: Any) -> None:
        if not self._active and self._until is None:
            return
        waiting, messages = [message], None
        # Of a real robot the newest state is answered, whatever else waits.
        while self._is_real and (
            taken := self._sensors[topic].handle.take_message(type(message), False)
        ):
            waiting.append(taken[0])
        for each in waiting:
            if self._look:
                self._look.hear(topic, each)
            messages = self._collector.add(topic, each) or messages
        if messages:
            self.health.clear("sensors")
            self._take_state(messages)
        elif (
            self._watchdog.is_canceled()
            and time.monotonic() - self._since > _PERIOD
            and (missing := self._collector.missing())
        ):
            self.health.report("sensors", error=f"No state is complete: {missing} did not come.")

    def _take_state(self, messages: dict[str, Any]) -> None:
        self.health.arrived(self._awaited)
        self.health.clear("qos")
        has_policy = self.training.policy is not None or not self._needs_policy
        if (pose := self._pose) and pose.is_reached and self._has_law and has_policy:
            self._set_pose(pose := None)
        if not (pose or has_policy):
            return
        if self._watchdog.is_canceled():
            self._watchdog.reset()
        began, context = time.monotonic(), NO_CONTEXT

        def current_context() -> Array:
            nonlocal context
            context = self.instructions.at(stamp, state)
            self.instructions.publish(context, stamp)
            return context

        try:
            state = self._states.join(messages)
            stamp = nanoseconds(messages[JOINTS].header.stamp)
            if self._look:
                self._look.see(state, stamp)
            if self._is_real and stamp == 0:
                raise InvalidInputError(
                    "the state's stamp is 0, but it must be the time of the measurement; let the "
                    "robot's driver set it."
                )
            command = self._supervisor.answer(
                state,
                stamp,
                lambda: (self.get_clock().now().nanoseconds - stamp) * 1e-9,
                time.monotonic(),
                lambda: pose.control(state, stamp) if pose else self.law(state, stamp, context),
                current_context,
                is_policy=pose is None,
            )
        except InvalidInputError as error:
            command = self._supervisor.refuse(str(error), time.monotonic())
        self._send(command)
        if command and not self._supervisor.fault:
            self._times.answered(command.stamp, time.monotonic() - began)
        self._report()

    def _watch(self) -> None:
        """Sends the safe action where it is due without a state, once a control period."""
        if self._until is not None and time.monotonic() >= self._until:
            self._finish()
        elif self._active or self._until is not None:
            missing = self._collector.missing() or JOINTS
            if command := self._supervisor.watch(time.monotonic(), missing):
                self._send(command)
                self._report()

    def _send(self, command: Answer | None) -> None:
        if command and self._look:
            self._look.compare(command.control)
        elif command:
            self._sender.send(command)

    def _report(self) -> None:
        """Shows on /diagnostics who drives, and why."""
        supervisor, settings = self._supervisor, self._settings
        self.health.set_value(SAFE_ACTION, supervisor.fault is not None)
        sentence = ""
        if supervisor.fault:
            sentence = f"Safe action active ({settings.safe_action}): {supervisor.fault}"
            if self._is_shadow:
                sentence = f"The policy would not drive: {supervisor.fault}"
            if settings.recovery == "manual":
                sentence += " It stays until the node is deactivated and activated."
        self.health.report("state", error=sentence)
        self.health.report("distance", warning=supervisor.warning or "")
        if supervisor.distance is not None:
            self.health.set_value("distance from training", f"{supervisor.distance:.2f}")


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
