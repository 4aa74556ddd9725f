# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A recorded robot with a free base and a ball: its frames and its URDF, as others read them."""

import subprocess
import sys
from collections import defaultdict
from functools import reduce
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from tf2_msgs.msg import TFMessage

from tests.nodes.test_free_base import TASK
from tests.simulation.robots import EVERYTHING
from tests.simulation.urdf_kinematics import matrix, read
from vgps_ros.messages.conversions import nanoseconds
from vgps_ros.messages.robot_state import StateMessages
from vgps_ros.simulation.frames import ROOT, frame_names, state_layout
from vgps_ros.simulation.urdf import urdf
from vgps_ros.tasks import make_task

FIXED_FOOT = '<body name="toe" pos="0 0 -.02" euler="0 30 0"><geom size=".01" mass=".01"/></body>'


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    folder = tmp_path_factory.mktemp("framed")
    mjcf = EVERYTHING.replace('<body name="tail"', f'{FIXED_FOOT}<body name="tail"')
    (folder / "everything.xml").write_text(mjcf)
    (folder / "task.yaml").write_text(TASK)
    return make_task(str(folder / "task.yaml"))


@pytest.fixture(scope="module")
def bag(shared_graph, task, tmp_path_factory) -> Path:
    """Returns the file of a bag of half a second in real time, without torques."""
    folder = tmp_path_factory.mktemp("run") / "bag"
    recorder = shared_graph.start("recorder", output=folder)
    shared_graph.spin_until_output(recorder, "Recording to")
    frames = shared_graph.messages(TFMessage, "/tf")
    given = {"task": task.name, "mode": "real_time", "tf_rate": 100.0}
    simulation = shared_graph.start("simulation", **given)
    shared_graph.spin_until(lambda: len(frames) > 50, what="frames")
    assert simulation.end() == 0
    assert recorder.end() == 0
    [file] = folder.glob("*.mcap")
    return file


@pytest.fixture(scope="module")
def messages(bag):
    """Returns the bag's messages by topic, as mcap-ros2-support reads them."""
    found = defaultdict(list)
    with bag.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, content in reader.iter_decoded_messages():
            found[channel.topic].append(content)
    return found


def poses(message) -> dict[str, tuple[str, np.ndarray]]:
    """Returns the parent and the pose of each frame."""
    found = {}
    for stamped in message.transforms:
        to, turned = stamped.transform.translation, stamped.transform.rotation
        pose = matrix(
            np.array([to.x, to.y, to.z]), np.array([turned.w, turned.x, turned.y, turned.z])
        )
        found[stamped.child_frame_id] = (stamped.header.frame_id, pose)
    return found


def in_the_root(name: str, tree: dict) -> np.ndarray:
    chain = []
    while name != ROOT:
        name, pose = tree[name]
        chain.append(pose)
    return reduce(np.matmul, reversed(chain), np.eye(4))


def test_the_frames_on_tf_are_mujocos(messages, task):
    model = task.dynamics.model
    states, data = StateMessages(state_layout(model)), mujoco.MjData(model)
    [fixed] = messages["/tf_static"]
    tree = poses(fixed)
    assert tree.keys() == {"toe"}
    by_stamp = defaultdict(dict)
    for topic in states.topics:
        for message in messages[f"/{topic}"]:
            by_stamp[nanoseconds(message.header.stamp)][topic] = message
    compared, base = 0, []
    for message in messages["/tf"]:
        [stamp] = {nanoseconds(stamped.header.stamp) for stamped in message.transforms}
        if by_stamp[stamp].keys() != states.topics.keys():
            continue  # the recorder had not found all of the topics yet
        data.qpos[:] = states.join(by_stamp[stamp])[: model.nq]
        mujoco.mj_kinematics(model, data)
        tree |= poses(message)
        for body, name in enumerate(frame_names(model)):
            theirs = matrix(data.xpos[body], data.xquat[body])
            np.testing.assert_allclose(in_the_root(name, tree), theirs, rtol=0, atol=1e-12)
        at = by_stamp[stamp]["odom"].pose.pose.position
        assert by_stamp[stamp]["odom"].header.frame_id == ROOT
        np.testing.assert_array_equal(tree["base"][1][:3, 3], [at.x, at.y, at.z])
        compared, base = compared + 1, [*base, at.z]
    assert compared > 20
    assert np.ptp(base) > 1e-3  # it fell


def test_every_frame_is_a_link_of_the_recorded_urdf(messages, task):
    [description] = {message.data for message in messages["/robot_description"]}
    assert description == urdf(task.dynamics.model)
    [mjcf] = {message.data for message in messages["/mjcf_description"]}
    assert mjcf == task.mjcf
    robot = read(task.dynamics.model)
    tree = poses(messages["/tf_static"][0]) | poses(messages["/tf"][0])
    assert {*tree, ROOT} == set(robot.link_map)
    parents = {joint.child: joint.parent for joint in robot.joint_map.values()}
    assert {name: parent for name, (parent, _) in tree.items()} == parents


def test_rerun_reads_the_bag(bag, tmp_path):
    rerun = Path(sys.executable).with_name("rerun")
    drawn = tmp_path / "run.rrd"
    subprocess.run([rerun, "mcap", "convert", bag, "-o", drawn], check=True, capture_output=True)
    printed = subprocess.run(
        [rerun, "rrd", "print", drawn], capture_output=True, text=True, check=True
    )
    assert "Transform3D" in printed.stdout
    assert "/tf" in printed.stdout
