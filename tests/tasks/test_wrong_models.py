# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What is said of wrong models and tasks: one sentence each, which names what would be right."""

import re

import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks import make_task

ARM = """<mujoco>{top}<worldbody><geom name="floor" type="plane" size="1 1 1"/>
  <body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" {joint}/>
    <geom name="upper" type="capsule" size=".03" fromto="0 0 0 .4 0 0"/>
    <body name="lower" pos=".4 0 0"><joint name="elbow" axis="0 1 0"/>
      <geom name="lower" type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>{inside}</body></body>
  {beside}</worldbody>
  <actuator><motor name="m_shoulder" joint="shoulder" ctrlrange="-9 9" {motor}/>
    <motor name="m_elbow" joint="elbow" ctrlrange="-9 9" ctrllimited="true"/></actuator>
  <sensor><framepos name="tip" objtype="geom" objname="lower"/></sensor>
  <keyframe><key name="home" qpos=".1 .2"/></keyframe>{bottom}</mujoco>"""
PARTS = dict.fromkeys(("top", "joint", "inside", "beside", "bottom"), "")
PARTS["motor"] = 'ctrllimited="true"'
TASK = """model: arm.xml
control_period: 0.01
horizon: 1.0
cost: [{sensor: shoulder/position}, {control: all, weight: 0.1}]
"""

