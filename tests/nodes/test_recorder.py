# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The recorder: what it writes is what was published, and other tools read it."""

import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Attachment
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rclpy.action import ActionClient
from rclpy.serialization import deserialize_message
from rosbag2_interfaces.srv import IsPaused, Pause, Resume
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.srv import StepSimulation
from vgps_msgs.msg import GaussianPolicy

from tests.nodes.conftest import EACH_SIGNAL
from vgps_ros.bags import BagReader
from vgps_ros.messages.conversions import nanoseconds, pack
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.ros_runtime.qos import LATCHED, NEWEST_OF_SENSORS, STATES, STREAM
from vgps_ros.storage.run_folder import save_policy


def joint_state(i: int) -> JointState:
    message = JointState(name=["a", "b"], position=pack(np.array([i, -i / 3])))
    message.header.stamp.sec = i
    return message


def policy() -> GaussianPolicy:
    return GaussianPolicy(
        task="swimmer",
        observed=["a/position", "b/position"],
        layer_sizes=[2, 1],
        activation="tanh",
        parameters=pack(np.array([np.pi, np.e, 1e-300])),
        noise_std=pack(np.array([0.1])),
    )


def rows(path: Path) -> dict[str, list[bytes]]:
    with AnyReader([path]) as reader:
        found: dict[str, list[bytes]] = {}
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(bytes(data))
        return found


def test_bags_hold_what_was_published_and_independent_readers_agree(graph, tmp_path):
    recorder = graph.record()
    # Both topics appear after the recorder; the policy was latched before it was found.
    latched = graph.node.create_publisher(GaussianPolicy, "policy", LATCHED)
    latched.publish(policy())
    stream = graph.publisher(JointState, "joint_states", STREAM)
    sent = [joint_state(i) for i in range(50)]
    for message in sent:
        stream.publish(message)
        graph.spin_for(0.005)
    graph.spin_until(latched.get_subscription_count, what="the recorder to find the policy")
    graph.spin_for(0.5)
    hashes = {
        topic: str(graph.node.get_publishers_info_by_topic(topic)[0].topic_type_hash)
        for topic in ("/policy", "/joint_states")
    }
    assert recorder.end(signal.SIGINT) == 0, recorder.output

    recorded = rows(tmp_path / "bag")
    # Messages, not bytes: CDR's padding is whatever stood in memory.
    assert [deserialize_message(data, JointState) for data in recorded["/joint_states"]] == sent
    assert [deserialize_message(d, GaussianPolicy) for d in recorded["/policy"]] == [policy()]
    assert {"/rosout", "/diagnostics"} <= set(recorded)
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection in reader.connections:
            assert hashes.get(connection.topic, connection.digest) == connection.digest

    [file] = (tmp_path / "bag").glob("*.mcap")
    with file.open("rb") as stream_in:
        decoded = {
            channel.topic: message
            for _, channel, _, message in make_reader(
                stream_in, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages(topics=["/policy", "/joint_states"])
        }
    assert list(decoded["/policy"].parameters) == [np.pi, np.e, 1e-300]
    assert decoded["/joint_states"].header.stamp.sec == 49


def test_of_a_run_in_lock_step_nothing_is_lost_on_a_busy_machine(graph, random_policy, tmp_path):
    """Although no sender of states or commands keeps more than ten."""
    steps = 100
    save_policy(random_policy(0), "swimmer", tmp_path / "policy.json")
    graph.start("simulation", start_paused=True)
    graph.start("policy_executor", policy_file=tmp_path / "policy.json")
    recorder = graph.record()
    graph.spin_until(lambda: graph.node.count_publishers("/joint_command"), what="the executor")
    graph.spin_for(1.0)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(6)]
    try:
        request = StepSimulation.Request(steps=steps)
        done = graph.call_async(StepSimulation, "simulation/step_simulation", request)
        graph.spin_until(done.done, 200.0, what="all steps")
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert recorder.end(signal.SIGINT) == 0
    assert STATES.depth == 10
    with BagReader(tmp_path / "bag") as bag:
        for topic in ("/joint_states", "/joint_command", "/clock"):
            of = [message for _, message in bag.decoded(topic)]
            stamps = {nanoseconds(m.clock if topic == "/clock" else m.header.stamp) for m in of}
            assert len(stamps) >= steps


