# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Malformed requests and messages to nodes that run: none may harm them.

MALFORMED_MESSAGES sets how many there are, MALFORMED_SEED what they are.
"""

import math
import os
import time
import uuid
from collections import deque
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from action_msgs.msg import GoalInfo, GoalStatus
from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters, SetParametersAtomically
from rosbag2_interfaces.srv import (
    Burst,
    IsPaused,
    Pause,
    Play,
    PlayNext,
    Resume,
    Seek,
    SetRate,
    TogglePaused,
)
from sensor_msgs.msg import JointState
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import EntityCategory, EntityFilters, SimulationState
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
from std_msgs.msg import String
from type_description_interfaces.srv import GetTypeDescription
from unique_identifier_msgs.msg import UUID
from vgps_msgs.action import TrainPolicy
from vgps_msgs.msg import (
    GaussianPolicy,
    LearningProgress,
    Plan,
    Signals,
    Trajectory,
    TrajectoryDistribution,
)
from vgps_msgs.srv import CancelOptimization, OptimizeTrajectory

from tests.nodes.malformed import STRINGS, broken, cut, huge
from vgps_ros.core.policy import Architecture
from vgps_ros.core.policy import GaussianPolicy as Policy
from vgps_ros.messages.conversions import (
    command_to_msg,
    distribution_to_msg,
    pack,
    policy_to_msg,
    push_to_msg,
    signals_to_msg,
    stamp_of,
    state_from_msg,
    state_to_msg,
)
from vgps_ros.messages.optimization import request_from_msg
from vgps_ros.ros_runtime.qos import LATCHED, STREAM
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.tasks import make_task

pytestmark = pytest.mark.slow

MESSAGES = int(os.environ.get("MALFORMED_MESSAGES", "1000"))
SEED = int(os.environ.get("MALFORMED_SEED", "0"))
BATCH = 50
WINDOW = 5  # calls under way at once: a service of ROS keeps ten and drops the rest
PROMPT = 1.0  # longest time for an answer [s]
HANG = 20.0  # after which a node is said to hang [s]
MAX_LATE = 3  # answers in all: the machine itself may stand still for a second now and then

SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"
ROTOR = make_task("rotor")
NAMES = ROTOR.joint_names
STAMP = stamp_of(0)
SHAPE = Architecture(ROTOR.observation.names, (2,), 1)
POLICY = Policy(SHAPE, np.linspace(-0.5, 0.5, SHAPE.num_parameters), np.ones(1))
POLICY_MESSAGE = policy_to_msg(POLICY, "rotor", 1, STAMP)
STATE = state_to_msg(np.array([0.5, -0.5]), NAMES, STAMP)
COMMAND = command_to_msg(np.array([0.5]), ROTOR.controls, STAMP)
GAINS = signals_to_msg(np.array([80.0, 3.0]), ["rotor/stiffness", "rotor/damping"], STAMP)
NO_GAINS = signals_to_msg(np.zeros(2), GAINS.names, STAMP)
FIRST = OptimizeTrajectory.Request(
    task="rotor",
    cost_scale=1.0,
    max_iterations=2,
    initial_state=pack(ROTOR.initial_state),
    guess=[Trajectory(n_x=2, n_u=1, controls=pack(np.zeros(50)))],
)
SOLVED = optimize(ROTOR, request_from_msg(FIRST, ROTOR))
DISTRIBUTION = distribution_to_msg(SOLVED.distribution, ROTOR.deployment, 0, 1, STAMP)
NEXT = OptimizeTrajectory.Request(
    task="rotor",
    iteration=1,
    cost_scale=0.5,
    max_iterations=2,
    initial_state=FIRST.initial_state,
    previous=[DISTRIBUTION],
    policy=[POLICY_MESSAGE],
)
PROGRESS = LearningProgress(task="rotor", method="vgps", iteration=1, iterations=2, alpha=0.5)
PLAN = Plan(task="rotor", time_step=0.02, cost=1.0, trajectory=DISTRIBUTION.mean)
EVENT = ParameterEvent(
    node="/simulation",
    changed_parameters=[
        Parameter(
            name="task", value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="x")
        )
    ],
)
PAUSED = SimulationState(state=SimulationState.STATE_PAUSED)
PLAYING = SimulationState(state=SimulationState.STATE_PLAYING)
FLOATING = "floating/simulation"  # of a robot with a free base
FLOATING_ARGUMENTS = (
    "-r __ns:=/floating -r /clock:=clock -r /tf:=tf -r /tf_static:=tf_static "
    "-p task:=quadruped -p start_paused:=true"
)
FILTERS = EntityFilters(
    filter="^r", categories=[EntityCategory(category=EntityCategory.CATEGORY_ROBOT)]
)


class World:
    """The whole graph for the rotor, and whether it is well."""

    def __init__(self, graph, folder):
        self.graph = graph
        self.sent = 0
        self.clients = {}
        self.publishers = {}
        self.nodes = {
            "simulation": graph.start("simulation", task="rotor", start_paused=True),
            FLOATING: graph.start("simulation", "--ros-args", *FLOATING_ARGUMENTS.split()),
            "trajectory_optimizer": graph.start("trajectory_optimizer", task="rotor"),
            "policy_executor": graph.start("policy_executor", task="rotor", autostart=False),
            "policy_learner": graph.start(
                "policy_learner", task="rotor", evaluation_rollouts=2, initial_ddp_iterations=2
            ),
            "recorder": graph.start("recorder", output=folder / "bag"),
            "visualizer": graph.start("visualizer", output=folder / "run.rrd"),
            "player": graph.start(
                "player", bag=SAMPLE, start_paused=True, loop=True, include=[".*progress"]
            ),
        }
        self.late: list[str] = []
        self.states = graph.messages(JointState, "joint_states")
        self.parameters = {name: self._parameters_of(name) for name in self.nodes}
        self.check()

    def call(self, kind, name, request=None, timeout=30.0):
        return self.calls([(kind, name, request or kind.Request())], timeout)[0]

    def calls(self, calls, timeout=PROMPT):
        """Makes calls (kind, name, request), a few at once, and returns their responses.

        Each answer must come in time after the one before; those that do not are counted.
        """
        waiting, responses = deque(), []
        for call in [*calls, *[None] * WINDOW]:
            if waiting and (len(waiting) == WINDOW or not call):
                future, made = waiting.popleft()
                began = time.monotonic()
                self.graph.spin_until(future.done, HANG, what=f"an answer to {made!r:.500}")
                if time.monotonic() - began > timeout:
                    self.late.append(f"{made!r:.500}")
                responses.append(future.result())
            if call:
                waiting.append((self.send(*call), call))
        return responses

    def send(self, kind, name, request):
        return self.client(kind, name).call_async(request)

    def client(self, kind, name):
        if name not in self.clients:
            self.clients[name] = self.graph.node.create_client(kind, name)
            self.graph.spin_until(self.clients[name].service_is_ready, what=name)
            self.graph.spin_for(0.2)  # for the service to discover the client, too
        return self.clients[name]

    def publish(self, kind, topic, messages, qos=STREAM):
        if topic not in self.publishers:
            self.publishers[topic] = self.graph.publisher(kind, topic, qos)
        for message in messages:
            self.publishers[topic].publish(message)

    def is_alive(self, *names):
        for name in names or self.nodes:
            request = GetParameters.Request(names=["wait_timeout"])
            (value,) = self.call(GetParameters, f"{name}/get_parameters", request, PROMPT).values
            assert value.double_value == 10.0

    def flood(self, strategy, share, send):
        """Draws a share of all messages and hands them over in batches."""

        @seed(SEED)
        @settings(
            max_examples=math.ceil(share * MESSAGES / BATCH),
            derandomize=False,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
            verbosity=Verbosity.quiet,
        )
        @given(st.lists(strategy, min_size=BATCH, max_size=BATCH))
        def run(batch):
            self.sent += len(batch)
            send(batch)

        run()
        self.check()

    def check(self):
        """Every node answers a valid request correctly, and no log has a traceback."""
        self.graph.spin_for(0.2)
        self.is_alive()
        for process in self.nodes.values():
            assert process.running, process.output
            assert "Traceback" not in process.output, process.output
        self._check_optimizer()
        self._check_robot()
        for node in ("recorder", "player"):
            self.call(Resume, f"{node}/resume")
            self.call(Pause, f"{node}/pause")
            assert self.call(IsPaused, f"{node}/is_paused").paused
        self.call(Resume, "recorder/resume")

    def _check_optimizer(self):
        response = self.call(OptimizeTrajectory, "trajectory_optimizer/optimize", FIRST)
        assert response.success, response.message
        assert response.cost == SOLVED.cost
        assert response.distribution.gains.tobytes() == SOLVED.distribution.gains.tobytes()

    def _check_robot(self):
        """Three steps of the simulation under the policy are those of the task's dynamics."""
        self.publish(GaussianPolicy, "policy", [POLICY_MESSAGE], LATCHED)
        self.activate()
        for state in (PLAYING, PAUSED):  # since a stopped simulation cannot be paused
            request = SetSimulationState.Request(state=state)
            self.call(SetSimulationState, "simulation/set_simulation_state", request)
        self.graph.spin_for(0.1)
        assert self.call(ResetSimulation, "simulation/reset_simulation").result.result == 1
        self.graph.spin_for(0.1)
        self.states.clear()
        steps = StepSimulation.Request(steps=3)
        assert self.call(StepSimulation, "simulation/step_simulation", steps).result.result == 1
        state = ROTOR.initial_state
        for _ in range(3):
            state = ROTOR.dynamics.step(state, POLICY.mean(ROTOR.observation(state)))

        def arrived():
            return any(np.array_equal(state_from_msg(m, NAMES), state) for m in self.states)

        self.graph.spin_until(arrived, 5.0, "the state after three steps")

    def activate(self):
        """Leads the executor to active, wherever it is."""
        for label, transition in (
            ("unconfigured", Transition.TRANSITION_CONFIGURE),
            ("inactive", Transition.TRANSITION_ACTIVATE),
        ):
            if self.call(GetState, "policy_executor/get_state").current_state.label == label:
                request = ChangeState.Request(transition=Transition(id=transition))
                assert self.call(ChangeState, "policy_executor/change_state", request).success

    def put_back(self, node):
        """Gives the node's parameters the values that it was started with."""
        parameters = [Parameter(name=n, value=v) for n, v in self.parameters[node].items()]
        request = SetParameters.Request(parameters=parameters)
        self.call(SetParameters, f"{node}/set_parameters", request)
        names = GetParameters.Request(names=list(self.parameters[node]))
        values = self.call(GetParameters, f"{node}/get_parameters", names).values
        assert values == list(self.parameters[node].values())

    def _parameters_of(self, node):
        names = self.call(ListParameters, f"{node}/list_parameters").result.names
        request = GetParameters.Request(names=names)
        values = self.call(GetParameters, f"{node}/get_parameters", request).values
        return dict(zip(names, values, strict=True))


