# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The services and the action of the ROS standard simulation_interfaces, as `simulation` has them.

docs/reference/simulation_interfaces.md tells what each of them answers.
"""

import re
import signal
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import mujoco
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import EntityState, Result, SimulationState, SimulatorFeatures
from simulation_interfaces.srv import (
    GetEntities,
    GetEntitiesStates,
    GetEntityInfo,
    GetEntityState,
    GetSimulationState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetEntityState,
    SetSimulationState,
    StepSimulation,
)

from vgps_ros.core.checks import quote
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.nodes.simulation.robot_entity import RefusedError, RobotEntity
from vgps_ros.ros_runtime.qos import CALLS
from vgps_ros.ros_runtime.services import answer_later, steady_timer
from vgps_ros.tasks import Task

if TYPE_CHECKING:
    from vgps_ros.nodes.simulation.node import SimulationNode

STOPPED, PLAYING = SimulationState.STATE_STOPPED, SimulationState.STATE_PLAYING
PAUSED, QUITTING = SimulationState.STATE_PAUSED, SimulationState.STATE_QUITTING
_NAMES = {STOPPED: "stopped", PLAYING: "playing", PAUSED: "paused", QUITTING: "quitting"}
_CODES = SetSimulationState.Response
_FAREWELL = 0.5  # between the answer to a client that wants the end, and the end [s]
_SCOPES = ResetSimulation.Request.SCOPE_TIME | ResetSimulation.Request.SCOPE_STATE
_HAS = SimulatorFeatures
_FEATURES = (
    _HAS.ENTITY_CATEGORIES,
    _HAS.ENTITY_STATE_GETTING,
    _HAS.ENTITY_INFO_GETTING,
    _HAS.SIMULATION_RESET,
    _HAS.SIMULATION_RESET_TIME,
    _HAS.SIMULATION_RESET_STATE,
    _HAS.SIMULATION_STATE_GETTING,
    _HAS.SIMULATION_STATE_SETTING,
    _HAS.SIMULATION_STATE_PAUSE,
    _HAS.STEP_SIMULATION_SINGLE,
    _HAS.STEP_SIMULATION_MULTIPLE,
    _HAS.STEP_SIMULATION_ACTION,
)


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

        `tell` is called after each step with how many are done and left, `end` with the outcome.

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


class SimulationServices:
    """Serves the standard below the node's name."""

    def __init__(self, node: "SimulationNode", task: Task):
        self._node, self._task = node, task
        self._control, self._robot = node.control, node.robot
        self._entity = RobotEntity(task)
        self._goal: ServerGoalHandle | None = None  # whose steps are under way
        for kind, answer in {
            GetEntities: self._list_entities,
            GetEntitiesStates: self._list_entities,
            GetEntityInfo: self._tell_info,
            GetEntityState: self._tell_state,
            GetSimulationState: self._tell_simulation_state,
            GetSimulatorFeatures: self._tell_features,
            ResetSimulation: self._reset,
            SetEntityState: self._move,
            SetSimulationState: self._set_simulation_state,
            StepSimulation: self._step,
        }.items():
            call = partial(_answer, answer)
            answer_later(node.create_service(kind, f"~/{_name(kind)}", call, qos_profile=CALLS))
        ActionServer(
            node,
            SimulateSteps,
            f"~/{_name(SimulateSteps)}",
            lambda _: None,  # a goal is executed once it has its result
            handle_accepted_callback=self._begin_goal,
            cancel_callback=self._cancel,
            goal_service_qos_profile=CALLS,
            result_service_qos_profile=CALLS,
            cancel_service_qos_profile=CALLS,
        )

    def _tell_features(self, _: Any, response: GetSimulatorFeatures.Response) -> None:
        can_move = (_HAS.ENTITY_STATE_SETTING,) if self._entity.base else ()
        response.features.features = sorted(_FEATURES + can_move)
        response.features.custom_info = (
            f"vgps_ros simulates the task {self._task.name} in MuJoCo {mujoco.__version__}. "
            "Entities can be filtered by name and category."
        )

    # The run of the simulation

    def _reset(self, request: ResetSimulation.Request, _: Any) -> None:
        scope = request.scope or request.SCOPE_ALL
        if scope not in (*range(_SCOPES + 1), request.SCOPE_ALL):
            sentence = (
                f"The scope is {scope}, but it must be 0 or 255 (all), 1 (time), 2 (state) or 3 "
                "(both): nothing can be spawned."
            )
            raise RefusedError(Result.RESULT_FEATURE_UNSUPPORTED, sentence)
        self._control.interrupt("The simulation was reset before the last step.")
        state = self._node.initial_state() if scope & request.SCOPE_STATE else None
        self._node.put(state, time=bool(scope & request.SCOPE_TIME))

    def _tell_simulation_state(self, _: Any, response: GetSimulationState.Response) -> None:
        response.state.state = self._control.state

    def _set_simulation_state(self, request: SetSimulationState.Request, _: Any) -> None:
        was_running = self._control.running
        self._control.set(request.state.state)
        if self._control.state in (STOPPED, QUITTING):
            self._node.put(self._node.initial_state(), time=True)
        elif self._control.running != was_running:
            self._node.begin()
        if self._control.state == QUITTING:
            # The node ends as if somebody else had sent the signal, once its answers have gone out.
            steady_timer(self._node, _FAREWELL, lambda: signal.raise_signal(signal.SIGTERM))

    def _step(self, request: StepSimulation.Request, _: Any) -> Future:
        answer = Future()

        def end(result: Result) -> None:
            answer.set_result(StepSimulation.Response(result=result))

        self._control.begin_steps(request.steps, end)
        self._node.begin()
        return answer

    def _begin_goal(self, goal: ServerGoalHandle) -> None:
        def tell(done: int, left: int) -> None:
            feedback = SimulateSteps.Feedback(completed_steps=done, remaining_steps=left)
            goal.publish_feedback(feedback)

        def end(result: Result) -> None:
            def finish(_: ServerGoalHandle) -> SimulateSteps.Result:
                if result.result == Result.RESULT_OK:  # a wish to cancel may have come too late
                    goal.succeed()
                elif goal.is_cancel_requested:
                    goal.canceled()
                else:
                    goal.abort()
                return SimulateSteps.Result(result=result)

            if self._goal is goal:
                self._goal = None
            goal.execute(finish)

        try:
            self._control.begin_steps(goal.request.steps, end, tell)
        except RefusedError as error:
            end(error.result)
        else:
            self._goal = goal
            self._node.begin()

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if self._goal is not None and self._goal.goal_id == goal.goal_id:
            self._control.interrupt("The steps were cancelled before the last one.")
        return CancelResponse.ACCEPT

    # The robot as the only entity

    def _check_name(self, name: str) -> None:
        if name != self._entity.name:
            sentence = f"There is no entity {quote(name)}, only {quote(self._entity.name)}."
            raise RefusedError(Result.RESULT_NOT_FOUND, sentence)

    def _entity_state(self) -> EntityState:
        robot = self._robot
        return self._entity.state(robot.state, robot.control, stamp_of(robot.stamp))

    def _list_entities(self, request: Any, response: Any) -> None:
        """Answers GetEntities, and GetEntitiesStates with the states."""
        if self._entity.passes(request.filters):
            response.entities = [self._entity.name]
            if isinstance(response, GetEntitiesStates.Response):
                response.states = [self._entity_state()]

    def _tell_info(self, request: GetEntityInfo.Request, response: GetEntityInfo.Response) -> None:
        self._check_name(request.entity)
        response.info = self._entity.info

    def _tell_state(
        self, request: GetEntityState.Request, response: GetEntityState.Response
    ) -> None:
        self._check_name(request.entity)
        response.state = self._entity_state()

    def _move(self, request: SetEntityState.Request, _: Any) -> None:
        self._check_name(request.entity)
        self._node.put(self._entity.moved(self._robot.state, request.state), time=False)


def _name(kind: Any) -> str:
    """Returns the standard's name for what serves a type: get_entities for GetEntities."""
    return re.sub("(?<!^)(?=[A-Z])", "_", kind.__name__).lower()


def _answer(answer: Callable[[Any, Any], Future | None], request: Any, response: Any) -> Any:
    """Returns the response, or a future of it, with the outcome."""
    result = Result(result=Result.RESULT_OK)
    try:
        if later := answer(request, response):
            return later
    except RefusedError as error:
        result = error.result
    if hasattr(response, "result"):
        response.result = result
    return response
