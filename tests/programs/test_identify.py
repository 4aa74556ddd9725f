# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A bag of a robot becomes a task with the robot as it was found, or a sentence says why not."""

import mujoco
import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from tests.search.test_identification import ARM, KNOWN, STOOL, moved
from vgps_ros.bags import BagWriter
from vgps_ros.programs.__main__ import run_command
from vgps_ros.tasks import make_task

TASK = """
model: arm.xml
control_period: 0.02
horizon: 1.0
cost:
  - {sensor: elbow/position, target: 0.5}
  - {control: all, weight: 0.01}
begin: {law: path, file: elbow.csv}
search: {iterations: 3, fit: {iterations: 20}}
"""
START = 1_000_000_000  # of stamps [ns]
STORE = get_typestore(Stores.ROS2_JAZZY)
JOINTS, ARRAY = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
IMU, QUATERNION, VECTOR = (
    "sensor_msgs/msg/Imu",
    "geometry_msgs/msg/Quaternion",
    "geometry_msgs/msg/Vector3",
)


def header_of(t, frame=""):
    types, stamp = STORE.types, divmod(START + round(t * 1e9), 10**9)
    time = types["builtin_interfaces/msg/Time"](sec=stamp[0], nanosec=stamp[1])
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def joint_state(t, names, **values):
    arrays = {k: np.array(values.get(k, [])) for k in ("position", "velocity", "effort")}
    message = STORE.types[JOINTS](header=header_of(t), name=names, **arrays)
    return STORE.serialize_cdr(message, JOINTS)


def imu(t, frame, turned, rate):
    x, y, z, w = turned.as_quat().tolist()
    none, vector = np.zeros(9), STORE.types[VECTOR]
    q = STORE.types[QUATERNION](x=x, y=y, z=z, w=w)
    values = (q, none, vector(*rate.tolist()), none, vector(0.0, 0.0, 9.8), none)
    return STORE.serialize_cdr(STORE.types[IMU](header_of(t, frame), *values), IMU)


def array(values):
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return STORE.serialize_cdr(STORE.types[ARRAY](layout=layout, data=values), ARRAY)


def record(folder, motion, names=("elbow", "shoulder"), left_out=(), arrays=False):
    """Writes a bag of two joints, in another order than the model's, by the recorder's writer."""
    bag = BagWriter(folder)
    told = ("/arm/commands", ARRAY) if arrays else ("/joint_command", JOINTS)
    for topic, kind in (("/joint_states", JOINTS), told):
        bag.add_topic(topic, kind, "", [])
    for t, x, u in zip(motion.time, motion.states, motion.controls, strict=True):
        received = START + round(t * 1e9) + 300_000
        if "joint_states" not in left_out:
            q, v = x[1::-1], x[:1:-1]
            state = joint_state(t, list(names), position=q, velocity=v)
            bag.write("/joint_states", received, state)
        if "joint_command" not in left_out:
            command = array(u) if arrays else joint_state(t, ["shoulder", "elbow"], position=u)
            bag.write(told[0], received, command)
    bag.close()
    return str(folder)


@pytest.fixture
def task(tmp_path):
    folder = tmp_path / "task"
    folder.mkdir()
    (folder / "arm.xml").write_text(ARM.format(**KNOWN))
    rows = "".join(f"{t:.2f},{0.3 * np.sin(t):.4f}\n" for t in np.arange(0, 1.01, 0.02))
    (folder / "elbow.csv").write_text("time,elbow/position\n" + rows)
    (folder / "task.yaml").write_text(TASK)
    return str(folder)


