# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A task file and an MJCF become a task, however a user names them."""

import importlib

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.tasks.hopper_file import TASK
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.seeding import Stream, generator
from vgps_ros.simulation.model import deviation_names
from vgps_ros.tasks import Task, make_task, recorded_task


@pytest.fixture
def changed(folder):
    """Returns a function that makes the task with other lines in its file."""

    def make(*pairs):
        text = TASK
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new)
        (folder / "task.yaml").write_text(text)
        return make_task(str(folder))

    return make


def test_times_start_and_spreads_are_the_files(folder):
    task = make_task(str(folder))
    assert (task.horizon, task.lookahead, task.dynamics.substeps) == (400, 60, 2)
    assert_allclose(task.initial_state, [0, 0, 0, 0.2, 0, 0, 0, 0])
    assert_allclose(task.initial_std, [0, 0.01, 0.01, 0.01, 0.1, 0.1, 0.1, 0.1])
    assert_allclose(task.std_limit, [np.inf, 0.3, 0.3, 0.3, 4, 4, 4, 4])
    assert task.optimizer.ddp.regularization_floor == 0.1
    assert task.search == {"hidden_units": (10,), "fit.iterations": 50}


def test_a_cost_is_the_sum_of_its_terms(folder, rng):
    task = make_task(str(folder))
    states = 0.1 * rng.standard_normal((460, 8))
    states[:, 3] = 0.2
    controls = rng.standard_normal((460, 1))
    data = mujoco.MjData(task.dynamics.model)
    expected = []
    for x, u in zip(states, controls, strict=True):
        data.qpos, data.qvel = x[:4], x[4:]
        mujoco.mj_forward(task.dynamics.model, data)
        e = data.sensor("height").data[2] - 1.2
        cost = (data.sensor("velocity").data[0] - 1) ** 2 + 1e-4 * u @ u
        cost += 5 * (np.sqrt(e**2 + 0.2**2) - 0.2)
        cost += (data.sensor("com").data[2] - 3.0) ** 2
        expected.append(cost)
    assert_allclose(task.cost(states, controls), expected, rtol=1e-12)
    assert_allclose(task.cost(states[[7]], controls[[7]], first=7), expected[7:8], rtol=1e-12)


def test_a_policy_reads_what_the_file_names(folder):
    names = make_task(str(folder)).observation.names
    assert names[:3] == ("root_z/position", "pitch/position", "hip/position")
    assert names[3:7] == tuple(f"{j}/velocity" for j in ("root_x", "root_z", "pitch", "hip"))
    assert names[7:] == ("hip/sin", "hip/cos", "up/x", "up/y", "up/z")


def test_falls_and_limits_are_ranges_of_readings(changed):
    task = changed(("begin:", "limits: [{sensor: hip/position, above: 0.5}]\nbegin:"))
    states = np.zeros((4, 8))
    states[1, 1], states[2, 2], states[3, 3] = -0.6, -1.1, 0.6
    assert_array_equal(task.fallen(states), [False, True, True, False])
    assert task.limits.broken(states[3]) == "hip/position is 0.6, but the task allows -inf to 0.5."
    assert task.limits.broken(states[0]) == ""


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ("below: 0.7", "below: 2.7", "fallen"),
        ("begin: {", "limits: [{sensor: height, index: z, below: 2.7}]\nbegin: {", "limits"),
    ],
)
def test_a_start_that_is_outside_the_limits_is_refused(changed, old, new, name):
    with pytest.raises(InvalidInputError, match=name + r" of the task .* excludes its start: hei"):
        changed((old, new))


KEYS = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <frame pos="1 0 0">
      <body name="hand" mocap="true" pos="1 2 3"><geom size=".1" contype="0"/></body>
    </frame>
    <body name="arm"><joint name="elbow"/><geom size=".1" conaffinity="0"/></body>
  </worldbody>
  <equality><weld body1="hand" body2="arm"/></equality>
  <actuator>
    <position name="servo" joint="elbow" kp="9" timeconst="0.1"/>
    <motor name="motor" joint="elbow"/>
  </actuator>
  <keyframe>
    <key name="away" qpos="0.3" mpos="4 5 6" mquat="0 1 0 0" ctrl="0.7 9"/>
    <key name="other" qpos="0.3" act="0.2" ctrl="0.7 9"/>
  </keyframe>