@pytest.fixture(scope="module")
def world(shared_graph, tmp_path_factory):
    return World(shared_graph, tmp_path_factory.mktemp("world"))


def is_sentence(text):
    return 10 < len(text) < 1000 and text.endswith(".") and text.isprintable()


@pytest.mark.parametrize("valid", [FIRST, NEXT], ids=["first", "next"])
def test_requests_to_the_optimizer(world, valid):
    def send(batch):
        name = "trajectory_optimizer/optimize"
        for response in world.calls([(OptimizeTrajectory, name, request) for request in batch]):
            assert is_sentence(response.message), response.message
            if response.success:
                assert math.isfinite(response.cost + response.modified_cost)
                assert np.isfinite(response.distribution.state_covariances).all()
                assert np.isfinite(response.distribution.gains).all()
        world.call(CancelOptimization, "trajectory_optimizer/cancel")
        world.is_alive("trajectory_optimizer")

    world.flood(broken(valid), 0.03, send)


TOPICS = {
    "joint_command": (JointState, COMMAND, STREAM, ("simulation", "visualizer")),
    "push": (WrenchStamped, push_to_msg("rotor", np.ones(6)), STREAM, ("simulation",)),
    "joint_states": (JointState, STATE, STREAM, ("policy_executor", "visualizer")),
    "policy": (GaussianPolicy, POLICY_MESSAGE, LATCHED, ("policy_executor", "visualizer")),
    "trajectory_distribution": (TrajectoryDistribution, DISTRIBUTION, LATCHED, ("visualizer",)),
    "plan": (Plan, PLAN, STREAM, ("visualizer",)),
    "learning_progress": (LearningProgress, PROGRESS, STREAM, ("visualizer",)),
    "mjcf_description": (String, String(data="<mujoco/>"), LATCHED, ("visualizer",)),
    "/parameter_events": (ParameterEvent, EVENT, STREAM, ("recorder",)),
}


