# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A robot whose sensors each have stamps of their own: what the executor makes of them."""

import time
import tracemalloc
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState
from vgps_msgs.msg import Signals

from tests.bags.altered import messages_of, write_bag
from tests.nodes.conftest import executed, values_of
from vgps_ros.bags.bag_check import check_bag
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.messages.conversions import command_from_msg, nanoseconds, stamp_of, state_from_msg
from vgps_ros.messages.robot_state import JOINTS, NewestMeasurements, StateMessages, joined_joints
from vgps_ros.robot.bodies import product
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.simulation.frames import state_layout
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

OK, ERROR = DiagnosticStatus.OK, DiagnosticStatus.ERROR
MS = 1_000_000  # [ns]
PERIOD = 20 * MS
REAL = {"state_qos": "sensor_data"}
QOS = qos_profile_sensor_data
# Motors, so that what a policy of chance says needs no limit.
BLIND = Path("tests/tasks/quadruped_with_motors.yaml")


@pytest.fixture(scope="module")
def blind():
    return make_task(str(BLIND))


@pytest.fixture(scope="module")
def seeing(tmp_path_factory):
    """The same robot, whose policy reads its speed, which no IMU measures."""
    text = BLIND.read_text().replace("../..", str(Path.cwd()))
    file = tmp_path_factory.mktemp("seeing") / "task.yaml"
    file.write_text(
        text.partition("observe:")[0] + "observe: [joint_positions, {sensor: velocity}]"
    )
    return make_task(str(file))


def a_policy(task) -> GaussianPolicy:
    shape = Architecture(task.observation.names, (5,), task.dynamics.control_dim)
    parameters = 0.3 * np.random.default_rng(2).standard_normal(shape.num_parameters)
    return GaussianPolicy(shape, parameters, np.ones(12))


class Robot:
    """What stands in for hardware: it publishes what a test says, and keeps what comes."""

    def __init__(self, graph, task, /, *, base=Imu, prefix=(), **parameters):
        self.graph, self.task, self.policy = graph, task, a_policy(task)
        name = "imu" if base is Imu else "odom"
        named = {"task": task.name} | parameters
        self.executor = graph.start("policy_executor", prefix=prefix, **named)
        self.commands = graph.messages(JointState, "joint_command")
        self.contexts = graph.messages(Signals, "context")
        qos = QOS if parameters.get("state_qos") else STREAM
        self.joints = graph.publisher(JointState, "joint_states", qos)
        self.base = graph.publisher(base, name, qos)
        graph.publish_policy(self.policy, task.name)
        text = f"Waiting for {name} and joint_states"
        for_it = partial(graph.diagnosis, "policy_executor", OK, text)
        graph.spin_until(lambda: for_it().message.startswith(text), what="the policy to be taken")
        self.sent: dict[str, dict[int, object]] = {JOINTS: {}, name: {}}

    def send(self, topic, message):
        self.sent[topic][nanoseconds(message.header.stamp)] = message
        (self.joints if topic == JOINTS else self.base).publish(message)

    def keep_pace(self, at):
        """Gives a busy executor some seconds to answer what was measured three periods ago [ns]."""
        due, end = at - 3 * PERIOD, time.monotonic() + 5.0
        if due < min(self.sent[JOINTS], default=at):
            return
        while time.monotonic() < end and not (self.commands and self.stamps()[-1] >= due):
            self.graph.spin_for(0.005)

    def state(self, at):
        """A state near that in which it stands, which the time [ns] draws."""
        rng, space = np.random.default_rng(at), self.task.dynamics.space
        deviation = 0.1 * rng.standard_normal(space.tangent_dim)
        return space.add(self.task.initial_state, deviation)

    def send_of_state(self, topic, at):
        states = StateMessages(state_layout(self.task.dynamics.model))
        self.send(topic, states.split(self.state(at), stamp_of(at))[topic])

    def send_joints(self, at):
        self.send_of_state(JOINTS, at)

    def send_odometry(self, at):
        self.send_of_state("odom", at)

    def send_imu(self, at, frame="imu", turn=(1.0, 0.0, 0.0, 0.0)):
        x = self.state(at)
        message = Imu()
        message.header.stamp, message.header.frame_id = stamp_of(at), frame
        to = message.orientation
        to.w, to.x, to.y, to.z = product(x[3:7], np.array(turn)).tolist()
        rate = message.angular_velocity
        rate.x, rate.y, rate.z = x[-15:-12].tolist()
        self.send("imu", message)

    def stamps(self):
        return [nanoseconds(command.header.stamp) for command in self.commands]

    def is_explained(self, command, tolerance, imu_frame=""):
        """Whether torques are the policy's for joints and a base within a tolerance [ns]."""
        [(topic, of_base)] = [(t, m) for t, m in self.sent.items() if t != JOINTS]
        messages_of = StateMessages(
            state_layout(self.task.dynamics.model), is_blind=topic == "imu", imu_frame=imu_frame
        )
        stamp = nanoseconds(command.header.stamp)
        told = [c.values for c in self.contexts if nanoseconds(c.header.stamp) == stamp]
        observation = self.task.observation.within(np.array(told[-1] if told else []))
        given = command_from_msg(command, self.task.controls)
        low, high = self.task.dynamics.control_limits
        for at, message in of_base.items():
            if abs(at - stamp) <= tolerance:
                x = messages_of.join({topic: message, JOINTS: self.sent[JOINTS][stamp]})
                wanted = np.clip(executed(self.policy, observation(x)), low, high)
                if np.array_equal(given, wanted):
                    return True
        return False