def test_what_came_faster_than_it_could_take_it_is_counted(graph, tmp_path):
    latched = graph.node.create_publisher(GaussianPolicy, "policy", LATCHED)
    for _ in range(3 * LATCHED.depth):  # it keeps the last ones: the others are not lost
        latched.publish(policy())
    recorder = graph.record(exclude=["/rosout"])
    stream = graph.publisher(JointState, "joint_states", STREAM)
    graph.diagnosis("recorder", DiagnosticStatus.OK, "Running")
    recorder.send(signal.SIGSTOP)
    sent = 3 * STREAM.depth
    for i in range(sent):
        stream.publish(joint_state(i))
    recorder.send(signal.SIGCONT)
    graph.diagnosis("recorder", DiagnosticStatus.ERROR, "/joint_states came faster")
    before, now = -sent, 0
    while now > before + STREAM.depth // 100:  # until what still waited is taken, however slowly
        status = graph.diagnosis("recorder", DiagnosticStatus.OK)
        before, now = now, next(int(v.value) for v in status.values if v.key == "messages")
    assert recorder.end(signal.SIGINT) == 0
    recorded = rows(tmp_path / "bag")
    lost = sent - len(recorded["/joint_states"])
    assert lost > 0
    assert f"{lost} messages are lost." in recorder.output
    assert len(recorded["/policy"]) == LATCHED.depth


def test_a_later_publisher_that_offers_less_is_told_of(graph):
    graph.record()
    graph.publisher(JointState, "joint_states", STREAM)
    graph.node.create_publisher(JointState, "joint_states", NEWEST_OF_SENSORS)  # best effort
    graph.diagnosis("recorder", DiagnosticStatus.WARN, "Does not record all of /joint_states")


def test_topics_are_chosen_by_pattern(graph, tmp_path):
    recorder = graph.record(include="[joint]", exclude="[_b$]")
    wanted = graph.publisher(JointState, "joint_a", STREAM)
    for topic in ("joint_b", "other"):
        graph.node.create_publisher(JointState, topic, STREAM).publish(joint_state(0))
    wanted.publish(joint_state(1))
    graph.spin_for(1.0)
    assert recorder.end(signal.SIGINT) == 0
    assert set(rows(tmp_path / "bag")) == {"/joint_a"}


@EACH_SIGNAL
def test_two_signals_at_once_end_it_with_a_whole_bag(graph, tmp_path, number):
    recorder = graph.record()
    graph.spin_for(1.5)
    recorder.send(number)
    recorder.send(number)
    assert recorder.wait() == 0, recorder.output
    assert (tmp_path / "bag" / "metadata.yaml").is_file()
    assert rows(tmp_path / "bag")["/diagnostics"]


def recorded_so_far(bag: Path) -> list[int]:
    """The stamps of the states in a file without an index: read from its start as far as it goes.

    One that is written at this moment may not be readable, and then gives none.
    """
    [file] = bag.glob("*.mcap")
    stamps = []
    with file.open("rb") as stream, suppress(EndOfFile):
        reader = NonSeekingReader(stream, record_size_limit=None)
        for _, channel, message in reader.iter_messages(log_time_order=False):
            if channel.topic == "/joint_states":
                stamps.append(deserialize_message(message.data, JointState).header.stamp.sec)
    return stamps


def test_what_came_is_in_the_file_before_the_recorder_ends(graph, tmp_path):
    recorder = graph.record()
    stream = graph.publisher(JointState, "joint_states", STREAM)
    for i in range(50):
        stream.publish(joint_state(i))
        graph.spin_for(0.005)
    graph.spin_until(lambda: recorded_so_far(tmp_path / "bag") == list(range(50)), what="all")
    assert recorder.end(signal.SIGINT) == 0, recorder.output