@pytest.mark.parametrize("topic", TOPICS)
def test_messages(world, topic):
    kind, valid, qos, takers = TOPICS[topic]

    def send(batch):
        world.publish(kind, topic, batch, qos)
        world.is_alive(*takers)

    world.flood(broken(valid) | cut(valid), 0.1, send)


def test_gains_of_joints(world):
    """Those of a motor end each batch, since the policy drives one."""

    def send(batch):
        world.publish(Signals, "joint_gains", [*batch, NO_GAINS], LATCHED)
        world.is_alive("simulation", "visualizer")

    world.flood(broken(GAINS) | cut(GAINS), 0.05, send)


@pytest.mark.parametrize("topic", ["joint_command", "joint_states", "policy"])
def test_huge_messages(world, topic):
    kind, valid, qos, takers = TOPICS[topic]
    for message in huge(valid):
        world.publish(kind, topic, [message], qos)
        world.is_alive(*takers)
    world.check()


def test_requests_to_the_simulation(world):
    services = {
        "simulation/reset_simulation": (ResetSimulation, {}),
        "simulation/set_simulation_state": (SetSimulationState, {"state": PAUSED}),
        "simulation/step_simulation": (StepSimulation, {"steps": 1}),
        "simulation/get_simulation_state": (GetSimulationState, {}),
        "simulation/get_simulator_features": (GetSimulatorFeatures, {}),
        "simulation/get_entities": (GetEntities, {"filters": FILTERS}),
        "simulation/get_entities_states": (GetEntitiesStates, {"filters": FILTERS}),
        "simulation/get_entity_info": (GetEntityInfo, {"entity": "rotor"}),
        "simulation/set_entity_state": (SetEntityState, {"entity": "rotor"}),
        f"{FLOATING}/get_entity_state": (GetEntityState, {"entity": "quadruped"}),
        f"{FLOATING}/set_entity_state": (SetEntityState, {"entity": "quadruped"}),
    }
    pause = SetSimulationState.Request(state=PAUSED)
    quitting = SimulationState.STATE_QUITTING
    requests = []
    for name, (kind, fields) in services.items():
        valid = kind.Request(**fields)
        has_fields = bool(valid.get_fields_and_field_types())
        requests.append(st.tuples(st.just(name), broken(valid) if has_fields else st.just(valid)))

    def send(batch):
        for name, request in batch:
            if isinstance(request, SetSimulationState.Request) and request.state.state == quitting:
                continue  # which is no bad request, and obeyed
            future = world.send(services[name][0], name, request)
            while not future.done():  # steps wait for commands until the simulation is paused
                world.call(SetSimulationState, "simulation/set_simulation_state", pause, PROMPT)
            if not isinstance(request, GetSimulatorFeatures.Request):
                result = future.result().result
                assert result.result == 1 or is_sentence(result.error_message), result

    world.flood(st.one_of(requests), 0.06, send)


