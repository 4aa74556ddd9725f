# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A simulation's state and its transitions, as in the ROS standard simulation_interfaces."""

from collections.abc import Callable

from vgps_msgs.msg import Result, SimulationState

_SETTABLE = {
    SimulationState.STATE_STOPPED: "stopped",
    SimulationState.STATE_PLAYING: "playing",
    SimulationState.STATE_PAUSED: "paused",
}


def ok() -> Result:
    """Returns the outcome of a request that succeeded."""
    return Result(result=Result.RESULT_OK)


def refused(code: int, sentence: str) -> Result:
    """Returns the outcome of a request that failed, with a sentence on what would be right."""
    return Result(result=code, error_message=sentence)


class RunControl:
    """Keeps whether a simulation is stopped, plays, is paused, or does a number of steps."""

    def __init__(self, *, paused: bool):
        self._state = SimulationState.STATE_PAUSED if paused else SimulationState.STATE_PLAYING
        self._steps_left = 0
        self._stepping: Callable[[Result], None] | None = None  # what is called at the end

    @property
    def running(self) -> bool:
        """True while the simulation plays or does steps."""
        return self._stepping is not None or self._state == SimulationState.STATE_PLAYING

    @property
    def state(self) -> SimulationState:
        """The state as others see it: while it steps, it plays."""
        playing = SimulationState.STATE_PLAYING
        return SimulationState(state=playing if self.running else self._state)

    def set(self, wanted: int) -> Result:
        """Plays, pauses or stops; steps that were under way end early."""
        if wanted not in _SETTABLE:
            valid = ", ".join(f"{value} ({name})" for value, name in _SETTABLE.items())
            return refused(
                Result.RESULT_FEATURE_UNSUPPORTED,
                f"The state is {wanted}, but it must be one of {valid}; to quit, send INT or TERM.",
            )
        self.interrupt(f"The simulation was set to {_SETTABLE[wanted]} before the last step.")
        self._state = wanted
        return ok()

    def interrupt(self, sentence: str, *, pause: bool = False) -> None:
        """Ends steps that are under way; their caller gets the sentence."""
        if pause:
            self._state = SimulationState.STATE_PAUSED
        self._end_steps(refused(Result.RESULT_OPERATION_FAILED, sentence))

    def begin_steps(self, steps: int, done: Callable[[Result], None]) -> bool:
        """Begins a number of steps; returns whether it may.

        `done` is called with the outcome after the last step, or at once if there is none.
        """
        if steps < 1:
            sentence = f"steps is {steps}, but it must be at least 1."
            done(refused(Result.RESULT_OPERATION_FAILED, sentence))
            return False
        if self.running or self._state != SimulationState.STATE_PAUSED:
            doing = "stepping already" if self._stepping else _SETTABLE[self._state]
            sentence = (
                f"The simulation is {doing}; it must be paused before it can step: set its state "
                f"to {SimulationState.STATE_PAUSED}."
            )
            done(refused(Result.RESULT_INCORRECT_STATE, sentence))
            return False
        self._steps_left, self._stepping = steps, done
        return True

    def step_done(self) -> None:
        """Counts a step."""
        self._steps_left -= 1
        if self._steps_left == 0:
            self._end_steps(ok())

    def _end_steps(self, result: Result) -> None:
        done, self._stepping = self._stepping, None
        if done is not None:
            done(result)