def test_a_blind_policy_is_driven_at_its_own_rate_by_joints_and_an_imu_without_odometry(
    graph, blind, tmp_path
):
    """Joints at 200 Hz, an IMU at 400 Hz with its own stamps; some are late, lost, overtaken."""
    recorder = graph.start("recorder", output=tmp_path / "bag")
    robot, rng = Robot(graph, blind, state_timeout=5.0, **REAL), np.random.default_rng(0)
    for topic in ("imu", "joint_states", "joint_command", "context", "policy"):
        graph.spin_until(lambda t=topic: graph.node.count_subscribers(t) > (t in robot.sent))
    graph.spin_for(1.0)
    late = []  # messages that are sent later than measured, and so are overtaken
    first = 7 * MS
    for tick in range(480):  # of 2.5 ms each
        at = first + round(tick * 2.5 * MS)
        due = [call for call in late if call[0] <= tick]
        late = [call for call in late if call[0] > tick]
        for _, send, stamp in due:
            send(stamp)
        if rng.random() < 0.8:  # else it is lost
            late.append((tick + rng.integers(0, 3), robot.send_imu, at - 700_000))
        if tick % 2 == 0 and rng.random() < 0.9:
            late.append((tick + rng.integers(0, 2), robot.send_joints, at))
        graph.spin_for(0.005)
        robot.keep_pace(at)
    graph.spin_for(0.5)
    commands, stamps = list(robot.commands), robot.stamps()
    steps = np.diff(stamps) / MS
    assert 48 < len(stamps) < 63  # 1.2 s at 50 Hz
    assert np.all(steps >= 10.0)
    assert np.median(steps) == 20.0
    for command in commands:
        assert robot.is_explained(command, 50 * MS), nanoseconds(command.header.stamp) / MS
    assert "odom" not in dict(graph.node.get_topic_names_and_types())

    graph.spin_for(1.2)  # for the diagnostics
    assert recorder.end() == 0, recorder.output
    found = check_bag(tmp_path / "bag")
    assert found.wrong == []
    assert found.counts["mean"] > 40
    assert "the states, which no simulation in lock-step computed" in found.unproved


def test_an_imu_that_falls_silent_is_named_and_the_policy_drives_again_once_it_comes(graph, blind):
    robot = Robot(graph, blind, state_timeout=0.3, safe_action="zero", **REAL)
    at = 1000 * MS

    def run_until_torques_are(wanted, *, with_imu):
        def is_so():
            nonlocal at
            at += 10 * MS
            if with_imu:
                robot.send_imu(at)
            robot.send_joints(at)
            graph.spin_for(0.01)
            return robot.commands and any(robot.commands[-1].effort) == wanted

        graph.spin_until(is_so, what=f"torques to be {wanted}")

    run_until_torques_are(True, with_imu=True)
    run_until_torques_are(False, with_imu=False)
    said = graph.diagnosis("policy_executor", ERROR, "no usable imu within 0.05 s").message
    assert "Safe action active (zero)" in said
    assert "before it)" in said
    run_until_torques_are(True, with_imu=True)
    assert "No state is complete" not in robot.executor.output  # it says one thing once


def test_the_topic_that_never_came_is_named(graph, seeing):
    robot = Robot(graph, seeing, base=Odometry, **REAL)

    def is_said():
        robot.send_joints(graph.node.get_clock().now().nanoseconds)
        graph.spin_for(0.1)
        return "No state is complete: odom did not come." in robot.executor.output

    graph.spin_until(is_said, what="the name of what is missing")


