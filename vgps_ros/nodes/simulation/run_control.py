# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A simulation's state and its transitions, as the ROS standard simulation_interfaces has them."""

from collections.abc import Callable

from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import SetSimulationState

from vgps_ros.core.errors import VgpsError

STOPPED, PLAYING = SimulationState.STATE_STOPPED, SimulationState.STATE_PLAYING
PAUSED, QUITTING = SimulationState.STATE_PAUSED, SimulationState.STATE_QUITTING
_NAMES = {STOPPED: "stopped", PLAYING: "playing", PAUSED: "paused", QUITTING: "quitting"}
_CODES = SetSimulationState.Response


class RefusedError(VgpsError):
    """A request that fails.

    Attributes:
        result: the code that the standard has for it, and a sentence on what would be right.
    """

    def __init__(self, code: int, sentence: str):
        super().__init__(sentence)
        self.result = Result(result=code, error_message=sentence)


class RunControl:
    """Keeps whether a simulation is stopped, plays, is paused, does a number of steps, or quits."""

    def __init__(self, *, paused: bool):
        self._state = PAUSED if paused else PLAYING
        self._failure = ""  # why the robot cannot go on from its state
        self._steps_done = self._steps_left = 0
        self._tell: Callable[[int, int], None] = lambda *_: None
        self._end: Callable[[Result], None] | None = None  # what is called after the last step

    @property
    def is_stepping(self) -> bool:
        """True while a number of steps is under way."""
        return self._end is not None

    @property
    def running(self) -> bool:
        """True while the simulation plays or does steps."""
        return self.is_stepping or self._state == PLAYING

    @property
    def state(self) -> int:
        """The state as others see it: while it steps, it plays."""
        return PLAYING if self.running else self._state

    def set(self, wanted: int) -> None:
        """Plays, pauses, stops or quits; steps that were under way end early.

        Raises:
            RefusedError: there is no such state, or it does not follow upon the present one.
        """
        if wanted not in _NAMES:
            valid = ", ".join(f"{value} ({name})" for value, name in _NAMES.items())
            sentence = f"The state is {wanted}, but it must be one of {valid}."
            raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, sentence)
        if self._state == QUITTING:
            sentence = "The simulation is quitting already; start another one."
            raise RefusedError(_CODES.INCORRECT_TRANSITION, sentence)
        if wanted == self.state:
            until = " until its last step; pause it first, to play on" if self.is_stepping else ""
            sentence = f"The simulation is {_NAMES[wanted]} already{until}."
            raise RefusedError(_CODES.ALREADY_IN_TARGET_STATE, sentence)
        if (self._state, wanted) == (STOPPED, PAUSED):
            sentence = "A stopped simulation cannot be paused: play it, pause it, and reset it."
            raise RefusedError(_CODES.INCORRECT_TRANSITION, sentence)
        if wanted == PLAYING and self._failure:
            raise RefusedError(_CODES.STATE_TRANSITION_ERROR, self._failure)
        self.interrupt(f"The simulation was set to {_NAMES[wanted]} before the last step.")
        self._state = wanted

    def interrupt(self, sentence: str) -> None:
        """Ends steps that are under way; their caller gets the sentence."""
        self._end_steps(RefusedError(Result.RESULT_OPERATION_FAILED, sentence).result)

    def fail(self, sentence: str) -> None:
        """Pauses, since the robot cannot go on from its state."""
        self._state, self._failure = PAUSED, sentence
        self.interrupt(sentence)

    def recover(self) -> None:
        """Notes that the robot has another state, from which it can go on."""
        self._failure = ""

    def begin_steps(
        self,
        steps: int,
        end: Callable[[Result], None],
        tell: Callable[[int, int], None] = lambda *_: None,
    ) -> None:
        """Begins a number of steps.

        Args:
            steps: how many.
            end: is called with the outcome after the last step.
            tell: is called after each step, with how many are done and how many are left.

        Raises:
            RefusedError: it cannot step now.
        """
        sentence = self._failure
        if steps < 1:
            sentence = f"steps is {steps}, but it must be at least 1."
        elif self.running or self._state != PAUSED:
            doing = "stepping already" if self.is_stepping else _NAMES[self._state]
            sentence = (
                f"The simulation is {doing}; it must be paused before it can step: set its state "
                f"to {PAUSED}."
            )
        if sentence:
            raise RefusedError(Result.RESULT_OPERATION_FAILED, sentence)
        self._steps_done, self._steps_left = 0, steps
        self._end, self._tell = end, tell

    def step_done(self) -> None:
        """Counts a step."""
        if not self.is_stepping:
            return
        self._steps_done += 1
        self._steps_left -= 1
        self._tell(self._steps_done, self._steps_left)
        if self._steps_left == 0:
            self._end_steps(Result(result=Result.RESULT_OK))

    def _end_steps(self, result: Result) -> None:
        end, self._end = self._end, None
        if end is not None:
            end(result)