def test_goals_for_the_simulation(world):
    """Each goal ends: it is refused, done, or ended by a pause."""
    action, name = SimulateSteps.Impl, "simulation/simulate_steps/_action"
    counts = st.sampled_from((0, 0, 1, 2, 2**32, 2**63, 2**64 - 1))
    pause = SetSimulationState.Request(state=PAUSED)
    orders = st.sampled_from(("pause", "cancel", "ask"))

    # No service answers again where it did not know its client yet.
    world.client(action.SendGoalService, f"{name}/send_goal")
    world.client(action.GetResultService, f"{name}/get_result")
    world.client(CancelGoal, f"{name}/cancel_goal")
    world.graph.spin_for(1.0)

    def send(batch):
        for steps, order in batch:
            identity = UUID(uuid=list(uuid.uuid4().bytes))
            goal = action.SendGoalService.Request(
                goal_id=identity, goal=SimulateSteps.Goal(steps=steps)
            )
            (answer,) = world.calls([(action.SendGoalService, f"{name}/send_goal", goal)])
            assert answer.accepted
            asked = action.GetResultService.Request(goal_id=identity)
            future = world.send(action.GetResultService, f"{name}/get_result", asked)
            if order == "cancel":
                info = CancelGoal.Request(goal_info=GoalInfo(goal_id=identity))
                world.call(CancelGoal, f"{name}/cancel_goal", info, PROMPT)
            while not future.done():  # steps wait for commands until the simulation is paused
                world.call(SetSimulationState, "simulation/set_simulation_state", pause, PROMPT)
            status, result = future.result().status, future.result().result.result
            if status == GoalStatus.STATUS_SUCCEEDED:
                assert result.result == 1
            else:
                assert status in (GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_CANCELED)
                assert is_sentence(result.error_message), result

    world.flood(st.tuples(counts, orders), 0.01, send)


