# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Changes of a model: made in memory, and refused with the nearest name."""

from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.checks import matching_names
from vgps_ros.core.errors import InvalidEntryError, InvalidInputError
from vgps_ros.robot.controls import ControlKind
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import scalar_names
from vgps_ros.simulation.model_changes import changed_spec
from vgps_ros.simulation.sensor_types import SENSOR_TYPES

TURTLE = """
<mujoco>
  <compiler angle="degree"/>
  <default><motor ctrllimited="true" ctrlrange="-1 1" gear="7"/><geom condim="4"/></default>
  <worldbody>
    <camera name="above" pos="0 0 3"/>
    <geom name="floor" type="plane" size="0 0 1" friction="0.8 0.02 0.003"/>
    <geom name="wall" type="box" size="0.1 1 1" pos="3 0 0"/>
    <body name="trunk" pos="0 0 0.3">
      <freejoint/>
      <geom type="box" size="0.3 0.2 0.1" euler="0 20 0"/>
      <site name="imu"/>
      <body name="left" pos="0 0.2 0">
        <joint name="left_hip" axis="0 1 0" range="-30 30"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.03"/>
        <geom name="left_foot" size="0.05" pos="0 0 -0.2"/>
      </body>
      <body name="right" pos="0 -0.2 0">
        <joint name="right_hip" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.03"/>
        <body pos="0 0 -0.2"><geom name="right_foot" size="0.05"/></body>
      </body>
      <body name="tail" pos="-0.3 0 0"><joint type="ball"/><geom name="tail" size="0.05"/></body>
    </body>
  </worldbody>
  <contact><pair geom1="left_foot" geom2="right_foot"/></contact>
  <tendon>
    <fixed name="both" limited="true" range="-1 1"><joint joint="left_hip" coef="1"/></fixed>
  </tendon>
  <actuator><motor joint="left_hip"/><position name="servo" joint="right_hip"/></actuator>
  <sensor><actuatorfrc name="effort" actuator="servo"/></sensor>
  <keyframe><key name="stand" qpos="0 0 .3 1 0 0 0 0 0 1 0 0 0" ctrl="1 2"/></keyframe>
</mujoco>
"""
CHEETAH = "envs/mujoco/assets/half_cheetah.xml"


@pytest.fixture
def turtle(tmp_path):
    path = tmp_path / "turtle.xml"
    path.write_text(TURTLE)
    return path


@pytest.fixture
def compiled(turtle):
    return lambda sensors=None, **changes: changed_spec(turtle, changes, sensors or {}).compile()


def names(model, kind, count):
    return [getattr(model, kind)(i).name for i in range(count)]


def test_without_changes_the_model_is_the_file_s(turtle, compiled):
    plain, found = mujoco.MjModel.from_xml_path(str(turtle)), compiled()
    for field in ("qpos0", "body_mass", "geom_friction", "actuator_gear", "opt"):
        assert_allclose(getattr(found, field), getattr(plain, field)) if field != "opt" else None
    assert turtle.read_text() == TURTLE


def test_what_has_no_name_gets_one(compiled):
    model = compiled()
    assert names(model, "body", model.nbody) == [
        *("world", "trunk", "left", "right", "right_body", "tail")
    ]
    assert names(model, "joint", model.njnt) == ["trunk_free", "left_hip", "right_hip", "tail_ball"]
    assert names(model, "geom", 4) == ["floor", "wall", "trunk_geom", "left_geom"]
    assert names(model, "actuator", model.nu) == ["left_hip", "servo"]


def test_options_are_set(compiled):
    model = compiled(
        option={
            "timestep": 0.004,
            "integrator": "implicitfast",
            "cone": "elliptic",
            "iterations": 7,
            "gravity": [0, 0, -1.6],
        }
    )
    option = model.opt
    assert (option.timestep, option.iterations) == (0.004, 7)
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert_allclose(option.gravity, [0, 0, -1.6])


