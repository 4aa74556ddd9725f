# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A policy as the Microduck loads it: fed as its daemon feeds it, by onnxruntime alone."""

import json

import numpy as np
import onnxruntime
import pytest
from scipy.spatial.transform import Rotation

from tests.onnx_models import drawn_policy, exported
from vgps_ros.robot.executed_control import Driver
from vgps_ros.simulation.model import state_names
from vgps_ros.tasks import make_task

LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee", "ankle")
HEAD = ("neck_pitch", "head_pitch", "head_yaw", "head_roll")
JOINTS = (*(f"left_{part}" for part in LEG), *HEAD, *(f"right_{part}" for part in LEG))
AXES = dict(zip(LEG, ("0 0 1", "1 0 0", "0 1 0", "0 1 0", "0 1 0"), strict=True))
AXES |= dict(zip(HEAD, ("0 1 0", "0 1 0", "0 0 1", "1 0 0"), strict=True))
POSE = {"hip_pitch": -0.4, "knee": 0.8, "ankle": -0.4, "neck_pitch": -0.3, "head_pitch": 0.3}
OBSERVED = "joint_positions, joint_velocities, up, turning, last_action, commands"
TASK = f"""
model: duck.xml
changes:
  joints: {{"neck_*": {{lock: -0.3}}, "head_*": {{lock: 0}}, head_pitch: {{lock: 0.3}}}}
control_period: 0.02
horizon: 1.0
start: {{keyframe: standing}}
commands:
  forward: {{from: cmd_vel/linear/x, range: [-0.1, 0.2], unit: m/s}}
  turn: {{from: cmd_vel/angular/z, range: [-1, 1], unit: rad/s}}
clock: {{frequency: 3.7}}
sensors:
  turning: {{type: gyro, xbody: trunk}}
  up: {{type: framezaxis, xbody: world, relative_to: {{xbody: trunk}}}}
  speed: {{type: velocimeter, xbody: trunk}}
cost:
  - {{sensor: speed, index: x, target: {{command: forward}}}}
  - {{sensor: turning, index: z, target: {{command: turn}}}}
observe: [{OBSERVED}, clock]
history: 2
"""
WHOLE = TASK.replace("changes:\n", "").replace(TASK.splitlines()[3] + "\n", "")
STEPS = 60
COMMANDS = np.array([0.15, -0.5])


def limb(names, size, place):
    """Bodies, each in the one before, that turn about their joints."""
    inner = ""
    for name in reversed(names):
        part = name.removeprefix("left_").removeprefix("right_")
        box = f'<geom type="box" size="{size}" pos="0 0 -.01" mass=".02"/>'
        inner = (
            f'<body name="{name}_body" pos="0 0 {place}"><joint name="{name}" '
            f'axis="{AXES[part]}" damping=".04" armature=".002"/>{box}{inner}</body>'
        )
    return inner


def duck(kind="position", reverse=False, left_out=()):
    """A biped of boxes with the Microduck's servos."""
    legs = {side: [f"{side}_{part}" for part in LEG] for side in ("left", "right")}
    driven = [j for j in JOINTS if j not in left_out]
    head = limb([j for j in HEAD if j not in left_out], ".01 .01 .005", ".02")
    gains = 'kp="2" forcerange="-1 1"' if kind == "position" else ""
    servos = "".join(
        f'<{kind} name="{j}" joint="{j}" {gains}/>' for j in driven[:: -1 if reverse else 1]
    )
    pose = " ".join(str(POSE.get(j.split("_", 1)[1], POSE.get(j, 0))) for j in tree(driven))
    return f"""
<mujoco><compiler angle="radian"/><option timestep=".005" integrator="implicitfast"/>
<worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body name="trunk" pos="0 0 .16"><freejoint name="trunk_free"/>
<geom type="box" size=".03 .04 .03" mass=".3" contype="0" conaffinity="0"/>
<body name="left" pos="0 .04 0">{limb(legs["left"], ".02 .01 .004", "-.02")}</body>
<body name="neck" pos=".02 0 .03">{head}</body>
<body name="right" pos="0 -.04 0">{limb(legs["right"], ".02 .01 .004", "-.02")}</body>
</body></worldbody><actuator>{servos}</actuator>
<keyframe><key name="standing" qpos="0 0 .16 1 0 0 0 {pose}"/></keyframe></mujoco>
"""


def tree(joints):
    return [j for j in JOINTS if j in joints]


def made(folder, task=TASK, **changes):
    (folder / "duck.xml").write_text(duck(**changes))
    (folder / "task.yaml").write_text(task)
    return make_task(str(folder / "task.yaml"))