def values_of():
    texts = st.sampled_from(STRINGS)
    return {
        "bool_value": st.booleans(),
        "integer_value": st.sampled_from((0, -1, 2**63 - 1, -(2**63))),
        "double_value": st.sampled_from((math.nan, math.inf, -1.0, 1e308)),
        "string_value": texts,
        "double_array_value": st.lists(st.sampled_from((math.nan, 1e308, 0.0)), max_size=4),
        "integer_array_value": st.lists(st.integers(-5, 5), max_size=4),
        "string_array_value": st.lists(texts, max_size=3),
        "bool_array_value": st.lists(st.booleans(), max_size=3),
    }


@pytest.mark.parametrize("together", [False, True], ids=["each", "together"])
def test_values_for_parameters(world, together):
    values = st.builds(
        ParameterValue, type=st.sampled_from((*range(10), 10, 200, 255)), **values_of()
    )

    @st.composite
    def request(draw):
        node = draw(st.sampled_from(sorted(world.nodes)))
        # Simulated time would stand still, and by the other one the test sees that a node is well.
        names = sorted(set(world.parameters[node]) - {"use_sim_time", "wait_timeout"})
        name = st.sampled_from(names) | st.sampled_from(STRINGS)
        parameters = st.lists(st.builds(Parameter, name=name, value=values), min_size=1, max_size=3)
        return node, draw(parameters)

    def send(batch):
        changed = set()
        for node, parameters in batch:
            if together:
                kind, name = SetParametersAtomically, f"{node}/set_parameters_atomically"
                (response,) = world.calls([(kind, name, kind.Request(parameters=parameters))])
                results = [response.result]
            else:
                kind, name = SetParameters, f"{node}/set_parameters"
                (response,) = world.calls([(kind, name, kind.Request(parameters=parameters))])
                results = response.results
                assert len(results) == len(parameters)
            assert all(result.successful or len(result.reason) > 10 for result in results)
            changed.add(node)
        for node in changed:  # some values are right ones, such as `stochastic: true`
            world.put_back(node)

    world.flood(request(), 0.03, send)


def test_transitions_out_of_order(world):
    """Those that end the executor for good are right requests, and left out."""
    labels = ("", "configure", "activate", "deactivate", "cleanup", "transition_success", *STRINGS)
    ids = st.sampled_from((0, 1, 2, 3, 4, 8, 9, 10, 20, 50, 60, 61, 62, 97, 98, 99, 200, 255))
    transitions = st.builds(Transition, id=ids, label=st.sampled_from(labels))

    def send(batch):
        name = "policy_executor/change_state"
        for transition in batch:
            world.calls([(ChangeState, name, ChangeState.Request(transition=transition))])
        world.is_alive("policy_executor")

    world.flood(transitions, 0.03, send)


def test_questions_for_types(world):
    valid = GetTypeDescription.Request(type_name="sensor_msgs/msg/JointState", type_hash="RIHS01_0")
    nodes = sorted(world.nodes)

    def send(batch):
        for number, request in enumerate(batch):
            name = f"{nodes[number % len(nodes)]}/get_type_description"
            (response,) = world.calls([(GetTypeDescription, name, request)])
            assert not response.successful

    world.flood(broken(valid), 0.01, send)


BAD_GOALS = st.one_of(
    st.builds(
        TrainPolicy.Goal,
        seed=st.integers(0, 2**64 - 1),
        iterations=st.sampled_from([[0], [100_001], [2**32 - 1]]),
        hidden_units=st.lists(st.integers(1, 10), max_size=3),
    ),
    st.builds(
        TrainPolicy.Goal,
        seed=st.integers(0, 2**64 - 1),
        iterations=st.lists(st.integers(1, 100_000), max_size=1),
        hidden_units=st.sampled_from(
            [[0], [10**9], [10_001], [10_000, 10_000], [1] * 101, [5] * 100_000, [2**32 - 1] * 3]
        ),
    ),
)