def test_an_odometry_at_half_the_rate_does_not_halve_the_commands(graph, seeing):
    robot = Robot(graph, seeing, base=Odometry, **REAL)
    for step in range(40):
        at = 1000 * MS + step * PERIOD
        if step % 2 == 0:
            robot.send_odometry(at - 1000)  # and it is measured a microsecond earlier
        robot.send_joints(at)
        graph.spin_for(0.03)
        robot.keep_pace(at)
    graph.spin_for(0.3)
    assert len(robot.commands) > 32
    assert np.median(np.diff(robot.stamps())) == PERIOD
    assert all(robot.is_explained(command, 50 * MS) for command in robot.commands)


def test_stamps_a_microsecond_apart_are_one_state_also_of_a_simulation(graph, seeing):
    robot = Robot(graph, seeing, base=Odometry)
    for step in range(10):
        robot.send_joints(1000 * MS + step * PERIOD)
        robot.send_odometry(1000 * MS + step * PERIOD - 1000)
        graph.spin_until(lambda n=step: len(robot.commands) > n, what="an answer")
    assert all(robot.is_explained(command, 1000) for command in robot.commands)


def test_what_needs_odometry_refuses_to_do_without(graph, seeing):
    executor = graph.start("policy_executor", task=seeing.name, base_from="imu")
    assert executor.wait() == 1
    assert "base_from is imu, but velocity/x, velocity/y, velocity/z need" in executor.output


def test_frames_have_the_names_that_parameters_give_them(graph, blind):
    """The base is base_link, and the IMU's messages name a frame that the model lacks."""
    names = {"base_frame": "base_link", "imu_frame": "imu"}
    robot = Robot(graph, blind, **names, **REAL)
    robot.send_imu(1000 * MS, frame="vendor_imu")
    robot.send_joints(1000 * MS)
    graph.spin_until(lambda: robot.commands and robot.contexts, what="an answer")
    assert robot.is_explained(robot.commands[0], MS, "imu")


def test_a_frame_that_is_unknown_is_refused_with_the_names_of_those_that_are_not(graph, blind):
    robot = Robot(graph, blind, **REAL)
    robot.send_imu(1000 * MS, frame="vendor_imu")
    robot.send_joints(1000 * MS)
    graph.diagnosis("policy_executor", ERROR, "The frame of imu is 'vendor_imu', but it must be")


@pytest.mark.parametrize("has_velocities", [True, False])
def test_two_drivers_with_half_of_the_joints_each_are_one_robot(graph, blind, has_velocities):
    """A third one is a gripper's, of which the task knows nothing; it has no velocity."""
    robot = Robot(graph, blind, state_timeout=60.0, **REAL)
    drivers = [robot.joints, *(graph.publisher(JointState, JOINTS, QOS) for _ in range(2))]
    states = StateMessages(state_layout(blind.dynamics.model))
    for step in range(30):
        at = 1000 * MS + step * PERIOD
        whole = states.split(robot.state(at), stamp_of(at))[JOINTS]
        robot.sent[JOINTS][at] = whole
        robot.send_imu(at)
        for k, driver in enumerate(drivers):
            part = JointState(name=["finger"], position=[0.1])
            part.header.stamp = stamp_of(at + k * MS)
            if k < 2:
                part.name = whole.name[k::2]
                part.position = whole.position[k::2]
                part.velocity = whole.velocity[k::2] if has_velocities else []
            driver.publish(part)
        graph.spin_for(0.02)
        robot.keep_pace(at)
    graph.spin_until(lambda: len(robot.commands) >= 15, what="commands")
    is_said = "differences of positions, filtered over 0.02 s" in robot.executor.output
    assert is_said != has_velocities
    if has_velocities:  # of parts of which one was lost the others make states of other stamps
        whole = [
            c
            for c, at in zip(robot.commands, robot.stamps(), strict=True)
            if at in robot.sent[JOINTS]
        ]
        assert len(whole) >= 10
        assert all(robot.is_explained(command, 50 * MS) for command in whole)
    else:
        values = values_of(graph.diagnosis("policy_executor", OK, "Running"))
        assert values["joint velocities"].startswith("differences of positions")


