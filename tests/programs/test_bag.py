# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The program `bag`, on the real run that the repository ships."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rerun.chunk import RrdReader

from tests.bags.altered import SAMPLE, copy, fails, main, time_of_state, without
from vgps_ros.bags import BagReader
from vgps_ros.bags.repair import repair
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.tasks import make_task
from vgps_ros.tasks.motion_table import load_demonstration


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
    table = capsys.readouterr().out
    for topic in content["topics"]:  # a pipe has no width at which a name might be cut
        assert any(topic["name"] in row and topic["type"] in row for row in table.splitlines())


def foreign_bag(folder: Path, attachments: dict[str, bytes], topic: str = "/a") -> Path:
    """A bag of one message, as another recorder may write it."""
    folder.mkdir(parents=True)
    with (folder / "bag_0.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        for name, data in attachments.items():
            writer.add_attachment(1, 1, name, "", data)
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        writer.add_message(writer.register_channel(topic, "cdr", schema), 5, bytes(12), 3)
        writer.finish()
    repair(folder)
    return folder


def test_info_shows_attachments_of_any_kind(tmp_path, capsys):
    texts = {
        "plain": b"{1: 2024-01-01, b: !!binary aGVsbG8=, c: !!set {d}, e: .nan, f: [1.5, true]}",
        "picture": b"\xff\xd8\x00: [\x01",
    }
    bag = foreign_bag(tmp_path / "bag", texts)
    main(["info", str(bag), "--json"])
    assert json.loads(capsys.readouterr().out)["attachments"] == {
        "plain": {"1": "2024-01-01", "b": "aGVsbG8=", "c": ["d"], "e": "nan", "f": [1.5, True]},
        "picture": "7 bytes that are no YAML",
    }
    main(["info", str(bag)])
    assert capsys.readouterr().out.endswith("\npicture\n7 bytes that are no YAML\n")


def test_no_name_is_taken_for_a_style(tmp_path, capsys):
    bag = foreign_bag(tmp_path / "a[b]" / "[red]:smile:", {"a[/b]": b"1"}, topic="/a[/b]c")
    main(["info", str(bag)])
    shown = capsys.readouterr().out
    assert shown.startswith(f"{bag}: 1 messages over 0.000 s")
    assert "│ /a[/b]c │" in shown
    assert "\na[/b]\n1\n" in shown


def test_no_name_commands_the_terminal(tmp_path, capsys):
    attachments = {"note\x1b[2J": b"\xff", "text": b'"\\e]0;title\\a \xc3\xa9"'}
    bag = foreign_bag(tmp_path / "bag", attachments, topic="/a\x1b[31m/joint_states")
    main(["info", str(bag)])
    shown = capsys.readouterr().out
    assert {letter for letter in shown if not letter.isprintable()} == {"\n"}
    assert r"│ /a\x1b[31m/joint_states │" in shown
    assert "\nnote\\x1b[2J\n" in shown
    assert "\n\\x1b]0;title\\x07 é\n" in shown
    with pytest.raises(SystemExit) as ended:
        vgps(["bag", "check", str(tmp_path / "nothing\x1b[2J")])
    assert r"nothing\x1b[2J" in str(ended.value)


def test_a_bag_without_joint_states_is_refused(tmp_path):
    bag = copy(tmp_path / "bag", lambda m: None if m.topic == "/joint_states" else m.data)
    fails(["check", str(bag)], "has no messages on joint_states")
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


def test_what_is_missing_is_named_and_the_last_motion_becomes_a_table(tmp_path, capsys):
    bag = without(tmp_path / "bag", "/joint_states", range(200, 250))
    for command, ending in (("table", "csv"), ("rerun", "rrd")):
        output = tmp_path / f"bag.{ending}"
        output.write_text("of before")
        main([command, str(bag), "--overwrite"])
        assert f"Not whole: 50 states from {time_of_state(199):.3f}" in capsys.readouterr().err
        assert output.stat().st_size > 1000
    with BagReader(SAMPLE) as sample:
        count = sample.counts["/joint_states"]
    times = {time_of_state(number) for number in range(250, count)}  # some come twice
    assert len((tmp_path / "bag.csv").read_text().split()) == 1 + len(times)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["bag", "bag.csv", "bag.rrd"]


def test_a_motion_without_torques_is_no_demonstration(tmp_path):
    def change(message):
        if message.topic != "/joint_states":
            return message.data
        # Efforts are the last field: no element instead of one for each of five joints.
        return message.data[: -5 * 8 - 8] + bytes(4)

    bag = copy(tmp_path / "bag", change)
    fails(["table", str(bag)], "The recorded joint_states have no efforts")


def test_an_unfinished_bag_is_explained_and_made_whole(tmp_path, capsys):
    bag = tmp_path / "bag"
    shutil.copytree(SAMPLE, bag)
    (bag / "metadata.yaml").unlink()
    [file] = bag.glob("*.mcap")
    with file.open("r+b") as stream:
        stream.truncate(file.stat().st_size - 100_000)
    for command in ("check", "info", "rerun"):
        fails([command, str(bag)], "was not closed, or is damaged (it has no metadata.yaml); `vgps")
    main(["reindex", str(bag)])
    rebuilt = capsys.readouterr()
    assert f"Rebuilt {file}; bag_0.mcap.unfinished is what was there before." in rebuilt.out
    assert "Not whole: bag_0.mcap: it breaks off at byte" in rebuilt.err
    main(["check", str(bag)])
    main(["reindex", str(bag)])
    assert "is whole" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["info", "check", "rerun", "table", "reindex"])
def test_what_is_no_bag_is_refused_with_a_sentence(command, tmp_path):
    fails([command, str(tmp_path)], "is not a bag")
    fails([command, str(tmp_path / "nothing")], "is not a bag")
    assert list(tmp_path.iterdir()) == []