def test_later_patterns_win_and_angles_are_radians(compiled):
    model = compiled(
        joints={
            "*_hip": {"damping": 1.0, "armature": 0.02},
            "left_hip": {"damping": 2.0, "range": [-0.5, 1.0]},
            "right_hip": {"actfrcrange": [-5, 5]},
        }
    )
    left, right = model.joint("left_hip"), model.joint("right_hip")
    assert (left.damping[0], right.damping[0]) == (2.0, 1.0)
    assert_allclose(left.range, [-0.5, 1.0])
    assert left.limited[0]
    assert_allclose(model.jnt_actfrcrange[right.id], [-5, 5])
    assert_allclose(model.dof_armature[-5:-3], 0.02)


def test_a_list_shorter_than_a_field_leaves_the_rest(compiled):
    model = compiled(geoms={"floor": {"friction": 0.5, "solref": [0.04, 1], "solimp": [0, 0.95]}})
    assert_allclose(model.geom("floor").friction, [0.5, 0.02, 0.003])
    assert_allclose(model.geom("floor").solimp, [0, 0.95, 0.001, 0.5, 2])
    assert_allclose(model.geom("floor").solref, [0.04, 1])


def contacts(model):
    """Returns the names of geoms that touch where the turtle lies deep in the floor."""
    data = mujoco.MjData(model)
    data.qpos[2] = 0.1
    mujoco.mj_forward(model, data)
    return {frozenset(model.geom(geom).name for geom in contact.geom) for contact in data.contact}


FEET = {frozenset(("floor", "left_foot")), frozenset(("floor", "right_foot"))}


def test_only_the_chosen_contacts_are_left(compiled):
    assert len(contacts(compiled())) > len(FEET)
    assert contacts(compiled(only_contacts=[["floor", "*_foot"]])) == FEET
    assert contacts(compiled(only_contacts=[["*_foot", "floor"], ["tail", "wall"]])) == FEET
    assert contacts(compiled(only_contacts=[])) == set()


def test_contacts_that_are_left_keep_the_softness_and_friction_of_their_geoms(compiled):
    model = compiled(
        geoms={"*foot": {"friction": 1.5, "solref": [0.04, 1]}, "floor": {"solref": [0.04, 1]}},
        only_contacts=[["floor", "*_foot"]],
    )
    data = mujoco.MjData(model)
    data.qpos[2] = 0.1
    mujoco.mj_forward(model, data)
    assert {contact.dim for contact in data.contact} == {4}
    assert_allclose(data.contact.solref, [[0.04, 1]] * data.ncon)
    assert_allclose(data.contact.friction[:, 0], 1.5)


def test_explicit_pairs_stay_where_they_are_wanted(compiled):
    assert compiled(only_contacts=[["floor", "*_foot"]]).npair == 0
    assert compiled(only_contacts=[["*_foot", "*_foot"]]).npair == 1


def test_motors_replace_actuators_and_keyframes_still_compile(compiled):
    model = compiled(remove_actuators=["*"], actuators={"hips": {"joint": "*", "limit": 24.0}})
    assert names(model, "actuator", model.nu) == ["left_hip", "right_hip"]
    assert_allclose(model.actuator_ctrlrange, [[-24, 24]] * 2)
    assert_allclose(model.actuator_gear[:, 0], 1)
    assert_allclose(model.key("stand").ctrl, 0)
    assert model.nsensor == 0  # that of a removed actuator


def test_added_motors_leave_the_activations_of_keyframes(turtle):
    stateful = '<general name="lag" joint="right_hip" dyntype="filter" dynprm="0.1"/></actuator>'
    text = TURTLE.replace("</actuator>", stateful).replace('ctrl="1 2"', 'ctrl="1 2 3" act="0.7"')
    turtle.write_text(text)
    motors = {"actuators": {"third": {"joint": "left_hip"}}}
    model = changed_spec(turtle, motors, {}).compile()
    assert_allclose(model.key("stand").act, 0.7)
    model = changed_spec(turtle, {**motors, "remove_actuators": ["lag"]}, {}).compile()
    assert (model.na, model.nu) == (0, 3)


