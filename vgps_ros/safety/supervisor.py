"""Decides for each state who drives: the policy, or the safe action.

The order of states: a state must not be older than the newest one. A state of the same stamp is a
repeat, and is answered again. The stamp 0 begins a new time, as the reset of a simulation does; any
other that goes back is refused, until somebody says that time went back, or no usable state has
come for `state_timeout`. The rule needs no clock, since states and /clock are different topics, and
either may come first. A robot that sends no stamps (all are 0) is not checked for order.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vgps_ros.core.records import Array
from vgps_ros.safety.safe_action import safe_torques
from vgps_ros.safety.settings import SafetySettings
from vgps_ros.safety.torque_limits import TorqueLimiter
from vgps_ros.safety.training_marginals import TrainingMarginals, nearest_of


@dataclass(frozen=True)
class Command:
    """Torques to be sent.

    Attributes:
        torques: shape (n_u,), [N·m].
        stamp: of the state that they answer [ns].
    """

    torques: Array
    stamp: int


class Supervisor:
    """Follows states and gives commands. Times `now` are those of a steady clock [s].

    Args:
        settings: limits, what makes a state unusable, and what happens then.
        actuated: index of each actuated joint among the joints.
        period: of the control [s].

    Attributes:
        marginals: training marginals by trajectory index; they may be replaced at any time.
        fault: why the safe action drives; None if the policy does.
        warning: why somebody should look; None if all is well.
        distance: of the newest state from the marginals; None if it was not measured.
    """

    def __init__(self, settings: SafetySettings, actuated: list[int], period: float):
        self.marginals: dict[int, TrainingMarginals] = {}
        self.fault: str | None = None
        self.warning: str | None = None
        self.distance: float | None = None
        self._settings = settings
        self._actuated = actuated
        limits = np.array(settings.torque_limits)
        self._limiter = TorqueLimiter(limits, settings.torque_rate_limit, period)
        # The newest usable state.
        self._state: Array | None = None
        self._stamp = self._newest = -1  # the second one counts for the order
        self._received = float("-inf")

    def begin(self) -> None:
        """Starts anew, without a fault or a state."""
        self.fault = self.warning = self._state = None
        self._received = float("-inf")
        self._newest = -1

    def forget_time(self) -> None:
        """Lets a state of any stamp come next: the clock was set back."""
        self._newest = -1

    def answer(
        self,
        state: Array,
        stamp: int,
        age: Callable[[], float],
        now: float,
        law: Callable[[], Array],
    ) -> Command | None:
        """Returns the answer to a state.

        Args:
            state: x, shape (n_x,), finite.
            stamp: its time [ns].
            age: gives the time of the robot's clock less the stamp [s], where that matters.
            now: when it came.
            law: gives the policy's torques for it, shape (n_u,), [N·m].
        """
        if reason := self._unusable(stamp, age, now):
            return self.refuse(reason, now)
        self._state, self._received = state, now
        self._stamp = self._newest = stamp
        torques = law()
        self._fail(self._distrusted(state, torques))
        if self.fault:
            return self._safe_command(now)
        torques = self._limiter.limited(torques, stamp)
        self._limiter.note(torques, stamp)
        return Command(torques, stamp)

    def refuse(self, reason: str, now: float) -> Command | None:
        """Notes a state that cannot be used, and returns what goes out instead."""
        self._fail(reason)
        return self._safe_command(now)

    def watch(self, now: float) -> Command | None:
        """Returns what is to be sent without a state: the safe action, while there is a fault.

        To be called once a control period.
        """
        if self._state is not None and not self.fault and not self._is_fresh(now):
            self._fail(
                f"no usable joint_states came for {self._settings.state_timeout:g} s; is "
                "simulation, or the robot's driver, running?"
            )
        return self._safe_command(now) if self.fault else None

    def stop(self) -> Command | None:
        """Returns the last command before silence: zero torques."""
        if self._state is None:
            return None
        return self._sent_safely(np.zeros(len(self._actuated)))

    def _unusable(self, stamp: int, age: Callable[[], float], now: float) -> str | None:
        """Why a state cannot be used, from its stamp."""
        if stamp < 0:
            return f"the state's stamp is {stamp * 1e-9:g} s, but must not be < 0."
        if 0 < stamp < self._newest and self._is_fresh(now):
            late = (self._newest - stamp) * 1e-9
            return (
                f"the state's stamp is {late:.2g} s older than that of the newest one, but states "
                "must come in order; is one robot publishing joint_states?"
            )
        allowed = self._settings.max_state_age
        if allowed and not (difference := abs(age())) <= allowed:
            return (
                f"the state's stamp differs from the node's clock by {difference:.2g} s, but "
                f"max_state_age is {allowed:g} s; do the clocks agree, or is use_sim_time not set?"
            )
        return None

    def _distrusted(self, state: Array, torques: Array) -> str | None:
        """Why the policy must not drive in a usable state."""
        if not np.isfinite(torques).all():
            return f"the policy's output is {torques} in this state; publish another policy."
        self.distance = self.warning = None
        settings = self._settings
        if not (settings.distance_warning or settings.distance_limit):
            return None
        nearest = nearest_of(self.marginals.values(), state)
        if nearest is None:
            return None
        self.distance = nearest.distance
        # Written so that NaN, which is what an overflow leaves, is far away.
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
        """Sets or ends the fault; where recovery is by hand, the first cause stays."""
        if self._settings.recovery == "automatic" or not self.fault:
            self.fault = reason

    def _is_fresh(self, now: float) -> bool:
        return now - self._received <= self._settings.state_timeout

    def _safe_command(self, now: float) -> Command | None:
        """The safe action; nothing before the first usable state, when no torque is to be undone.

        It carries the stamp of the newest usable state, which a simulation in lock-step has had
        answered already: it does not move it on.
        """
        if self._state is None:
            return None
        state = self._state if self._is_fresh(now) else None
        torques = safe_torques(self._settings, state, self._actuated, self.marginals.values())
        return self._sent_safely(self._limiter.clipped(torques))

    def _sent_safely(self, torques: Array) -> Command:
        self._limiter.note_safe(torques)
        return Command(torques, self._stamp)