def test_a_topic_of_unknown_type_is_named_and_recorded_once_the_type_is_known(
    monkeypatch, request, tmp_path
):
    # The packages' definitions are found through the ament index: one without vgps_msgs.
    prefixes = os.environ["AMENT_PREFIX_PATH"].split(":")
    known = next(p for p in prefixes if Path(p, "share", "vgps_msgs").is_dir())
    kept = [p for p in prefixes if p != known]
    monkeypatch.setenv("AMENT_PREFIX_PATH", ":".join([*kept, str(tmp_path)]))
    graph = request.getfixturevalue("graph")
    recorder = graph.record()
    latched = graph.node.create_publisher(GaussianPolicy, "policy", LATCHED)
    latched.publish(policy())
    graph.publisher(JointState, "joint_states", STREAM).publish(joint_state(7))
    said = graph.diagnosis("recorder", DiagnosticStatus.WARN, "Does not record /policy")
    assert "vgps_msgs/msg/GaussianPolicy is not installed; build or source" in said.message
    assert recorder.output.count("Does not record /policy") == 1
    index = "share/ament_index/resource_index"
    for path in ("share", f"{index}/packages", f"{index}/rosidl_interfaces"):
        (tmp_path / path).mkdir(parents=True, exist_ok=True)
        (tmp_path / path / "vgps_msgs").symlink_to(Path(known, path, "vgps_msgs"))
    graph.diagnosis("recorder", DiagnosticStatus.OK)
    graph.spin_for(0.5)
    assert recorder.end(signal.SIGINT) == 0, recorder.output
    recorded = rows(tmp_path / "bag")
    assert len(recorded["/joint_states"]) == len(recorded["/policy"]) == 1


@pytest.mark.parametrize(
    ("output", "sentence"),
    [
        pytest.param(
            *("file/bag", "cannot be made or written to: .*Not a directory"), marks=pytest.mark.slow
        ),
        ("/proc/bag", "cannot be made or written to: .*No such file.*name another one"),
    ],
)
def test_a_folder_that_cannot_be_written_is_refused_with_a_sentence(
    graph, tmp_path, output, sentence
):
    (tmp_path / "file").touch()
    recorder = graph.start("recorder", output=tmp_path / output)
    assert recorder.wait() == 1
    assert re.search(sentence, recorder.output)
    assert "Traceback" not in recorder.output
    assert not (tmp_path / "bag").exists()


def test_files_split_and_are_compressed_as_parameters_say(graph, tmp_path):
    recorder = graph.start(
        "recorder", output=tmp_path / "bag", max_file_duration=0.5, compression="zstd"
    )
    graph.spin_until_output(recorder, "Recording to")
    stream = graph.publisher(JointState, "joint_states", STREAM)
    for i in range(200):
        stream.publish(joint_state(i))
        graph.spin_for(0.01)
    graph.spin_for(1.0)  # in which the last message reaches a busy recorder
    assert recorder.end(signal.SIGINT) == 0, recorder.output
    files = list((tmp_path / "bag").glob("bag_*.mcap"))
    assert len(files) >= 3
    for file in files:
        with file.open("rb") as stream_in:
            chunks = make_reader(stream_in).get_summary().chunk_indexes
        assert {chunk.compression for chunk in chunks} <= {"zstd"}
    recorded = rows(tmp_path / "bag")["/joint_states"]
    stamps = [deserialize_message(data, JointState).header.stamp.sec for data in recorded]
    assert stamps == list(range(200))


def test_recording_pauses_and_goes_on_by_service(graph, tmp_path):
    recorder = graph.record(include="[joint_states]")
    stream = graph.publisher(JointState, "joint_states", STREAM)
    paused = []
    for i, kind in enumerate([Resume, Pause, Pause, Resume]):
        stream.publish(joint_state(i))
        graph.spin_for(0.3)
        graph.call(kind, f"recorder/{kind.__name__.lower()}")
        paused.append(graph.call(IsPaused, "recorder/is_paused").paused)
    stream.publish(joint_state(9))
    graph.spin_for(0.3)
    assert recorder.end(signal.SIGINT) == 0, recorder.output
    assert paused == [False, True, True, False]
    assert recorder.output.count("Recording pauses.") == 1
    recorded = rows(tmp_path / "bag")["/joint_states"]
    stamps = [deserialize_message(data, JointState).header.stamp.sec for data in recorded]
    assert stamps == [0, 1, 9]