def test_the_joints_that_no_driver_sends_are_named(graph, blind):
    robot = Robot(graph, blind, **REAL)
    names = blind.joint_names

    def is_said():
        part = JointState(name=names[1:], position=[0.0] * 11, velocity=[0.0] * 11)
        part.header.stamp = graph.node.get_clock().now().to_msg()
        robot.joints.publish(part)
        graph.spin_for(0.1)
        sentence = f"No state is complete: joint_states with {names[0]} did not come."
        return sentence in robot.executor.output

    graph.spin_until(is_said, what="the name of the joint")


def test_a_turned_imu_tells_the_same_as_one_along_the_axes_of_the_base(blind, rng):
    model = blind.dynamics.model.__copy__()
    site = model.site("imu").id
    turn = rng.standard_normal(4)
    model.site_quat[site] = turn / np.linalg.norm(turn)
    states = StateMessages(state_layout(model), is_blind=True)
    space = blind.dynamics.space
    x = space.add(blind.initial_state, 0.5 * rng.standard_normal(space.tangent_dim))
    messages = StateMessages(state_layout(model)).split(x, Time())
    imu = Imu()
    imu.header.frame_id = "imu"
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = x[: model.nq], x[model.nq : model.nq + model.nv]
    mujoco.mj_forward(model, data)
    quat, rates = np.empty(4), np.empty(6)
    mujoco.mju_mat2Quat(quat, data.site_xmat[site])
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, rates, 1)
    to, rate = imu.orientation, imu.angular_velocity
    to.w, to.x, to.y, to.z = quat.tolist()
    rate.x, rate.y, rate.z = rates[:3].tolist()
    joined = states.join({"imu": imu, JOINTS: messages[JOINTS]})
    base = states.base
    for found, wanted in zip(base.parts(joined)[1::2], base.parts(x)[1::2], strict=True):
        sign = np.sign(found @ wanted) if len(found) == 4 else 1.0
        np.testing.assert_allclose(sign * found, wanted, atol=1e-9)


# What the simulation publishes


@pytest.mark.parametrize(
    "noise", [pytest.param((0.0, 0.0, 0.0), marks=pytest.mark.slow), (0.02, 0.1, 0.2)]
)
def test_the_simulations_imu_drives_a_blind_policy_and_the_bag_proves_the_torques(
    graph, blind, tmp_path, noise
):
    save_policy(a_policy(blind), blind.name, tmp_path / "policy.json")
    recorder = graph.record()
    given = {"policy_file": tmp_path / "policy.json", "state_timeout": 60.0}
    graph.start("policy_executor", task=blind.name, **given)
    graph.start("simulation", task=blind.name, start_paused=True, imu_noise=list(noise), seed=3)
    imus, odometry = graph.messages(Imu, "imu"), graph.messages(Odometry, "odom")
    graph.spin_until(lambda: imus and odometry)
    for topic in ("imu", "odom", "joint_states", "joint_command", "context", "policy"):
        graph.spin_until(lambda t=topic: graph.node.count_subscribers(t), what=topic)
    graph.spin_for(1.0)
    program = graph.start_program("execute_policy", "--task", blind.name, "--steps", "40")
    graph.ends(program)
    graph.spin_for(1.2)
    assert recorder.end() == 0, recorder.output
    found = check_bag(tmp_path / "bag")
    assert found.wrong == []
    assert found.counts["mean"] >= 40
    assert set(found.counts) == {"mean"}
    assert any("40 of 40 steps" in words or "steps from state" in words for words in found.proved)

    by_stamp = {nanoseconds(m.header.stamp): m for m in odometry}
    errors = []
    for imu in imus[-40:]:
        odom = by_stamp[nanoseconds(imu.header.stamp)]
        is_exact = imu.orientation == odom.pose.pose.orientation
        assert is_exact == (not any(noise))
        errors.append(imu.angular_velocity.x - odom.twist.twist.angular.x)
        np.testing.assert_allclose(
            np.diag(np.reshape(imu.orientation_covariance, (3, 3))), noise[0] ** 2
        )
        np.testing.assert_allclose(imu.angular_velocity_covariance[0], noise[1] ** 2)
    assert np.std(errors) == pytest.approx(noise[1], rel=0.5)


