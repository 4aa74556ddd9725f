# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The services and the action of the ROS standard simulation_interfaces, as `simulation` has them.

docs/reference/simulation_interfaces.md tells what each of them answers.
"""

import re
import signal
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import mujoco
from rclpy.action import CancelResponse
from rclpy.node import Node
from rclpy.task import Future
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import EntityState, Result, SimulatorFeatures
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

from vgps_ros.core.checks import quoted
from vgps_ros.core.records import Array
from vgps_ros.messages.conversions import stamp_of
from vgps_ros.nodes.simulation.robot_entity import RobotEntity
from vgps_ros.nodes.simulation.run_control import QUITTING, STOPPED, RefusedError, RunControl
from vgps_ros.nodes.simulation.simulated_robot import SimulatedRobot
from vgps_ros.ros_runtime.lasting_goals import Goal, LastingGoals
from vgps_ros.ros_runtime.qos import CALLS
from vgps_ros.ros_runtime.steady_timer import steady_timer
from vgps_ros.tasks import Task

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


class Simulated(Protocol):
    """The part of the node that the services need."""

    control: RunControl
    robot: SimulatedRobot

    def initial_state(self) -> Array:
        """Returns the state at the beginning, shape (n_x,)."""
        ...

    def put(self, state: Array | None, *, time: bool) -> None:
        """Puts the robot into a state, where one is given, and its time to 0, where asked."""
        ...

    def begin(self) -> None:
        """Waits for a new command, and publishes the state that it is to answer."""
        ...


class SimulationServices:
    """Serves the standard.

    Args:
        node: the node; the names of the services are below its own.
        simulated: the simulation.
        task: its task.
    """

    def __init__(self, node: Node, simulated: Simulated, task: Task):
        self._node, self._simulated, self._task = node, simulated, task
        self._control, self._robot = simulated.control, simulated.robot
        self._entity = RobotEntity(task)
        self._goal: Goal | None = None  # whose steps are under way
        for kind, answer in {
            GetEntities: self._list,
            GetEntitiesStates: self._list_states,
            GetEntityInfo: self._tell_info,
            GetEntityState: self._tell_state,
            GetSimulationState: self._tell_simulation_state,
            GetSimulatorFeatures: self._tell_features,
            ResetSimulation: self._reset,
            SetEntityState: self._move,
            SetSimulationState: self._set_simulation_state,
            StepSimulation: self._step,
        }.items():
            name = f"~/{_name(kind)}"
            node.create_service(kind, name, partial(_answered, answer), qos_profile=CALLS)
        self._goals = LastingGoals(
            node,
            SimulateSteps,
            f"~/{_name(SimulateSteps)}",
            self._begin_goal,
            cancel_callback=self._cancel,
            goal_service_qos_profile=CALLS,
            result_service_qos_profile=CALLS,
            cancel_service_qos_profile=CALLS,
        )

    def _tell_features(self, _: Any, response: GetSimulatorFeatures.Response) -> None:
        can_move = [_HAS.ENTITY_STATE_SETTING] if self._entity.base else []
        response.features.features = sorted([*_FEATURES, *can_move])
        response.features.custom_info = (
            f"vgps_ros simulates the task {self._task.name} in MuJoCo {mujoco.__version__}. "
            "Entities can be filtered by name, category and spheres."
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
        state = self._simulated.initial_state() if scope & request.SCOPE_STATE else None
        self._simulated.put(state, time=bool(scope & request.SCOPE_TIME))

    def _tell_simulation_state(self, _: Any, response: GetSimulationState.Response) -> None:
        response.state.state = self._control.state

    def _set_simulation_state(self, request: SetSimulationState.Request, _: Any) -> None:
        was_running = self._control.running
        self._control.set(request.state.state)
        if self._control.state in (STOPPED, QUITTING):
            self._simulated.put(self._simulated.initial_state(), time=True)
        elif self._control.running != was_running:
            self._simulated.begin()
        if self._control.state == QUITTING:
            # The node ends as if somebody else had sent the signal, once its answers have gone out.
            steady_timer(self._node, _FAREWELL, lambda: signal.raise_signal(signal.SIGTERM))

    def _step(self, request: StepSimulation.Request, _: Any) -> Future:
        answer = Future()

        def end(result: Result) -> None:
            answer.set_result(StepSimulation.Response(result=result))

        self._control.begin_steps(request.steps, end)
        self._simulated.begin()
        return answer

    def _begin_goal(self, goal: Goal) -> None:
        def tell(done: int, left: int) -> None:
            feedback = SimulateSteps.Feedback(completed_steps=done, remaining_steps=left)
            goal.publish_feedback(feedback)

        try:
            self._control.begin_steps(goal.request.steps, partial(self._end_goal, goal), tell)
        except RefusedError as error:
            self._end_goal(goal, error.result)
        else:
            self._goal = goal
            self._simulated.begin()

    def _end_goal(self, goal: Goal, result: Result) -> None:
        self._goal = None
        is_good = result.result == Result.RESULT_OK
        self._goals.end(goal, SimulateSteps.Result(result=result), is_good=is_good)

    def _cancel(self, goal: Goal) -> CancelResponse:
        if self._goal is not None and self._goal.goal_id == goal.goal_id:
            self._control.interrupt("The steps were cancelled before the last one.")
        return CancelResponse.ACCEPT

    # The robot as the only entity

    def _found(self, request: GetEntities.Request | GetEntitiesStates.Request) -> list[str]:
        passes = self._entity.passes(request.filters, self._robot.state)
        return [self._entity.name] if passes else []

    def _check_name(self, name: str) -> None:
        if name != self._entity.name:
            sentence = f"There is no entity {quoted(name)}, only {quoted(self._entity.name)}."
            raise RefusedError(Result.RESULT_NOT_FOUND, sentence)

    def _entity_state(self) -> EntityState:
        robot = self._robot
        return self._entity.state(robot.state, robot.control, stamp_of(robot.stamp))

    def _list(self, request: GetEntities.Request, response: GetEntities.Response) -> None:
        response.entities = self._found(request)

    def _list_states(
        self, request: GetEntitiesStates.Request, response: GetEntitiesStates.Response
    ) -> None:
        response.entities = self._found(request)
        response.states = [self._entity_state() for _ in response.entities]

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
        self._simulated.put(self._entity.moved(self._robot.state, request.state), time=False)


def _name(kind: Any) -> str:
    """Returns the standard's name for what serves a type: get_entities for GetEntities."""
    return re.sub("(?<!^)(?=[A-Z])", "_", kind.__name__).lower()


def _answered(answer: Callable[[Any, Any], Future | None], request: Any, response: Any) -> Any:
    """Returns the response, or a future of it, with the outcome."""
    result = Result(result=Result.RESULT_OK)
    try:
        later = answer(request, response)
    except RefusedError as error:
        later, result = None, error.result
    if later is not None:
        return later
    if hasattr(response, "result"):
        response.result = result
    return response