</mujoco>
"""


@pytest.mark.parametrize(
    ("start", "place", "turn", "activation"),
    [
        ("", [2, 2, 3], [1, 0, 0, 0], 0.0),
        ("start: {keyframe: away}", [4, 5, 6], [0, 1, 0, 0], 0.7),
        ("start: {keyframe: 0}", [4, 5, 6], [0, 1, 0, 0], 0.7),
        ("start: {keyframe: other}", [2, 2, 3], [1, 0, 0, 0], 0.2),
    ],
)
def test_a_keyframe_places_mocap_bodies_and_what_lags_has_followed_its_control(
    folder, start, place, turn, activation
):
    (folder / "keys.xml").write_text(KEYS)
    (folder / "keys.yaml").write_text(
        f"model: keys.xml\ncontrol_period: 0.02\nhorizon: 0.4\ncost: [{{control: all}}]\n{start}\n"
    )
    task = make_task(str(folder / "keys.yaml"))
    data = mujoco.MjData(task.dynamics.model)
    assert_allclose(data.mocap_pos[0], place)
    assert_allclose(data.mocap_quat[0], turn)
    assert_allclose(task.initial_state, [0.3 if start else 0.0, 0.0, activation])
    again = mujoco.MjModel.from_xml_string(task.mjcf)  # as a bag's reader compiles it
    assert_allclose(mujoco.MjData(again).mocap_pos[0], place)


def test_a_pose_is_held_by_torques_in_the_motors_range(folder, rng):
    task = make_task(str(folder))
    motion = task.begin(task, task.initial_state, 100, rng).trajectory
    gains = 300 * (0.1 - motion.states[:-1, 3]) - 30 * motion.states[:-1, 7]
    assert_allclose(motion.controls[:, 0], np.clip(gains, -24, 24), rtol=1e-12)


def test_a_pose_of_a_gripper_is_a_control_of_its_range_not_its_tendons_length(folder, rng):
    """A fixed tendon of two fingers, from 0 to 0.04 m, is driven from 0 to 255, as a Panda's."""
    finger = "<body><joint name='{}' type='slide' damping='9'/><geom size='.1' mass='1'/></body>"
    (folder / "gripper.xml").write_text(f"""
        <mujoco>
          <option gravity='0 0 0' timestep='0.002'/>
          <worldbody>
            <body><joint name='elbow'/><geom size='.1'/></body>
            {finger.format("left")}{finger.format("right")}
          </worldbody>
          <tendon><fixed name='split'>
            <joint joint='left' coef='.5'/><joint joint='right' coef='.5'/>
          </fixed></tendon>
          <actuator>
            <position name='a1' joint='elbow' kp='9' ctrlrange='-1 1'/>
            <general name='hand' tendon='split' ctrlrange='0 255' gainprm='0.01568627451'
                     biastype='affine' biasprm='0 -100 -10'/>
          </actuator>
        </mujoco>""")
    (folder / "gripper.yaml").write_text("""
        model: gripper.xml
        control_period: 0.02
        horizon: 0.4
        start: {positions: {elbow: 0.2, left: 0.03, right: 0.01}}
        cost: [{control: all, pose: start, weight: 1.0}]
        observe: [joint_positions]
        begin: {law: pd, pose: {elbow: 0.2, left: 0.01, right: 0.01}}
        """)
    task = make_task(str(folder / "gripper.yaml"))
    assert task.actuated_joint_names == ["elbow", "hand"]
    assert_allclose(task.cost.control_targets, [0.2, 127.5], rtol=1e-9)
    motion = task.begin(task, task.initial_state, 20, rng).trajectory
    assert_allclose(motion.controls, np.tile([0.2, 63.75], (20, 1)), rtol=1e-9)


@pytest.mark.parametrize(
    ("law", "expected"),
    [("{law: zero}", 0.0), ("{law: noise, std: 3.0}", 3.0), ("{law: noise, std: 300.0}", 24.0)],
)
def test_a_beginning_draws_controls_in_the_motors_range(changed, law, expected):
    begin = TASK[TASK.index("begin:") : TASK.index("optimizer:")]
    task = changed((begin, f"begin: {law}\n"))
    controls = task.begin.controls(task, 460, generator(0, Stream.INITIAL_CONTROLS, 0))
    assert controls.shape == (460, 1)
    assert np.abs(controls).max() <= 24.0
    assert expected == 24.0 or controls.std() == pytest.approx(expected, rel=0.5)


