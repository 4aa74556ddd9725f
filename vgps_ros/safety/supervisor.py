# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Decides for each state whether the policy drives, or the safe action.

States must come in the order of their stamps:

- A state with the stamp of the newest state is a repetition, and is answered again.
- The stamp 0 starts a new time, as after the reset of a simulation.
- A state with any other older stamp was overtaken, as networks do, and is left out with a warning.
  It tells nothing that the newest one does not, so the policy goes on.
- After `forget_time`, or once no usable state has come for `state_timeout`, any stamp begins anew.

The rule uses no clock, because states and /clock are different topics and either may come first. A
robot without stamps (all are 0) is not checked for order.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.observation import NO_CONTEXT
from vgps_ros.core.records import Array
from vgps_ros.robot.controls import Controls
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.state_limits import StateLimits
from vgps_ros.safety.training_marginals import TrainingMarginals, nearest_of


@dataclass(frozen=True)
class Answer:
    """A control that must be sent to the robot.

    Attributes:
        control: u, shape (n_u,).
        stamp: stamp of the state that it answers [ns].
    """

    control: Array
    stamp: int


class Supervisor:
    """Answers states with commands. Each argument `now` is a time of a steady clock [s].

    Args:
        settings: conditions for usable states, and the safe action.
        controls: what the robot's controls are.
        period: control period [s].
        broken_limit: says which limit of the task a state breaks; empty where none is broken.
        limits: limits that hold for every task.
        standing: the control by which a robot on a free base stands, shape (n_u,).
        marginals: training marginals by trajectory index.

    Attributes:
        marginals: training marginals by trajectory index. They may be replaced at any time.
        fault: the reason why the safe action drives, or None while the policy drives.
        has_stopped: whether the fault stays until it begins again.
        warning: a sentence on what somebody should look at, or None.
        distance: distance of the newest state from the marginals, or None if it is not measured.

    Raises:
        InvalidInputError: the settings do not suit the controls.
    """

    def __init__(
        self,
        settings: SafetySettings,
        controls: Controls,
        period: float,
        broken_limit: Callable[[Array], str] = lambda _: "",
        limits: StateLimits | None = None,
        standing: Array | None = None,
        marginals: dict[int, TrainingMarginals] | None = None,
    ):
        self.marginals = {} if marginals is None else marginals
        self.distance: float | None = None
        self._settings, self._controls = settings, controls
        self._broken_limit, self._limits, self._standing = broken_limit, limits, standing
        settings.check_suits(controls)
        self._limiter = ControlLimiter(settings, controls, period)
        self._stamp = -1  # of the newest usable state
        self._context = NO_CONTEXT  # in that state
        self.begin()

    def begin(self) -> None:
        """Forgets the newest state and the fault, as after an activation."""
        self.fault: str | None = None
        self.has_stopped = self._is_frozen = False
        self.warning: str | None = None
        self._state: Array | None = None  # the newest usable state, and the time at which it came
        self._resting: Array | None = None  # the control that the safe action holds
        self._received = float("-inf")
        self._newest = -1  # the stamp with which the next state's is compared

    def stop_driving(self, reason: str, *, is_frozen: bool = False) -> None:
        """Lets the safe action drive for this reason, until it begins again.

        A robot that is frozen stays where it is, whatever the safe action is.
        """
        self.fault, self.has_stopped = reason, True
        if is_frozen and not self._is_frozen:
            self._is_frozen, self._resting = True, None

    @property
    def last_control(self) -> Array | None:
        """The newest control that was sent, shape (n_u,); None where there was none."""
        return self._limiter.last_control

    @property
    def is_latched(self) -> bool:
        """Whether the safe action drives until it begins again, whatever state comes."""
        return self.has_stopped or bool(self.fault and self._settings.recovery == "manual")

    def forget_time(self) -> None:
        """Accepts any stamp next, because the clock was set back."""
        self._newest = -1

    def answer(
        self,
        state: Array,
        stamp: int,
        age: Callable[[], float],
        now: float,
        law: Callable[[], Array],
        context: Callable[[], Array] = lambda: NO_CONTEXT,
        *,
        is_policy: bool = True,
    ) -> Answer | None:
        """Returns the command that answers a state, or None if nothing must be sent.

        Args:
            state: x, shape (n_x,), finite.
            stamp: stamp of the state [ns].
            age: returns the time of the node's clock minus the stamp [s]. It is called only if the
                settings limit the age.
            now: time at which the state came.
            law: returns the policy's control for the state, shape (n_u,).
            context: returns the commands and the clock in the state, shape (n_z,). It is called
                before the law, and only for a usable state.
            is_policy: whether the law is learned, so that the state must be one that it knows.
        """
        if 0 < stamp < self._newest and self._is_fresh(now):
            self.warning = (
                f"A state came after one that is {(self._newest - stamp) * 1e-9:.2g} s newer, and "
                "was left out; if that goes on, check that only one robot publishes joint_states."
            )
            return None
        if reason := self._unusable(stamp, age) or (self._limits and self._limits.misread(state)):
            return self.refuse(reason, now)
        self._state, self._received = state, now
        self._stamp = self._newest = stamp
        self._context = context()
        control = law()
        self._fail(self._distrusted(state, control) if is_policy else None)
        if self.fault:
            return self._safe_command(now)
        self._resting = None
        control = self._limiter.limited(control, stamp, state)
        self._limiter.note(control, stamp)
        return Answer(control, stamp)

    def refuse(self, reason: str, now: float) -> Answer | None:
        """Notes the reason why a state is unusable, and returns the safe action's command."""
        self._fail(reason)
        return self._safe_command(now)

    def watch(self, now: float, missing: str = "joint_states") -> Answer | None:
        """Returns the safe action's command while there is a fault, and None otherwise.

        It must be called once in each control period, since a fault may be that no state comes.

        Args:
            now: the time [s].
            missing: the topics that a state lacks, should none have come.
        """
        if self._state is not None and not self.fault and not self._is_fresh(now):
            self._fail(
                f"no usable {missing} came for {self._settings.state_timeout:g} s; check that "
                "the simulation, or the robot's driver, is running."
            )
        return self._safe_command(now) if self.fault else None

    def stop(self) -> Answer | None:
        """Returns a last command that leaves the robot at rest, or None if none was sent before."""
        return None if self._state is None else self._sent_safely(self._held(self._state))

    def _unusable(self, stamp: int, age: Callable[[], float]) -> str | None:
        """Returns the reason why the stamp makes a state unusable, or None."""
        if stamp < 0:
            return f"the state's stamp is {stamp * 1e-9:g} s, but it must not be < 0."
        allowed = self._settings.max_state_age
        if allowed and not (difference := abs(age())) <= allowed:
            return (
                f"the state's stamp differs from the node's clock by {difference:.2g} s, but "
                f"max_state_age is {allowed:g} s; synchronise the clocks, or set use_sim_time."
            )
        return None

    def _distrusted(self, state: Array, control: Array) -> str | None:
        """Returns the reason why the policy must not drive in a usable state, or None."""
        if not np.isfinite(control).all():
            return f"the policy's output is {control} in this state; publish another policy."
        self.distance = self.warning = None
        if broken := self._broken_limit(state) or self._tilted(state):
            return broken
        settings = self._settings
        if not (settings.distance_warning or settings.distance_limit):
            return None
        nearest = nearest_of(self.marginals.values(), state, self._context)
        if nearest is None:
            return None
        self.distance = nearest.distance
        # An overflow makes the distance NaN, for which both comparisons are written to be true.
        if settings.distance_limit and not self.distance <= settings.distance_limit:
            return (
                "the state's Mahalanobis distance from the training marginals is above "
                f"distance_limit, {settings.distance_limit:g}; bring the robot back to where the "
                "policy was trained."
            )
        if settings.distance_warning and not self.distance <= settings.distance_warning:
            self.warning = (
                "The state's Mahalanobis distance from the training marginals is above "
                f"distance_warning, {settings.distance_warning:g}."
            )
        return None

    def _fail(self, reason: str | None) -> None:
        """Sets the fault, or ends it. With manual recovery the first fault stays."""
        self.fault = self.fault if self.is_latched else reason

    def _is_fresh(self, now: float) -> bool:
        return now - self._received <= self._settings.state_timeout

    def _safe_command(self, now: float) -> Answer | None:
        """Returns the safe action's command, or None before the first usable state.

        The command has the stamp of the newest usable state. A simulation in lock-step has an
        answer to that state already, so the command does not make it step.
        """
        if self._state is None:
            return None
        state = self._state if self._is_fresh(now) else None
        control = safe_control(
            *(self._settings, state, self._controls, self._held(self._state)),
            *(self.marginals.values(), self._context),
        )
        return self._sent_safely(self._limiter.clipped(control, self._state))

    def _tilted(self, state: Array) -> str:
        return self._limits.tilted(state) if self._limits else ""

    def _held(self, state: Array) -> Array:
        """Returns the control at rest where the robot stands, or where the policy stopped driving.

        If servos held each newest state instead, the robot would sink under its weight. A robot
        that walks has feet in the air: where it stopped it would tip over, so it stands at once.
        """
        if self._resting is None:
            self._resting = self._controls.holding(state)
            stands = self._settings.safe_action == "stand" and not self._is_frozen
            if stands and self._standing is not None and not self._tilted(state):
                self._resting = self._standing
        return self._resting

    def _sent_safely(self, control: Array) -> Answer:
        self._limiter.note_safe(control)
        return Answer(control, self._stamp)