def test_the_bag_says_with_which_parameters_and_versions_its_nodes_ran(graph, tmp_path):
    graph.start("policy_executor", seed=17, autostart=False)
    recorder = graph.record()
    assert graph.set_parameter("policy_executor", "stochastic", True).successful

    def parameters() -> dict:
        graph.spin_for(0.2)
        with suppress(EndOfFile), (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
            found = {}
            for record in StreamReader(stream).records:
                if isinstance(record, Attachment):
                    found[record.name] = yaml.safe_load(record.data)
        return (
            found.get("parameters.yaml", {}).get("/policy_executor", {}).get("ros__parameters", {})
        )

    graph.spin_until(lambda: parameters().get("stochastic"), what="the parameter in the bag")
    assert graph.set_parameter("policy_executor", "seed", 18).successful
    graph.spin_until(lambda: parameters()["seed"] == 18, what="the change in the bag")
    assert recorder.end(signal.SIGINT) == 0, recorder.output
    with BagReader(tmp_path / "bag") as bag:
        texts = bag.attachments()
    nodes = yaml.safe_load(texts["parameters.yaml"])
    assert nodes["/policy_executor"]["ros__parameters"]["seed"] == 18
    assert nodes["/recorder"]["ros__parameters"]["include"] == [".*"]
    environment = yaml.safe_load(texts["environment.yaml"])
    assert environment["packages"]["mujoco"] == mujoco.__version__
    assert re.match("[0-9a-f]{40}(-dirty)?$|unknown: not run from", environment["commit"])


def test_killed_it_leaves_all_but_the_last_second_in_a_bag_that_can_be_made_whole(graph, tmp_path):
    bag = tmp_path / "bag"
    recorder = graph.record()
    stream = graph.publisher(JointState, "joint_states", STREAM)
    for i in range(300):
        stream.publish(joint_state(i))
        graph.spin_for(0.005)
        if i == 149:
            graph.spin_until(lambda: len(recorded_so_far(bag)) == 150, what="150 states")
    recorder.kill()
    with pytest.raises(SystemExit) as stop:
        vgps(["bag", "check", str(bag)])
    assert "was not closed, or is damaged (it has no metadata.yaml)" in stop.value.code
    vgps(["bag", "reindex", str(bag)])
    recorded = rows(bag)["/joint_states"]
    stamps = [deserialize_message(data, JointState).header.stamp.sec for data in recorded]
    assert stamps == list(range(len(stamps)))
    assert len(stamps) >= 150


def test_events_of_services_and_feedback_of_actions_are_recorded_where_asked(
    graph, random_policy, tmp_path
):
    bag = tmp_path / "bag"
    graph.start("simulation", start_paused=True, service_introspection="contents")
    recorder = graph.record(services=True, actions=True)
    event = "/simulation/step_simulation/_service_event"
    feedback = "/simulation/simulate_steps/_action/feedback"
    for topic in (event, feedback):
        graph.spin_until(lambda topic=topic: graph.node.get_subscriptions_info_by_topic(topic))
    answer = graph.step(0)
    save_policy(random_policy(0), "swimmer", tmp_path / "policy.json")
    graph.start("policy_executor", policy_file=tmp_path / "policy.json")
    client = ActionClient(graph.node, SimulateSteps, "simulation/simulate_steps")
    graph.spin_until(client.server_is_ready)
    goal = client.send_goal_async(SimulateSteps.Goal(steps=3))
    graph.spin_until(goal.done)
    result = goal.result().get_result_async()
    graph.spin_until(result.done)
    graph.spin_for(1.0)
    assert recorder.end(signal.SIGINT) == 0, recorder.output
    with BagReader(bag) as reader:
        kinds = {event: StepSimulation.Event, feedback: SimulateSteps.Impl.FeedbackMessage}
        found = {topic: [] for topic in kinds}
        for m in reader.messages([*kinds]):
            found[m.topic].append(deserialize_message(m.data, kinds[m.topic]))
        assert reader.topics[event] == "simulation_interfaces/srv/StepSimulation_Event"
    assert [m.completed_steps for m in (f.feedback for f in found[feedback])] == [1, 2, 3]
    asked, answered = found[event]
    assert asked.request[0].steps == 0
    assert not asked.response
    assert answered.response[0].result.error_message == answer.error_message
    vgps(["bag", "info", str(bag)])
    vgps(["bag", "check", str(bag)])
    events = graph.messages(StepSimulation.Event, event)
    player = graph.start("player", bag=bag, include=["_service_event", "feedback"], rate=20.0)
    assert player.wait() == 0, player.output
    assert "Does not play" not in player.output
    graph.spin_until(lambda: len(events) == 2)