def written(folder, task):
    policy = drawn_policy(task, (16, 8), 0.2)
    exported(policy, task, folder, "--microduck", folder / "microduck-boxes", "--overwrite")
    return policy, folder / "microduck-boxes"


def contexts(task, commands):
    return task.signals.context(np.array(commands), task.signals.phases(len(commands), 0.0))


def expected(task, policy, states, context):
    """Targets by the project's own driver of states (T, n_x), as all 14 joints have them."""
    driver = Driver.of(task.observation, policy)
    law, observation = driver.new_law(), driver.observation
    found = np.array(
        [law(observation.within(z)(x[None]))[0] for z, x in zip(context, states, strict=True)]
    )
    targets = task.controls.at_joints(np.clip(found, *task.controls.limits))
    pose = np.tile([POSE.get(j.split("_", 1)[1], POSE.get(j, 0)) for j in JOINTS], (len(states), 1))
    pose[:, [JOINTS.index(name) for name in task.controls.names]] = targets
    return pose


def as_measured(task, states):
    """The states with joint velocities of one step before, which the first one has itself."""
    columns = [i for i, n in enumerate(state_names(task.dynamics.model)) if n.endswith("/velocity")]
    late = states.copy()
    late[1:, columns] = states[:-1, columns]
    return late


def daemon(task, folder, late, commands):
    """Targets that a Microduck sends, by what its owners say of its 61 numbers."""
    session = onnxruntime.InferenceSession(folder / "policy.onnx")
    says = json.loads(session.get_modelmeta().custom_metadata_map["microduck"])
    names, default = state_names(task.dynamics.model), np.array(says["default_joint_pos"])
    inputs = {i.name: i for i in session.get_inputs()}
    memory = {name: np.zeros(inputs[name].shape, np.float32) for name in [*inputs][1:]}
    outputs, raw, sent = [o.name for o in session.get_outputs()], np.zeros(14), []
    assert outputs[0] == "actions"
    for state, (forward, turn) in zip(late, commands, strict=True):
        read = dict(zip(names, state, strict=True))
        rotation = Rotation.from_quat([read[f"trunk_free/q{i}"] for i in "xyzw"])
        positions = [read.get(f"{j}/position", p) for j, p in zip(JOINTS, default, strict=True)]
        obs = np.concatenate(
            [
                [read[f"trunk_free/w{i}"] for i in "xyz"],
                rotation.inv().apply([0, 0, -1]),
                np.array(positions) - default,
                [read.get(f"{j}/velocity", 0.0) for j in JOINTS],
                raw,
                [forward, 0.3, turn],  # of which the task has no command sideways
                np.full(10, 0.1),  # the head's and the body's, which a policy of ours leaves
            ]
        )
        found = session.run(None, {"obs": obs[None].astype(np.float32), **memory})
        raw = found[0][0]
        memory = {
            name.replace("_out", "_in"): v for name, v in zip(outputs[1:], found[1:], strict=True)
        }
        sent.append(default + says["action_scale"] * raw)
    return np.array(sent)


def rollout(task, policy, context):
    driver = Driver.of(task.observation, policy)
    law, observed = driver.new_law(), driver.observation.within
    first = task.initial_state + 0.0
    first[-6:] += 0.3
    found = task.dynamics.rollout(first, lambda t, x: law(observed(context[t])(x)), STEPS)
    return found.states[:-1]


@pytest.mark.parametrize(
    ("text", "changes"),
    [
        (TASK, {}),
        (TASK.replace("history: 2", "history: 1"), {"reverse": True}),
        (WHOLE.replace("history: 2", "").replace(", clock]", "]"), {"reverse": True}),
    ],
    ids=["remembering", "servos in another order", "feed-forward, head and all"],
)
def test_the_daemon_sends_what_our_driver_does(text, changes, tmp_path):
    task = made(tmp_path, text, **changes)
    policy, folder = written(tmp_path, task)
    commands = np.tile(COMMANDS, (STEPS, 1))
    context = contexts(task, commands)
    late = as_measured(task, rollout(task, policy, context))
    wanted = expected(task, policy, late, context)
    assert np.abs(wanted - wanted[0]).max() > 0.1  # it moves
    assert np.abs(late[-1] - late[0]).max() > 0.1
    np.testing.assert_allclose(daemon(task, folder, late, commands), wanted, rtol=0, atol=1e-5)


