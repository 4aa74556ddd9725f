# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Data sets that `export-dataset` writes, from the real run that the repository ships."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from tests.bags.altered import SAMPLE, copy, messages_of, time_of_state, without, write_bag
from vgps_ros.bags import BagReader, episode
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.simulation.model import compile_model
from vgps_ros.tasks import make_task

FILE = "chunk-000/file-000.parquet"


@pytest.fixture(scope="module")
def motion():
    with BagReader(SAMPLE) as bag:
        return episode.episodes(bag, compile_model(bag.mjcf()))[-1]


@pytest.fixture
def written(tmp_path):
    def run(*arguments):
        folder = tmp_path / "set"
        vgps(["export-dataset", *map(str, arguments), "--output", str(folder)])
        return folder

    return run


def rows(table, name):
    return np.array(table[name].to_pylist())


def test_the_table_holds_each_state_with_the_torque_that_was_chosen_in_it(written, motion):
    table = pq.read_table(written(SAMPLE, SAMPLE) / "motions.parquet")
    task, steps = make_task("swimmer"), len(motion.time) - 1
    assert table.num_rows == 2 * steps
    assert set(table["bag"].to_pylist()) == {"sample"}
    first = table.filter(np.array(table["episode"]) == 0)
    states = np.stack([rows(first, name) for name in ("front_joint/position", "root_x/velocity")])
    np.testing.assert_array_equal(states, motion.states[:-1, [3, 5]].T)
    torques = np.stack([rows(first, name) for name in ("front_joint/effort", "back_joint/effort")])
    np.testing.assert_array_equal(torques, motion.controls[1:].T)
    time_step = task.dynamics.time_step
    np.testing.assert_allclose(rows(first, "time"), time_step * np.arange(steps))
    after = task.dynamics.step(motion.states[7], torques[:, 7])
    np.testing.assert_allclose(after, motion.states[8], atol=1e-9)  # so the torque acted there
    assert table.schema.metadata[b"mjcf"].decode() == task.mjcf