def test_a_stall_in_the_first_of_two_runs_leaves_a_bag_without_a_fault(graph, blind, tmp_path):
    """After a reset the stamps come again: the joints of one run belong to its own IMU."""
    save_policy(a_policy(blind), blind.name, tmp_path / "policy.json")
    given = {"policy_file": tmp_path / "policy.json", "state_timeout": 60.0}
    given |= {"stochastic": True}
    recorder = graph.record()
    graph.start("simulation", task=blind.name, start_paused=True, imu_noise=[0.02, 0.1, 0.2])
    graph.start("policy_executor", task=blind.name, **given)
    for topic in ("imu", "odom", "joint_states", "joint_command", "context", "policy"):
        graph.spin_until(lambda t=topic: graph.node.count_subscribers(t), what=topic)
    graph.spin_for(1.0)
    for seed in (1, 2):  # by whose noise the runs differ
        assert graph.set_parameter("policy_executor", "seed", seed).successful
        program = graph.start_program("execute_policy", "--task", blind.name, "--steps", "8")
        graph.ends(program)
        graph.spin_for(1.2)  # for the diagnostics
    assert recorder.end() == 0, recorder.output
    messages = messages_of(tmp_path / "bag")
    commands = [m for m in messages if m.topic == "/joint_command"]
    stamps = [nanoseconds(deserialize_message(m.data, JointState).header.stamp) for m in commands]
    stalled = commands[stamps.index(5 * PERIOD)].stamp  # of the first run
    late = [
        replace(m, stamp=m.stamp + 1500 * MS)
        if m.stamp >= stalled or (m.topic == "/context" and m.stamp > stalled - 5 * MS)
        else m
        for m in messages
    ]
    bag = write_bag(tmp_path / "stalled", sorted(late, key=lambda m: m.stamp), tmp_path / "bag")
    for found in map(check_bag, (tmp_path / "bag", bag)):
        assert found.wrong == []
        assert found.counts["noisy"] >= 16


# One robot's measurements, without a graph


def needing(*topics, joints=()):
    """A robot whose states need messages on these topics, and these joints."""

    def missing_topics(messages):
        return [topic for topic in topics if topic not in messages]

    def lacking_joints(names):
        return [name for name in joints if name not in names]

    return SimpleNamespace(
        missing_topics=missing_topics, lacking_joints=lacking_joints, joint_names=joints
    )


def stamped(at, **positions):
    """Joint states of a stamp [ns], of which each joint turns at its position a second."""
    message = JointState(name=list(positions), position=list(positions.values()))
    message.velocity = list(positions.values())
    message.header.stamp = stamp_of(at)
    return message


def test_a_state_that_comes_again_with_other_values_is_never_mixed_with_what_it_was():
    newest = NewestMeasurements(needing("imu", JOINTS), 0.01, 0.02, is_simulated=True)
    assert newest.add("imu", stamped(5)) is None
    assert newest.add(JOINTS, stamped(5))
    assert newest.add(JOINTS, stamped(5)) is None  # until the IMU was heard again, too
    assert newest.add("imu", stamped(5))


