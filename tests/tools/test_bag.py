"""The program `bag`, on the real run that the repository ships."""

import json
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rerun.chunk import RrdReader
from sensor_msgs.msg import JointState

from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks import make_task
from vgps_ros.tasks.demonstration import load_demonstration
from vgps_ros.tools.bag import main

SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"


def copy(target: Path, change, attachments: bool = True) -> Path:
    """Writes the sample again, each message as `change` has it; None leaves it out."""
    writer = BagWriter(target)
    with BagReader(SAMPLE) as bag:
        for topic, kind in bag.topics.items():
            writer.add_topic(topic, kind, bag.type_hashes[topic], bag.qos[topic])
        if attachments:
            for name, text in bag.attachments().items():
                writer.attach(name, text, bag.start)
        for message in bag.messages():
            if (data := change(message)) is not None:
                writer.write(message.topic, message.stamp, data)
    writer.close()
    return target


def fails(arguments: list[str], sentence: str) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert sentence in str(stop.value.code)


def test_info_tells_topics_parameters_and_versions(capsys):
    main(["info", str(SAMPLE), "--json"])
    content = json.loads(capsys.readouterr().out)
    topics = {topic["name"]: topic for topic in content["topics"]}
    assert topics["/joint_states"]["messages"] > 500
    assert topics["/policy"]["type"] == "vgps_msgs/msg/GaussianPolicy"
    nodes = content["attachments"]["parameters.yaml"]
    assert nodes["/simulation"]["ros__parameters"]["task"] == "swimmer"
    assert len(content["attachments"]["environment.yaml"]["commit"].split("-")[0]) == 40
    main(["info", str(SAMPLE)])
    assert "/trajectory_distribution" in capsys.readouterr().out


def test_the_recorded_torques_are_those_of_the_recorded_policy(capsys):
    main(["check", str(SAMPLE)])
    assert "0 with the noise of the seed. 0 states have no torque." in capsys.readouterr().out


def test_one_bit_of_one_torque_is_found_with_its_time_and_joint(tmp_path, capsys):
    commands = []

    def change(message):
        if message.topic != "/joint_command":
            return message.data
        commands.append(deserialize_message(message.data, JointState))
        if len(commands) != 100:
            return message.data
        torque = struct.unpack("<d", message.data[-8:])[0]  # the last joint's
        return message.data[:-8] + struct.pack("<d", np.nextafter(torque, 1e9))

    bag = copy(tmp_path / "bag", change)
    command = commands[99]
    time = command.header.stamp.sec + command.header.stamp.nanosec * 1e-9
    fails(["check", str(bag)], f"At {time:.3f} s the torque of {command.name[1]} is")
    assert "1 torques differ" in capsys.readouterr().out


def test_a_lost_state_is_found(tmp_path, capsys):
    count = iter(range(10_000))

    def change(message):
        if message.topic == "/joint_states" and next(count) == 300:
            return None
        return message.data

    fails(["check", str(copy(tmp_path / "bag", change))], "The bag lacks states")
    assert "1 torques answer states that are not in the bag" in capsys.readouterr().out


def test_a_bag_without_joint_states_is_refused(tmp_path):
    bag = copy(tmp_path / "bag", lambda m: None if m.topic == "/joint_states" else m.data)
    fails(["check", str(bag)], "the topic to check is 'joint_states'")
    fails(["rerun", str(bag)], "no messages on joint_states")
    assert not (tmp_path / "bag.rrd").exists()


def test_a_bag_becomes_a_recording_and_never_overwrites_one(tmp_path):
    output = tmp_path / "sample.rrd"
    main(["rerun", str(SAMPLE), "--output", str(output)])
    rows: dict[str, int] = {}
    for chunk in RrdReader(output).stream():
        if not chunk.is_static:
            entity = str(chunk.entity_path)
            rows[entity] = rows.get(entity, 0) + chunk.num_rows
    with BagReader(SAMPLE) as bag:
        counts = bag.counts
    assert rows["/joint_command/effort"] == counts["/joint_command"]
    assert rows["/learning/alpha"] == counts["/learning_progress"]
    assert rows["/world/robot/middle"] == rows["/joint_states/effort"] == 501
    assert rows["/trajectory_distribution/front_joint/0"] == 501
    before = output.read_bytes()
    fails(["rerun", str(SAMPLE), "--output", str(output)], "exists already")
    assert output.read_bytes() == before


def test_a_bags_motion_becomes_a_demonstration_bit_for_bit(tmp_path):
    table = tmp_path / "swim.csv"
    main(["table", str(SAMPLE), "--output", str(table)])
    swimmer = make_task("swimmer")
    recorded = load_demonstration(swimmer, table)
    replayed = swimmer.dynamics.rollout(
        recorded.states[0], lambda t, _: recorded.controls[t], swimmer.horizon
    )
    np.testing.assert_array_equal(replayed.states, recorded.states)
    before = table.read_bytes()
    fails(["table", str(SAMPLE), "--output", str(table)], "exists already")
    assert table.read_bytes() == before
    with pytest.raises(InvalidInputError, match="lacks the column"):
        load_demonstration(make_task("walker"), table)


def test_a_motion_without_torques_is_no_demonstration(tmp_path):
    def change(message):
        if message.topic != "/joint_states":
            return message.data
        # Efforts are the last field: no element instead of one for each of five joints.
        return message.data[: -5 * 8 - 8] + bytes(4)

    bag = copy(tmp_path / "bag", change)
    fails(["table", str(bag)], "The joint_states have no effort")


def test_an_unfinished_bag_is_explained_and_made_whole(tmp_path, capsys):
    bag = tmp_path / "bag"
    shutil.copytree(SAMPLE, bag)
    (bag / "metadata.yaml").unlink()
    [file] = bag.glob("*.mcap")
    with file.open("r+b") as stream:
        stream.truncate(file.stat().st_size - 100_000)
    for command in ("check", "info", "rerun"):
        fails([command, str(bag)], "was not closed: it lacks metadata.yaml and the index")
    main(["reindex", str(bag)])
    assert "Rebuilt the index" in capsys.readouterr().out
    main(["check", str(bag)])
    main(["reindex", str(bag)])
    assert "is whole" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["info", "check", "rerun", "table", "reindex"])
def test_what_is_no_bag_is_refused_with_a_sentence(command, tmp_path):
    fails([command, str(tmp_path)], "is not a bag")
    fails([command, str(tmp_path / "nothing")], "is not a bag")
    assert list(tmp_path.iterdir()) == []