def train(world, goal):
    """Sends a goal and returns its status and result; None if it is rejected."""
    name = "policy_learner/train/_action"
    send = TrainPolicy.Impl.SendGoalService
    identity = UUID(uuid=list(uuid.uuid4().bytes))
    request = send.Request(goal_id=identity, goal=goal)
    (answer,) = world.calls([(send, f"{name}/send_goal", request)])
    if not answer.accepted:
        return None
    result = TrainPolicy.Impl.GetResultService
    (answer,) = world.calls(
        [(result, f"{name}/get_result", result.Request(goal_id=identity))], 10.0
    )
    return answer.status, answer.result


def test_goals_for_the_learner(world):
    def send(batch):
        for goal in batch:
            assert train(world, goal) is None
        world.is_alive("policy_learner")

    world.flood(BAD_GOALS, 0.01, send)
    for seed_of_a_run in (1, 2**64 - 1):
        goal = TrainPolicy.Goal(seed=seed_of_a_run, iterations=[1], hidden_units=[2])
        status, result = train(world, goal)
        assert status == GoalStatus.STATUS_SUCCEEDED, result.message
        assert np.isfinite(result.policy.parameters).all()


def test_questions_for_results_and_cancels_of_goals_that_no_one_sent(world):
    actions = {
        "policy_learner/train/_action": TrainPolicy.Impl,
        "simulation/simulate_steps/_action": SimulateSteps.Impl,
    }
    identities = st.builds(UUID, uuid=st.lists(st.integers(0, 255), min_size=16, max_size=16))
    times = st.builds(
        Time,
        sec=st.sampled_from((-(2**31), -1, 0, 1, 2**31 - 1)),
        nanosec=st.integers(0, 2**32 - 1),
    )
    cancels = st.builds(
        CancelGoal.Request, goal_info=st.builds(GoalInfo, goal_id=identities, stamp=times)
    )
    questions = st.tuples(st.sampled_from(sorted(actions)), cancels | identities)

    def send(batch):
        for name, request in batch:
            if isinstance(request, CancelGoal.Request):
                (answer,) = world.calls([(CancelGoal, f"{name}/cancel_goal", request)])
                assert not answer.goals_canceling
            else:
                kind = actions[name].GetResultService
                asked = kind.Request(goal_id=request)
                (answer,) = world.calls([(kind, f"{name}/get_result", asked)])
                assert answer.status == GoalStatus.STATUS_UNKNOWN
        world.is_alive("policy_learner", "simulation")

    world.flood(questions, 0.01, send)


def test_orders_for_recorder_and_player(world):
    times = st.builds(Time, sec=st.integers(-(2**31), 2**31 - 1), nanosec=st.integers(0, 2**32 - 1))
    orders = st.tuples(
        st.sampled_from(((Pause, "recorder/pause"), (Resume, "recorder/resume")))
        | st.sampled_from(((Pause, "player/pause"), (Resume, "player/resume")))
        | st.sampled_from(((PlayNext, "player/play_next"), (TogglePaused, "player/toggle_paused"))),
        st.builds(SetRate.Request, rate=st.floats()),
        st.builds(Burst.Request, num_messages=st.integers(0, 2**64 - 1)),
        st.builds(Seek.Request, time=times),
        st.builds(Play.Request, start_offset=times, playback_until_timestamp=times),
    )

    def send(batch):
        calls = []
        for (kind, name), rate, burst, seek, play in batch:
            calls += [(kind, name, kind.Request()), (SetRate, "player/set_rate", rate)]
            calls += [(Burst, "player/burst", burst), (Seek, "player/seek", seek)]
            calls += [(Play, "player/play", play)]
        for response in world.calls(calls):
            assert not isinstance(response, Play.Response) or not response.success

    world.flood(orders, 0.02, send)


def test_there_were_as_many_as_promised(world):
    assert world.sent >= MESSAGES
    assert len(world.late) <= MAX_LATE, "\n".join(world.late)