# What is put into a model, and what is said of it.
MODELS = {
    "no XML": (ARM.replace("</mujoco>", ""), "is no valid MJCF: XML parse error"),
    "unknown element": ({"top": "<robot/>"}, "unrecognized element"),
    "no joint": ("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "has no joint"),
    "no actuator": (ARM.partition("<actuator>")[0] + "</mujoco>", "0 actuators, but it needs"),
    "sleeping": ({"top": '<option><flag sleep="enable"/></option>'}, "lets resting bodies sleep"),
    "no mass": ({"inside": "<body><joint/></body>"}, "mass and inertia of moving bodies"),
    "negative mass": ({"inside": '<geom size=".1" mass="-1"/>'}, "mass"),
    "lost mesh": (
        {
            "top": '<asset><mesh name="m" file="m.obj"/></asset>',
            "inside": '<geom type="mesh" mesh="m"/>',
        },
        r"m\.obj'; `changes: \{drop: \[visual\]\}` or `\{drop: \[meshes\]\}` leaves meshes out",
    ),
    "lost include": ({"top": '<include file="rest.xml"/>'}, "rest.xml"),
    "lost heights": (
        {
            "top": '<asset><hfield name="h" file="h.png" size="1 1 1 1"/></asset>',
            "beside": '<geom type="hfield" hfield="h"/>',
        },
        "h.png",
    ),
    "twice one name": ({"inside": '<geom name="upper" size=".1"/>'}, "repeated name 'upper'"),
    "unknown joint": ({"bottom": '<actuator><motor joint="ankle"/></actuator>'}, "ankle"),
    "unknown material": ({"inside": '<geom size=".1" material="steel"/>'}, "steel"),
    "range upside down": ({"joint": 'limited="true" range="1 -1"'}, "range"),
    "control range upside down": (
        ARM.replace('"-9 9" {motor}', '"9 -9" ctrllimited="true"'),
        "range",
    ),
    "huge texture": (
        {
            "top": '<asset><texture type="2d" builtin="flat" name="t" width="26000" '
            'height="26000"/></asset>'
        },
        "does not compile|no valid MJCF",
    ),
    "plugin": ({"inside": '<geom type="sdf" size=".1"><plugin instance="p"/></geom>'}, "p"),
    "bad number": ({"inside": '<geom size="wide"/>'}, "size"),
    "step": ({"top": '<option timestep="-0.01"/>'}, "timestep|time step"),
    "two roots": (
        {"bottom": "<worldbody><body><freejoint/><joint/><geom size='1'/></body></worldbody>"},
        "more than 6 dofs",
    ),
    "cyclic exclude": (
        {"bottom": '<contact><exclude body1="upper" body2="hand"/></contact>'},
        "hand",
    ),
    "unknown class": ({"inside": '<geom class="visual" size=".1"/>'}, "visual"),
    "short keyframe": (
        {"bottom": '<keyframe><key name="bent" qpos=".1"/></keyframe>'},
        r"keyframe 'bent' has 1 positions \(qpos\), but the model has 2",
    ),
    "sensor of nothing": ({"bottom": '<sensor><jointpos joint="wrist"/></sensor>'}, "wrist"),
}

# Lines of a task, and what is said of them.
TASKS = {
    "changes: {joints: {shuolder: {damping: 1.0}}}": "Did you mean 'shoulder'",
    "changes: {joints: {shoulder: {dampping: 1.0}}}": "Did you mean 'damping'",
    "changes: {joints: {elbow: {lock: far}}}": "changes.joints.elbow.lock",
    "changes: {joints: {wrst: {lock: 0.0}}}": "'wrst' matches no hinge",
    "changes: {joints: {'*': {lock: 0.0}}}": "has no joint",
    "changes: {remove_bodies: [loer]}": "Did you mean 'lower'",
    "changes: {remove_bodies: [upper]}": "has no joint|framepos|tip",
    "changes: {free_bodies: [loer]}": "Did you mean 'lower'",
    "changes: {remove_actuators: [m_elbw]}": "Did you mean 'm_elbow'",
    "changes: {remove_actuators: ['*']}": "0 actuators",
    "changes: {bodies: {lowr: {mass: 1.0}}}": "Did you mean 'lower'",
    "changes: {bodies: {lower: {mass: 0.0}}}": "changes.bodies.lower.mass",
    "changes: {bodies: {lower: {weight: 1.0}}}": "weight",
    "changes: {drop: [pictures]}": "changes.drop",
    "changes: {drop: [mesh]}": "changes.drop",
    "changes: {geoms: {flor: {condim: 3}}}": "Did you mean 'floor'",
    "changes: {geoms: {floor: {condim: 2}}}": "changes.geoms.floor.condim",
    "changes: {option: {solver: newton}}": "changes.option.solver",
    "changes: {option: {timestep: 0.003}}": "must be a multiple of the simulator's time step",
    "changes: {floor: true}": "has a geom of this name already",
    "changes: {only_contacts: [[floor, hand]]}": "'hand' matches no geom",
    "changes: {actuators: {m: {joint: elbw, limit: 1.0}}}": "Did you mean 'elbow'",
    "changes: {actuators: {m: {joint: [elbow, wrist], limit: 1.0}}}": "'wrist' matches no joint",
    "changes: {actuators: {m_elbow: {joint: elbow, limit: 1.0}}}": "remove it by remove_actuators",
    "changes: {actuators: {m: {joint: elbow, limit: -1.0}}}": "changes.actuators.m.limit",
    "changes: {actuators: {m: {joint: elbow, damping: 1.0}}}": "name the stiffness of a servo",
    "changes: {actuators: {m: {joint: elbow, stifness: 1.0}}}": "Did you mean 'stiffness'",
    "start: {keyframe: hone}": "Did you mean 'home'",
    "start: {positions: {elbw: 0.1}}": "Did you mean 'elbow'",
    "start: {positions: {elbow: [0.1, 0.2]}}": "has 1 numbers, but 2 are given",
    "sensors: {tip: {type: framepos, geom: lower}}": "has a sensor of this name",
    "sensors: {h: {type: framepose, geom: lower}}": "sensors.h.type",
    "sensors: {h: {type: framepos, geom: lowr}}": "Did you mean 'lower'",
    "sensors: {h: {type: framepos}}": "sensors.h",
    "fallen: [{sensor: tipp, index: z, below: 0.1}]": "tipp",
    "fallen: [{sensor: tip, below: 0.1}]": "pick one by its index",
    "fallen: [{sensor: tip, index: z, below: 2.0}]": "excludes its start",
    "observe: [joint_position]": "joint_position",
    "observe: [tip/w]": "tip",
    "begin: {law: noise}": "std",
    "begin: {law: hold}": "begin",
    "begin: {law: pd, pose: hme}": "Did you mean 'home'",
    "begin: {law: noise, std: [1.0, 1.0, 1.0]}": "it has 3 values, but the model has 2 actuators",
    "commands: {forward: {range: [0.0, 1.0]}}": "no cost reads it",
    "clock: {frequency: 0.0}": "clock.frequency",
    "optimizer: {ddp.floor: 0.1}": "optimizer",
    "search: {situation: 3}": "line 5, search.situation: .* Did you mean 'situations'",
    "search: {fit: {iteration: 3}}": "Did you mean 'fit.iterations'",
    "horizn: 2.0": "Did you mean 'horizon'",
}


@pytest.fixture
def said(tmp_path):
    """Returns a function that returns what is said of a model and lines of a task."""

    def say(model, lines=""):
        text = model if isinstance(model, str) else ARM.format(**PARTS | model)
        (tmp_path / "arm.xml").write_text(text.format(**PARTS) if "{top}" in text else text)
        (tmp_path / "task.yaml").write_text(f"{TASK}{lines}\n")
        with pytest.raises(InvalidInputError) as error:
            make_task(str(tmp_path))
        return str(error.value)

    return say


@pytest.mark.parametrize("name", MODELS)
def test_a_wrong_model_is_told_in_one_sentence(said, name):
    model, words = MODELS[name]
    sentence = said(model)
    assert re.search(words, sentence), sentence
    assert "Traceback" not in sentence


@pytest.mark.parametrize("lines", TASKS)
def test_a_wrong_line_of_a_task_is_told_with_its_place(said, lines):
    sentence = said({}, lines)
    assert re.search(TASKS[lines], sentence), sentence
    assert sentence.endswith((".", "?"))