def test_a_motor_without_a_limit_has_none_whatever_the_model_s_defaults_are(compiled):
    model = compiled(actuators={"third": {"joint": "left_hip"}})
    third = model.actuator("third")
    assert (third.ctrllimited[0], third.gear[0], model.nu) == (0, 1.0, 3)
    assert_allclose(model.key("stand").ctrl, 0)


def inertia_of(model):
    data, inertia = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    return inertia


def test_servos_are_added_as_mujoco_has_them(compiled):
    servo = {"joint": "*", "stiffness": 30.0, "damping": 0.5, "limit": 24.0}
    model = compiled(remove_actuators=["*"], actuators={"hips": servo})
    geared = compiled(remove_actuators=["*"], actuators={"hips": servo | {"armature": 0.02}})
    driven = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    more = np.diag(inertia_of(geared) - inertia_of(model))
    assert_allclose(more[driven], 0.02)
    assert_allclose(np.delete(more, driven), 0.0, atol=1e-12)
    controls = controls_of(model)
    assert controls.kinds == (ControlKind.POSITION,) * 2
    assert_allclose([controls.stiffness, controls.damping], [[30.0] * 2, [0.5] * 2])
    assert_allclose(controls.servo_forces, 24.0)
    # Targets stay within the joint's range, where it has one, in rad.
    assert model.actuator_ctrllimited.tolist() == [1, 0]
    assert_allclose(model.actuator_ctrlrange[0], np.radians([-30, 30]))


@pytest.mark.parametrize("kind", SENSOR_TYPES)
def test_every_type_of_sensor_has_the_parts_that_its_names_tell(turtle, kind):
    objects = {
        "body": "trunk",
        "xbody": "trunk",
        "geom": "tail",
        "site": "imu",
        "joint": "tail_ball" if "ball" in kind else "left_hip",
        "tendon": "both",
        "actuator": "servo",
    }
    declared = SENSOR_TYPES[kind]
    for name in declared.objects or ("",):
        sensor = {"type": kind, **({name: objects[name]} if name else {})}
        if name == "body" and kind in ("framequat", "framexaxis", "frameyaxis", "framezaxis"):
            continue
        if declared.relative_to:
            sensor |= {"relative_to": {"geom": "floor"}}
        if declared.mujoco_name.startswith("geom"):
            sensor |= {"cutoff": 5.0}
        spec = changed_spec(
            turtle, {"joints": {"left_hip": {"range": [-0.5, 0.5]}}}, {"new": sensor}
        )
        assert spec.compile().sensor("new").dim[0] == len(scalar_names("new", declared.parts))


def test_a_sensor_reads_what_it_says(compiled):
    model = compiled(
        {
            "up": {"type": "framezaxis", "body": "world", "relative_to": {"xbody": "trunk"}},
            "height": {"type": "framepos", "site": "imu"},
        }
    )
    data = mujoco.MjData(model)
    data.qpos[3:7] = [np.cos(0.2), 0, np.sin(0.2), 0]
    mujoco.mj_forward(model, data)
    assert_allclose(data.sensor("up").data, [-np.sin(0.4), 0, np.cos(0.4)], atol=1e-12)
    assert_allclose(data.sensor("height").data, [0, 0, 0.3], atol=1e-12)