def safe_control(
    settings: SafetySettings,
    state: Array | None,
    controls: Controls,
    resting: Array,
    marginals: Iterable[TrainingMarginals],
    context: Array = NO_CONTEXT,
) -> Array:
    """Returns the control of the safe action, shape (n_u,), before limits apply.

    It is that at rest if the action needs something that is missing, or if it would overflow.

    Args:
        settings: name of the action, and the damping.
        state: the newest usable state, shape (n_x,), or None.
        controls: what the robot's controls are.
        resting: the control that leaves the robot at rest, shape (n_u,).
        marginals: training marginals of the DDP solutions whose feedback law may be used.
        context: the commands and the clock in that state, shape (n_z,).
    """
    if state is None or settings.safe_action == "zero":
        return resting
    with np.errstate(over="ignore", invalid="ignore"):
        if settings.safe_action in ("damping", "stand"):
            control = controls.braking(state, settings.damping, resting)
        else:
            nearest = nearest_of(marginals, state, context)
            if nearest is None:
                return resting
            control = nearest.marginals.feedback(state, nearest.step)
    return control if np.isfinite(control).all() else resting


_Sent = tuple[int, Array | None]  # stamp [ns] and control of a command


class ControlLimiter:
    """Clips controls to limits of the torques that they ask for, and of the change of these.

    The change is measured from the control that answered the latest earlier state, or from that of
    the safe action if it was sent later. So a state that comes twice gets the same answer twice.
    If there is no such control, or if time went back, it is measured from the control at rest.

    Args:
        settings: the limits.
        controls: what the controls are.
        period: control period [s]. The change is limited as if no more time had passed.

    Raises:
        InvalidInputError: the limits do not suit the controls.
    """

    def __init__(self, settings: SafetySettings, controls: Controls, period: float):
        self._torques = settings.torques_of(controls)
        self._controls, self._period = controls, period
        self._bounds = None  # that hold in each state, of a robot without servos
        if not controls.are_servos.any():
            self._bounds = controls.bounds(np.zeros(controls.positions.shape[1]), self._torques)
        self._rate = settings.torque_rate_limit / np.abs(controls.strength)  # of u
        self._reach = self._torques / np.abs(controls.strength)  # of u, at the largest torque
        # The latest command, and the one before it. A command that answered no state has the stamp
        # -1; without a control there was none.
        self._start: _Sent = (-1, None)
        self._latest: _Sent = self._start
        self._earlier: _Sent = self._start

    def clipped(self, control: Array, state: Array) -> Array:
        """Returns a control within the limits of the torques in a state, shape (n_u,).

        A servo that is measured beyond its control's limits may stay there, and comes back with no
        more than its torque.
        """
        if self._bounds:
            return _clip(control, *self._bounds)
        controls = self._controls
        low, high = controls.bounds(state, self._torques)
        here = controls.holding(state)
        below, above = here < controls.limits[0], here > controls.limits[1]
        low = np.where(above, np.maximum(controls.limits[0], here - self._reach), low)
        high = np.where(below, np.minimum(controls.limits[1], here + self._reach), high)
        return _clip(control, np.where(below, here, low), np.where(above, here, high))

    def limited(self, control: Array, stamp: int, state: Array) -> Array:
        """Returns a control within all limits in a state with a stamp [ns], shape (n_u,)."""
        control = self.clipped(control, state)
        if not self._rate.any():
            return control
        before_stamp, before = self._before(stamp)
        elapsed = self._period
        if before_stamp >= 0:
            elapsed = min(elapsed, (stamp - before_stamp) * 1e-9)
        if before is None:
            before = self._controls.holding(state)
        return _clip(control, before - self._rate * elapsed, before + self._rate * elapsed)

    @property
    def last_control(self) -> Array | None:
        """The newest control that was sent; None where there was none."""
        return self._latest[1]

    def note(self, control: Array, stamp: int) -> None:
        """Remembers a control that was sent, from which the next change is measured."""
        self._earlier = self._before(stamp)
        self._latest = (stamp, control)

    def note_safe(self, control: Array) -> None:
        """Remembers a control of the safe action, from which the next change is measured."""
        self._latest = self._earlier = (-1, control)

    def _before(self, stamp: int) -> _Sent:
        if stamp > self._latest[0]:
            return self._latest
        return self._earlier if stamp == self._latest[0] else self._start


def _clip(values: Array, lowest: Array, highest: Array) -> Array:
    """Clips values as np.clip does, in less than half of its time."""
    return np.minimum(np.maximum(values, lowest), highest)