def test_a_clock_that_stops_stands_until_the_robot_is_tilted(tmp_path):
    task = made(tmp_path, TASK.replace("3.7}", "3.7, stops: true}"))
    policy, folder = written(tmp_path, task)
    states = np.tile(task.initial_state, (90, 1))
    states[3, 3:7] = [np.cos(0.1), np.sin(0.1), 0, 0]
    commands = np.zeros((90, 2))
    commands[85:] = COMMANDS
    phases = task.signals.phases(90, 0.0)
    calm, turning = (s.context(commands, phases) for s in (task.signals, task.signals.turning))
    awake = task.unrest.awake(states)
    assert 0 < awake.sum() < 80
    wanted = expected(task, policy, states, np.where(awake[:, None], turning, calm))
    assert np.abs(wanted[10] - wanted[11]).max() > 1e-3 > np.abs(wanted[83] - wanted[84]).max()
    np.testing.assert_allclose(daemon(task, folder, states, commands), wanted, rtol=0, atol=1e-5)


def test_the_files_say_what_the_daemon_compares(tmp_path, capsys):
    task = made(tmp_path)
    _, folder = written(tmp_path, task)
    said = capsys.readouterr().out
    assert "The robot holds neck_pitch, head_pitch, head_yaw, head_roll by its default" in said
    assert "one step old" in said
    session = onnxruntime.InferenceSession(folder / "policy.onnx")
    shapes = {each.name: each.shape for each in (*session.get_inputs(), *session.get_outputs())}
    assert shapes.pop("obs") == [1, 61]
    assert shapes.pop("actions") == [1, 14]
    n = shapes["h_in"][2]
    assert shapes == {f"{half}_{way}": [1, 1, n] for half in "hc" for way in ("in", "out")}
    says = json.loads(session.get_modelmeta().custom_metadata_map["microduck"])
    assert says.pop("joint_names") == [*JOINTS]
    pose = [0, 0, -0.4, 0.8, -0.4]
    assert says.pop("default_joint_pos") == pytest.approx([*pose, -0.3, 0.3, 0, 0, *pose])
    sizes = dict(says.pop("observation"))
    assert [*sizes.values()] == [3, 3, 14, 14, 14, 3, 4, 6]
    assert [*sizes][4:] == ["actions", "command", "head_command", "body_command"]
    assert says == {
        "schema_version": 1,
        "obs_len": 61,
        "action_len": 14,
        "control_hz": 50,
        "action_scale": 1.0,
        "kp_fw": 200,
    }
    manifest = json.loads((folder / "manifest.json").read_text())
    assert (manifest["schema_version"], manifest["model_api"]) == (2, 2)
    assert (manifest["obs_len"], manifest["action_len"]) == (61, 14)
    assert manifest["robot"]["model"] == "microduck"
    assert (manifest["name"], manifest["slot"]) == ("boxes", "walk")
    assert manifest["command"]["twist"] == [
        "forward, -0.1 to 0.2 m/s",
        "unused (zeros)",
        "turn, -1 to 1 rad/s",
    ]


def test_a_policy_without_memory_needs_no_newer_daemon(tmp_path):
    text = TASK.replace("history: 2", "").replace(", clock]", "]")
    _, folder = written(tmp_path, made(tmp_path, text))
    assert json.loads((folder / "manifest.json").read_text())["model_api"] == 1
    session = onnxruntime.InferenceSession(folder / "policy.onnx")
    assert [each.name for each in session.get_inputs()] == ["obs"]


@pytest.mark.parametrize(
    ("text", "changes", "sentence"),
    [
        (TASK.replace("0.02", "0.01"), {}, "control period of 0.01 s; change control_period"),
        (TASK.replace("up, ", "up, speed, "), {}, "reads 'speed/x', which is none of a Microd"),
        (TASK.replace("from: cmd_vel/linear/x, ", ""), {}, "reads 'command/forward', which"),
        (WHOLE, {"kind": "motor"}, "control of left_hip_yaw is a torque"),
        (WHOLE, {"left_out": ("head_roll",)}, "the task does not drive head_roll; use"),
        (
            TASK.replace('"neck_*"', '"*_knee": {lock: 0.8}, "neck_*"'),
            {},
            "the task does not drive left_knee; use the robot's own model",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(text, changes, sentence, tmp_path):
    task = made(tmp_path, text, **changes)
    with pytest.raises(SystemExit, match=sentence) as stopped:
        written(tmp_path, task)
    assert "\n" not in str(stopped.value.code)
    assert not (tmp_path / "microduck-boxes").exists()


def test_another_joint_is_refused_by_its_name(tmp_path):
    (tmp_path / "duck.xml").write_text(duck().replace("head_yaw", "mouth"))
    (tmp_path / "task.yaml").write_text(WHOLE)
    with pytest.raises(SystemExit, match="the task does not drive head_yaw"):
        written(tmp_path, make_task(str(tmp_path / "task.yaml")))