def test_what_mujoco_measures_at_sites_can_be_measured_at_a_bodys_frame(compiled, rng):
    model = compiled(
        {
            "velocity": {"type": "velocimeter", "xbody": "trunk"},
            "turning": {"type": "gyro", "xbody": "trunk"},
        }
    )
    data = mujoco.MjData(model)
    data.qpos[3:7] = rng.standard_normal(4)
    mujoco.mj_normalizeQuat(model, data.qpos)
    data.qvel[:6] = rng.standard_normal(6)
    mujoco.mj_forward(model, data)
    rotation = data.body("trunk").xmat.reshape(3, 3)
    assert_allclose(data.sensor("velocity").data, rotation.T @ data.qvel[:3], atol=1e-12)
    assert_allclose(data.sensor("turning").data, data.qvel[3:6], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "sensors", "sentence"),
    [
        (
            {"joints": {"left_hp": {}}},
            {},
            r"joints.left_hp: 'left_hp' matches no joint; .*'left_hip'",
        ),
        (
            {"geoms": {"*paw": {}}},
            {},
            r"geoms.\*paw: '\*paw' matches no geom; there are floor, wall",
        ),
        ({"remove_actuators": ["srvo"]}, {}, r"remove_actuators.0: .* Did you mean 'servo'"),
        ({"only_contacts": [["flor", "*"]]}, {}, r"only_contacts.0.0: .* Did you mean 'floor'"),
        ({"actuators": {"a": {"joint": "trunk_free"}}}, {}, "is neither a hinge nor a slide"),
        ({"actuators": {"a": {"joint": "left_hip", "damping": 1}}}, {}, "a motor has none; name"),
        ({"actuators": {"servo": {"joint": "left_hip"}}}, {}, "has an actuator 'servo'; remove it"),
        ({"geoms": {"*": {"friction": [1, 1, 1, 1]}}}, {}, "it has 4 values, but at most 3"),
        ({}, {"s": {"type": "gyro", "site": "ium"}}, r"sensors.s.site: .* Did you mean 'imu'"),
        ({}, {"effort": {"type": "clock"}}, "the model has a sensor of this name"),
        ({}, {"s": {"type": "framezaxis", "body": "trunk"}}, "write `xbody: trunk`"),
        (
            {},
            {"s": {"type": "jointpos", "joint": "tail_ball"}},
            "model: the model, as it is changed, does not compile",
        ),
    ],
)
def test_a_change_that_does_not_suit_the_model_is_named(turtle, changes, sensors, sentence):
    with pytest.raises(InvalidEntryError, match=sentence):
        changed_spec(turtle, changes, sensors)


def test_a_model_that_is_no_mjcf_is_named(tmp_path):
    for i, data in enumerate((b"", b"<mujoco><worldbody>", b"\xff\x00", b"<mujoco><a/></mujoco>")):
        path = tmp_path / f"{i}.xml"
        path.write_bytes(data)
        with pytest.raises(InvalidEntryError, match="model: the model is no valid MJCF"):
            changed_spec(path, {}, {})


@pytest.mark.skipif(find_spec("gymnasium") is None, reason="Gymnasium's models are not installed")
def test_gymnasium_s_half_cheetah_is_changed_without_editing_it():
    path = Path(find_spec("gymnasium").submodule_search_locations[0]) / CHEETAH
    before = path.read_bytes()
    model = changed_spec(
        path,
        {
            "option": {"timestep": 0.005, "integrator": "implicitfast"},
            "geoms": {"*": {"solref": [0.04, 1], "solimp": [0, 0.95, 0.02, 0.5, 2]}},
            "only_contacts": [["floor", "*foot"]],
        },
        {"velocity": {"type": "subtreelinvel", "body": "torso"}},
    ).compile()
    assert path.read_bytes() == before
    assert (model.npair, model.nu, model.opt.timestep) == (0, 6, 0.005)
    assert model.sensor("velocity").dim[0] == 3
    assert_allclose(model.actuator_ctrlrange, [[-1, 1]] * 6)


def test_patterns_find_names_in_their_order():
    assert matching_names("joint", "*_hip", ["b_hip", "knee", "a_hip"]) == ["b_hip", "a_hip"]
    assert matching_names("joint", "hip[1]", ["hip1", "hip[1]"]) == ["hip[1]"]
    assert matching_names("joint", "*", []) == []
    with pytest.raises(
        InvalidInputError, match=r"'kne' matches no joint; there are hip, knee. Did"
    ):
        matching_names("joint", "kne", ["hip", "knee"])


def test_an_index_picks_parts_by_name_or_number():
    assert scalar_names("v", tuple("xyz")) == ["v/x", "v/y", "v/z"]
    assert scalar_names("v", tuple("xyz"), ["z", 0]) == ["v/z", "v/x"]
    assert scalar_names("touch", ()) == ["touch"]
    with pytest.raises(InvalidInputError, match="is one number"):
        scalar_names("touch", (), "x")