def test_lerobots_files_hold_the_same_motion_and_its_statistics(written, motion):
    folder, steps = written(SAMPLE, SAMPLE, "--format", "lerobot"), len(motion.time) - 1
    info = json.loads((folder / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 50, "swimmer")
    assert (info["total_episodes"], info["total_frames"]) == (2, 2 * steps)
    assert info["features"]["action"]["names"] == ["front_joint/effort", "back_joint/effort"]
    table = pq.read_table(folder / "data" / FILE)
    assert set(table.column_names) == set(info["features"])
    state = rows(table, "observation.state")
    np.testing.assert_array_equal(state[:steps], motion.states[:-1].astype(np.float32))
    np.testing.assert_array_equal(rows(table, "action")[steps:], np.float32(motion.controls[1:]))
    np.testing.assert_allclose(rows(table, "timestamp")[:steps], np.arange(steps) / 50, atol=1e-6)
    np.testing.assert_array_equal(rows(table, "index"), np.arange(2 * steps))
    of_episodes = pq.read_table(folder / "meta" / "episodes" / FILE).to_pylist()
    spans = [(e["dataset_from_index"], e["dataset_to_index"]) for e in of_episodes]
    assert spans == [(0, steps), (steps, 2 * steps)]
    assert of_episodes[1]["tasks"] == ["swimmer"]
    told = json.loads((folder / "meta" / "stats.json").read_text())["observation.state"]
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(told[name], getattr(state, name)(axis=0), atol=1e-5)
    assert told["count"] == [2 * steps]
    tasks = pq.read_table(folder / "meta" / "tasks.parquet")
    index = json.loads(tasks.schema.metadata[b"pandas"])  # by which LeRobot finds a task's name
    assert index["index_columns"] == ["task"]
    assert {column["field_name"] for column in index["columns"]} == set(tasks.column_names)


@pytest.mark.parametrize("by_efforts", [True, False])
def test_a_reset_begins_an_episode_with_torques_of_its_own(
    tmp_path, motion, by_efforts, monkeypatch
):
    """The whole run comes twice; torques are read from the states or from what answered them."""
    monkeypatch.setattr(episode, "controls_are_forces", lambda _: by_efforts)
    of_robot = [m for m in messages_of() if m.topic in ("/joint_states", "/joint_command")]
    length = of_robot[-1].stamp - of_robot[0].stamp + 10**9
    again = [
        replace(
            m, stamp=m.stamp + length, data=half_the_torque(m.data) if "comm" in m.topic else m.data
        )
        for m in of_robot
    ]
    bag_path = write_bag(tmp_path / "bag", [*of_robot, *again])
    with BagReader(SAMPLE) as bag:
        model = compile_model(bag.mjcf())
    with BagReader(bag_path) as bag:
        found = episode.episodes(bag, model)
    assert [len(each.time) for each in found] == [len(motion.time)] * 2
    halved = 1.0 if by_efforts else 0.5
    np.testing.assert_array_equal(found[0].controls[1:], motion.controls[1:])
    np.testing.assert_array_equal(found[1].controls[1:], halved * motion.controls[1:])


def half_the_torque(data):
    """Returns a recorded command, whose last bytes are its two efforts, with half of each."""
    return data[:-16] + (0.5 * np.frombuffer(data[-16:])).tobytes()


def paused(folder):
    """The sample of a recorder that was paused for a second."""
    return without(folder, "/joint_states", range(200, 250))


def without_answers(folder):
    """The sample without the commands of a second."""
    return without(folder, "/joint_command", range(200, 250))


@pytest.mark.parametrize(
    ("hole", "form", "words"),
    [
        (paused, "parquet", "'{}': 50 states from {:.3f}"),
        (paused, "lerobot", "'{}': 50 states from {:.3f}"),
        (without_answers, "parquet", "'{}': 50 states lack the control that answers them"),
    ],
)
def test_what_is_missing_ends_an_episode_and_is_named(
    written, tmp_path, capsys, monkeypatch, form, hole, words
):
    if hole is without_answers:
        monkeypatch.setattr(episode, "controls_are_forces", lambda _: False)
    bag = hole(tmp_path / "holed")
    folder = written(bag, "--format", form)
    said = capsys.readouterr().err
    assert f"Not whole: {words.format(bag, time_of_state(199))}" in said
    assert "a motion ends there" in said
    file = folder / ("motions.parquet" if form == "parquet" else f"data/{FILE}")
    table = pq.read_table(file)
    episodes = rows(table, "episode" if form == "parquet" else "episode_index")
    times = rows(table, "time" if form == "parquet" else "timestamp")
    assert set(episodes) == {0, 1}
    for k in (0, 1):
        np.testing.assert_allclose(np.diff(times[episodes == k]), 0.02, atol=1e-6)
    if form == "parquet":  # the times are those of the messages
        assert times[episodes == 1][0] - times[episodes == 0][-1] > 0.05


def test_pictures_show_the_robot_in_each_state(written, tmp_path):
    pytest.importorskip("mujoco.egl", exc_type=(ImportError, AttributeError))
    folder = written(SAMPLE, "--format", "lerobot", "--pictures", "64x48")
    pictures = pq.read_table(folder / "data" / FILE)["observation.images.robot"].to_pylist()
    first, last = (np.asarray(Image.open(io.BytesIO(pictures[i]["bytes"]))) for i in (0, -1))
    assert first.shape == last.shape == (48, 64, 3)
    assert np.abs(first.astype(int) - last).max() > 30


def test_what_cannot_be_written_is_refused_and_nothing_is_left(written, tmp_path):
    def fails(sentence, *arguments, code=1):
        with pytest.raises(SystemExit) as stop:
            written(*arguments)
        assert code == stop.value.code if code != 1 else sentence in str(stop.value.code)

    (tmp_path / "set").mkdir()
    kept = tmp_path / "set" / "kept.txt"
    kept.write_text("mine")
    fails("is not an empty folder", SAMPLE)
    fails("is not an empty folder", SAMPLE, "--overwrite")  # which is no data set
    assert [file.name for file in (tmp_path / "set").iterdir()] == ["kept.txt"]
    kept.unlink()
    fails("is not a bag", tmp_path / "nothing")
    fails("", SAMPLE, "--pictures", "64x48", code=2)
    fails("", SAMPLE, "--format", "lerobot", "--pictures", "1x1", code=2)
    assert [path.name for path in Path(tmp_path).iterdir()] == ["set"]
    written(SAMPLE)
    assert (tmp_path / "set" / "motions.parquet").is_file()
    fails("or give --overwrite", SAMPLE, "--format", "lerobot")
    written(SAMPLE, "--format", "lerobot", "--overwrite")
    assert sorted(path.name for path in (tmp_path / "set").iterdir()) == ["data", "meta"]


def test_only_motions_of_one_robot_at_one_rate_make_a_data_set(written, tmp_path):
    count = iter(range(10_000))

    def without(message, kept):
        is_dropped = message.topic == "/joint_states" and not kept(next(count))
        return None if is_dropped else message.data

    half = copy(tmp_path / "half", lambda message: without(message, lambda i: i % 2 == 0))
    none = copy(tmp_path / "none", lambda message: without(message, lambda i: False))
    other = copy(tmp_path / "other", lambda m: m.data.replace(b"front_joint", b"other_joint"))
    for bag, sentence in (
        (half, "half' has a state each 0.04 s, but the bag before it each 0.02 s"),
        (none, "no messages on joint_states"),
        (other, "other' is of another robot than the bag before it, by '"),
    ):
        with pytest.raises(SystemExit) as stop:
            written(SAMPLE, bag)
        assert sentence in str(stop.value.code)
    assert not (tmp_path / "set").exists()