@pytest.mark.parametrize("is_simulated", [True, False])
def test_states_that_come_four_times_in_a_control_period_are_answered_once(is_simulated):
    newest = NewestMeasurements(needing(JOINTS), 0.01, 0.02, is_simulated=is_simulated)
    sent = [stamped(at * MS, hip=at) for at in range(1000, 1200, 5)]
    assert [stamp // MS for stamp, _ in collected(newest, sent)] == list(range(1000, 1200, 20))


def test_names_that_are_new_in_each_message_take_no_memory():
    """Each message is of the hip and another joint, without velocities."""
    newest = NewestMeasurements(needing(JOINTS, joints=("hip",)), 0.05, 0.02, 0.02)
    messages = [stamped(at * MS, **{"hip": at, f"strange{at}": at}) for at in range(1, 10_000)]
    for message in messages:
        message.velocity = []
    tracemalloc.start()
    collected(newest, messages[:100])
    before = tracemalloc.get_traced_memory()[0]
    collected(newest, messages)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 100_000


def test_a_clock_that_was_set_back_is_followed():
    newest = NewestMeasurements(needing(JOINTS), 0.05, 0.02)
    assert newest.add(JOINTS, stamped(10**9))
    assert newest.add(JOINTS, stamped(10**9 + 5 * MS)) is None
    assert newest.add(JOINTS, stamped(10**9 - 5 * MS)) is None  # overtaken
    assert newest.add(JOINTS, stamped(10**9 + 20 * MS))
    assert newest.add(JOINTS, stamped(MS))


def collected(newest, messages):
    """The stamp [ns] and the positions by joint of each state that messages make."""
    found = [each[JOINTS] for each in map(partial(newest.add, JOINTS), messages) if each]
    return [
        (nanoseconds(m.header.stamp), dict(zip(m.name, m.position, strict=True))) for m in found
    ]


@pytest.mark.parametrize(("tolerance", "is_simulated"), [(0.01, True), (0.05, False)])
def test_joints_that_come_in_parts_are_one_state_with_the_stamp_of_the_oldest(
    tolerance, is_simulated
):
    robot = needing(JOINTS, joints=("hip", "knee"))
    newest = NewestMeasurements(robot, tolerance, 0.02, is_simulated=is_simulated)
    legs = [(at, stamped(at * MS, hip=at)) for at in range(20, 200, 20)]
    feet = [(at, stamped(at * MS, knee=at)) for at in range(25, 205, 20)]
    hands = [(at, stamped(at * MS, finger=at)) for at in range(22, 202, 5)]
    sent = [message for _, message in sorted([*legs, *feet, *hands], key=lambda each: each[0])]
    expected = [(at * MS, {"hip": at, "knee": at + 5}) for at in range(20, 200, 20)]
    assert collected(newest, sent) == expected


def test_parts_that_are_too_far_apart_are_no_state_and_what_lacks_is_named():
    newest = NewestMeasurements(needing(JOINTS, joints=("hip", "knee")), 0.05, 0.02)
    assert newest.missing() == JOINTS
    assert collected(newest, [stamped(1000 * MS, knee=1.0)]) == []
    late = [stamped(at * MS, hip=at) for at in range(1060, 1200, 20)]
    assert collected(newest, [*late, stamped(0, finger=1.0)]) == []
    assert newest.missing() == "joint_states with knee (one came with ['finger'])"
    again = [(1180 * MS, {"hip": 1180.0, "knee": 2.0})]  # whose oldest part is the hip's
    assert collected(newest, [stamped(1200 * MS, knee=2.0)]) == again
    assert not newest.missing()


def test_a_part_without_velocities_is_refused_by_what_it_lacks():
    half = stamped(5, knee=1.0)
    half.velocity = []
    joined = joined_joints([stamped(7, hip=1.0), half])
    assert (joined.name, nanoseconds(joined.header.stamp)) == (["hip", "knee"], 5)
    with pytest.raises(InvalidInputError, match=r"velocity has 0 values"):
        state_from_msg(joined, ["hip", "knee"])


@pytest.mark.parametrize("absent", [[], [float("nan")]])
def test_velocities_that_no_driver_sends_are_filtered_differences_and_it_is_said_once(absent):
    """A joint that turns to and fro at 1 Hz, read by an encoder of 1e-4 rad at 200 Hz."""
    said, errors = [], []
    robot = needing(JOINTS, joints=("hip",))
    newest = NewestMeasurements(robot, 0.05, 0.005, 0.02, lambda: said.append(1))
    for step in range(400):
        at = 0.005 * step
        position = round(np.sin(2 * np.pi * at), 4)
        message = stamped(round(at * 1e9), hip=position)
        message.velocity = absent
        messages = newest.add(JOINTS, message)
        assert (messages is None) == (step == 0)  # one position is no velocity yet
        if step > 20:
            true = 2 * np.pi * np.cos(2 * np.pi * at)
            errors.append(messages[JOINTS].velocity[0] - true)
    assert said == [1]
    assert np.abs(errors).max() < 1.0  # of 6.3 rad/s: it lags by 0.02 s
    back = stamped(0, hip=3.0)
    back.velocity = absent
    assert newest.add(JOINTS, back) is None  # after a reset


def test_a_position_that_is_nan_does_not_stay_in_the_filter_of_velocities():
    newest = NewestMeasurements(needing(JOINTS, joints=("hip",)), 0.05, 0.005, 0.02)
    for step, position in enumerate([0.0, 0.1, float("nan"), 0.3, 0.4]):
        message = stamped(step * 10_000_000, hip=position)
        message.velocity = []
        messages = newest.add(JOINTS, message)
        if np.isnan(position):  # it is refused by its name
            with pytest.raises(InvalidInputError, match=r"position of 'hip' is nan"):
                state_from_msg(messages[JOINTS], ["hip"])
    assert messages[JOINTS].velocity[0] == pytest.approx(10.0)


def test_velocities_of_zero_and_single_gaps_are_no_missing_velocities():
    robot = needing(JOINTS, joints=("hip", "knee"))
    newest = NewestMeasurements(robot, 0.05, 1e-9, 0.02, lambda: pytest.fail("differences"))
    still, gap = stamped(5, hip=0.0, knee=0.0), stamped(9, hip=1.0, knee=float("nan"))
    assert newest.add(JOINTS, still) == {JOINTS: still}
    assert newest.add(JOINTS, gap) == {JOINTS: gap}  # which is refused by its name