def test_the_robots_text_compiles_to_the_very_model(folder):
    task = make_task(str(folder))
    again, model = mujoco.MjModel.from_xml_string(task.mjcf), task.dynamics.model
    assert deviation_names(again) == deviation_names(model)
    for name in ("body_inertia", "body_ipos", "geom_pos", "actuator_ctrlrange", "jnt_range"):
        assert_array_equal(getattr(again, name), getattr(model, name))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("sensor: com/z,", "sensor: com/q,", r"cost\[2\].*'com/q'.*'com/"),
        ("{joint: hip, as: sin_cos}", "{joint: hop, as: sin_cos}", r"observe\[2\].*'hop'.*'hip'"),
        ("sensor: pitch/position, b", "sensor: pith/position, b", r"fallen\[1\].*'pitch/position'"),
        ("positions: {hip: 0.2}", "positions: {hop: 0.2}", r"start\.positions\.hop.*'hip'"),
        ("positions: {hip: 0.2}", "positions: {hip: [1, 2]}", r"'hip' has 1 numbers, but 2"),
        ("keyframe: stand", "keyframe: stnd", r"start\.keyframe.*'stnd'.*'stand'"),
        ("pose: stand", "pose: sit", r"begin\.pose.*'sit'"),
        ("{control: all,", "{control: hap,", r"cost\[3\]\.control.*'hap'.*'hip'"),
        ("- {sensor: up}", "- {sensor: force}", r"observe\[3\].*'force'"),
    ],
)
def test_what_the_model_lacks_is_named_with_its_line(changed, old, new, sentence):
    with pytest.raises(InvalidInputError, match=r"task\.yaml line \d+, .*" + sentence):
        changed((old, new))


def test_a_policy_may_not_read_what_depends_on_its_control(changed):
    with pytest.raises(InvalidInputError, match=r"line \d+, observe: .*depends on the control"):
        changed(
            ("sensors:\n", "sensors:\n  force: {type: actuatorfrc, actuator: hip}\n"),
            ("- {sensor: up}", "- {sensor: force}"),
        )


def test_a_task_may_be_a_function_of_a_file_but_not_of_one_that_data_names(folder):
    (folder / "mine.py").write_text(
        "from vgps_ros.tasks import make_task\n"
        f"def short(): return make_task({str(folder)!r})\n"
        "def number(): return 5\n"
    )
    reference = f"{folder}/mine.py:short"
    assert isinstance(make_task(reference), Task)
    with pytest.raises(InvalidInputError, match="returns int, but it must return a"):
        make_task(f"{folder}/mine.py:number")
    with pytest.raises(InvalidInputError, match=r"no function 'shrt'.* Did you mean 'short'\?"):
        make_task(f"{folder}/mine.py:shrt")
    with pytest.raises(InvalidInputError, match="is Python code, which is not run"):
        recorded_task(reference)
    (folder / "broken.py").write_text("1 / 0")
    with pytest.raises(InvalidInputError, match=r"broken\.py does not run: ZeroDivisionError"):
        make_task(f"{folder}/broken.py:task")


def test_a_package_may_offer_tasks(folder, tmp_path, monkeypatch):
    package = tmp_path / "site"
    (package / "offering-1.dist-info").mkdir(parents=True)
    (package / "offering-1.dist-info" / "METADATA").write_text("Name: offering\nVersion: 1\n")
    (package / "offering-1.dist-info" / "entry_points.txt").write_text(
        "[vgps_ros.tasks]\njumper = offering:jumper\n"
    )
    (package / "offering.py").write_text(
        f"from vgps_ros.tasks import make_task\ndef jumper(): return make_task({str(folder)!r})\n"
    )
    monkeypatch.syspath_prepend(str(package))
    importlib.invalidate_caches()
    assert recorded_task("jumper").horizon == 400
    with pytest.raises(InvalidInputError, match=r"Did you mean 'jumper'\?"):
        make_task("jumpr")