@pytest.mark.parametrize("arrays", [False, True])
def test_a_bag_becomes_a_task_that_trains_from_what_was_found(tmp_path, rng, task, capsys, arrays):
    true = KNOWN | {"damping": 0.8, "gain": 34, "kv": 0.85, "friction": 0.2}
    bag = record(tmp_path / "bag", moved(ARM.format(**true), rng, seconds=5.0), arrays=arrays)
    output = tmp_path / "out" / "found.yaml"
    run_command(["identify", bag, "--task", task, "--output", str(output)])
    said = capsys.readouterr().out
    assert "The bag cannot tell" in said
    assert "largest torque" in said
    found = make_task(str(output))
    assert found.dynamics.model.dof_damping[0] == pytest.approx(0.8, rel=0.1)
    assert found.dynamics.controls.stiffness == pytest.approx([34, 34], rel=0.05)
    content = yaml.safe_load(output.read_text())
    assert content["search"]["iterations"] == 3
    assert content["search"]["fit.iterations"] == 20
    assert 0.0 < content["search"]["disturb.gain"] < 0.2
    assert output.with_suffix(".png").stat().st_size > 10_000
    run_command(["train", "--task", str(output), "--output", str(tmp_path / "run"), "--check"])
    with pytest.raises(SystemExit, match=r"found\.yaml"):  # which is not replaced
        run_command(["identify", bag, "--task", task, "--output", str(output)])


def test_the_site_of_the_new_model_is_turned_as_the_imu_is(tmp_path, rng, capsys):
    site = '<freejoint name="root"/><site name="chip" euler="180 0 0"/>'
    robot = STOOL.format(damping=1.0, mass=5.0).replace('<freejoint name="root"/>', site)
    mount, chip = (0.08, -0.06, 0.0), Rotation.from_euler("x", np.pi)
    motion = moved(robot, rng, seconds=4.0, size=0.3, mount=mount, blind=True)
    (tmp_path / "stool.xml").write_text(robot)
    cost = "cost: [{control: all}]"
    task = tmp_path / "task.yaml"
    task.write_text(f"model: stool.xml\ncontrol_period: 0.02\nhorizon: 1.0\n{cost}\n")
    bag, legs = BagWriter(tmp_path / "bag"), [f"leg{i}" for i in range(4)]
    for topic, kind in (("/joint_states", JOINTS), ("/imu", IMU), ("/joint_command", JOINTS)):
        bag.add_topic(topic, kind, "", [])
    for t, x, u in zip(motion.time, motion.states, motion.controls, strict=True):
        received = START + round(t * 1e9)
        turned = Rotation.from_quat(x[3:7], scalar_first=True) * chip
        joints = joint_state(t, legs, position=x[7:11], velocity=x[17:])
        bag.write("/joint_states", received, joints)
        # The IMU has stamps of its own, and is a millisecond late.
        bag.write(
            "/imu", received + 1_000_000, imu(t + 0.001, "chip", turned, chip.inv().apply(x[14:17]))
        )
        bag.write("/joint_command", received + 2_000_000, joint_state(t, legs, position=u))
    bag.close()
    run_command(["identify", str(tmp_path / "bag"), "--task", str(task)])
    assert "imu_frame: identified_imu" in capsys.readouterr().out
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "bag-identified.xml"))
    found = Rotation.from_quat(model.site("identified_imu").quat, scalar_first=True) * chip.inv()
    assert found.as_rotvec()[:2] == pytest.approx(mount[:2], abs=0.02)


def test_a_bag_that_does_not_suit_is_refused_by_a_sentence(tmp_path, rng, task):
    motion = moved(ARM.format(**KNOWN), rng, seconds=1.0)

    def refused(sentence, name=task, **options):
        bag = record(tmp_path / f"bag{len(list(tmp_path.iterdir()))}", motion, **options)
        with pytest.raises(SystemExit, match=sentence):
            run_command(["identify", bag, "--task", name])

    refused("has no messages on joint_command", left_out=["joint_command"])
    refused("has no messages on joint_states", left_out=["joint_states"])
    refused("has wheel, tail, but the task .* has shoulder, elbow", names=("wheel", "tail"))
    refused("elbow is not there", names=("tail", "shoulder"))
    refused("at least 8 are needed; record some 10 s")
    refused("is made by Python code", name="walker")
