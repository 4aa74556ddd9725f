# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Names of what states, deviations and controls hold."""

import mujoco
import numpy as np
import pytest

from tests.simulation.robots import everything
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import (
    actuated_joint_names,
    check_supported,
    compile_model,
    deviation_names,
    hinge_names,
    joint_names,
    sensor_numbers,
    state_names,
)

MODEL = everything()
HINGES = ["hip", "knee"]


def test_each_coordinate_of_a_state_has_a_name():
    names = state_names(MODEL)
    assert len(names) == len(set(names)) == MODEL.nq + MODEL.nv + MODEL.na
    assert names[:7] == [f"base/{c}" for c in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    assert names[7:9] == ["hip/position", "knee/position"]
    assert names[9:13] == [f"tail/{c}" for c in ("qw", "qx", "qy", "qz")]
    velocities = names[MODEL.nq : MODEL.nq + MODEL.nv]
    assert velocities[:6] == [f"base/{c}" for c in ("vx", "vy", "vz", "wx", "wy", "wz")]
    assert velocities[6:] == ["hip/velocity", "knee/velocity", "tail/wx", "tail/wy", "tail/wz"]
    assert names[-1] == "slow_knee/activation"


def test_a_deviation_has_three_coordinates_of_each_rotation():
    names = deviation_names(MODEL)
    assert len(names) == len(set(names)) == 2 * MODEL.nv + MODEL.na
    assert names[:6] == [f"base/{c}" for c in ("x", "y", "z", "rx", "ry", "rz")]
    assert names[8:11] == ["tail/rx", "tail/ry", "tail/rz"]
    assert names[MODEL.nv :] == state_names(MODEL)[MODEL.nq :]


def test_joints_of_one_axis_are_listed_and_no_others():
    assert joint_names(MODEL) == hinge_names(MODEL) == HINGES


def test_each_number_of_a_sensor_has_a_name():
    numbers = sensor_numbers(MODEL)
    assert len(numbers) == MODEL.nsensordata
    assert sorted(place for _, place in numbers.values()) == list(range(MODEL.nsensordata))
    assert [n for n in numbers if n.startswith("attitude")] == [f"attitude/{c}" for c in "wxyz"]
    for name, (sensor, place) in numbers.items():
        assert MODEL.sensor(sensor).name == name.split("/")[0]
        assert MODEL.sensor_adr[sensor] <= place


def test_a_control_has_the_velocity_of_its_joint_where_it_drives_one_of_one_axis():
    """What pulls a tendon bears its actuator's name, and no other one does."""
    assert actuated_joint_names(MODEL) == ["hip", "knee", "pull", "tail"]
    controls, names = controls_of(MODEL), state_names(MODEL)
    driven = np.zeros((4, len(names)))
    for i, joint, share in ((0, "hip", 1.0), (1, "knee", 1.0), (2, "hip", 1.0), (2, "knee", -0.5)):
        driven[i, names.index(f"{joint}/velocity")] = share
    np.testing.assert_array_equal(controls.velocities, driven)


def test_two_actuators_of_one_joint_and_one_that_is_called_as_a_joint_have_names_of_their_own():
    def names(*actuators):
        joints = "".join(f"<body><joint name='{j}'/><geom size='1'/></body>" for j in "abc")
        inside = "".join(f"<general name='{n}' joint='{j}'/>" for n, j in actuators)
        text = f"<mujoco><worldbody>{joints}</worldbody><actuator>{inside}</actuator></mujoco>"
        return actuated_joint_names(mujoco.MjModel.from_xml_string(text))

    assert names("xa", "yb", "za") == ["x", "b", "z"]
    assert names("xa", "yb", "ca") == ["x", "y", "c"]  # c is a joint that it does not drive


def test_what_remembers_more_than_its_state_or_drives_nothing_is_refused():
    body = "<body><joint name='a'/><geom size='1'/></body>"
    nothing = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    with pytest.raises(InvalidInputError, match="1 degrees of freedom and 0 actuators"):
        check_supported(nothing)
    delayed = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{body}</worldbody>"
        '<actuator><motor joint="a" delay="0.02" nsample="3"/></actuator></mujoco>'
    )
    assert delayed.nhistory
    with pytest.raises(InvalidInputError, match="delayed values"):
        check_supported(delayed)


@pytest.mark.parametrize(
    ("joint", "motor", "sentence"),
    [
        ("", 'ctrlrange="5 -5"', "actuator 'm' has ctrlrange from 5 to -5"),
        ("", 'forcerange="3 1"', "actuator 'm' has forcerange from 3 to 1"),
        ('range="1 -1"', "", "joint 'a' has range from "),
        ('actuatorfrcrange="2 -2"', "", "joint 'a' has actfrcrange from 2 to -2"),
    ],
)
def test_a_range_whose_ends_are_exchanged_is_refused_and_not_ignored(joint, motor, sentence):
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body><joint name='a' {joint}/><geom size='1'/></body></worldbody>"
        f"<actuator><motor name='m' joint='a' {motor}/></actuator></mujoco>"
    )
    with pytest.raises(InvalidInputError, match=sentence):
        check_supported(model)


HINGE = """<worldbody><body><joint name="a"/><geom size="1"/></body></worldbody>
<actuator><motor joint="a"/></actuator>"""


def sky(size: int) -> str:
    texture = f'<texture type="skybox" builtin="gradient" width="{size}" height="{size}"/>'
    return f"<mujoco><asset>{texture}</asset>{HINGE}</mujoco>"


def test_a_square_sky_of_800_pixels_is_accepted_also_as_mujoco_writes_it_and_a_huge_one_is_not():
    spec = mujoco.MjSpec.from_string(sky(800))
    spec.compile()
    assert compile_model(spec.to_xml()).nu == compile_model(sky(800)).nu == 1
    text = sky(800).replace('width="800" height="800"', 'width="20000" height="1"')
    with pytest.raises(InvalidInputError, match="does not compile"):
        compile_model(text)


def test_a_model_whose_bodies_may_sleep_is_refused():
    option = '<option><flag sleep="enable"/></option>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{option}{HINGE}</mujoco>")
    with pytest.raises(InvalidInputError, match="lets resting bodies sleep"):
        check_supported(model)
