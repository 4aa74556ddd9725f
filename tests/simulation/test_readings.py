# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.simulation.robots import EVERYTHING, everything, random_states
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.simulation.dynamics import Simulations
from vgps_ros.simulation.model import sensor_numbers
from vgps_ros.simulation.readings import Readings

MODEL = everything()
SIMULATIONS = Simulations(MODEL, threads=2)
NUMBERS = sensor_numbers(MODEL)
KINEMATIC = [
    n for n in NUMBERS if n.split("/")[0] not in ("length", "acceleration", "load", "effort")
]


@pytest.fixture
def states(rng):
    return random_states(MODEL, rng, 20)


@pytest.fixture
def controls(rng):
    return rng.uniform(-1, 1, (20, MODEL.nu))


def simulators(states, controls, centred=True):
    """The simulator's own sensordata, C and D at each point."""
    data, n_dx = mujoco.MjData(MODEL), SIMULATIONS.space.tangent_dim
    for x, u in zip(states, controls, strict=True):
        data.qpos, data.qvel, data.act = np.split(x, [MODEL.nq, MODEL.nq + MODEL.nv])
        data.ctrl, data.qacc_warmstart = u, 0.0
        mujoco.mj_forward(MODEL, data)
        values = data.sensordata.copy()
        c = np.zeros((MODEL.nsensordata, n_dx))
        d = np.zeros((MODEL.nsensordata, MODEL.nu))
        mujoco.mjd_transitionFD(MODEL, data, 1e-6, centred, None, None, c, d)
        yield values, c, d


@pytest.mark.parametrize("names", [KINEMATIC, list(NUMBERS)])
def test_values_and_derivatives_are_the_simulators(names, states, controls):
    readings = Readings(SIMULATIONS, names)
    found, by_state, by_control = readings.linearize(states, controls)
    assert_array_equal(found, readings(states, controls))
    places = [NUMBERS[name][1] for name in names]
    errors = []
    for i, (values, c, d) in enumerate(simulators(states, controls)):
        assert_allclose(found[i], values[places], rtol=0, atol=1e-9)
        wanted = np.hstack([c, d])[places]
        error = np.abs(np.hstack([by_state[i], by_control[i]]) - wanted).max(axis=1)
        errors.append(error / np.maximum(np.abs(wanted).max(axis=1), 1.0))
    assert np.quantile(errors, 0.9, axis=0).max() < 1e-6 if names is KINEMATIC else 1e-4
    assert readings.needs_controls == (names is not KINEMATIC)


def test_a_direction_in_a_bodys_frame_turns_as_a_closed_form_says(states):
    """For R' = R exp(δ), the world's z axis in the body's frame, Rᵀ e_z, moves by (Rᵀ e_z) × δ."""
    frames = 'objtype="xbody" objname="world" reftype="xbody" refname="base"'
    xml = f'<framezaxis name="gravity" {frames}/>'
    model = mujoco.MjModel.from_xml_string(EVERYTHING.replace("<sensor>", f"<sensor>{xml}"))
    readings = Readings(Simulations(model), ["gravity/x", "gravity/y", "gravity/z"])
    up, by_state, _ = readings.linearize(states)
    expected = np.zeros_like(by_state)
    for i in range(3):
        expected[..., 3 + i] = np.cross(up, np.eye(3)[i])
    assert_allclose(by_state, expected, rtol=0, atol=1e-6)
    assert_allclose(np.linalg.norm(up, axis=1), 1.0, rtol=1e-12)


def test_coordinates_sines_and_cosines_are_those_of_the_state(states):
    readings = Readings(SIMULATIONS, ["knee/velocity", "hip/sin", "hip/cos", "base/z", "base/wz"])
    found, by_state, _ = readings.linearize(states)
    hip, n_q, n_v = states[:, 7], MODEL.nq, MODEL.nv
    expected = [states[:, n_q + 7], np.sin(hip), np.cos(hip), states[:, 2], states[:, n_q + 5]]
    assert_allclose(found, np.transpose(expected), rtol=1e-15)
    slopes = np.zeros_like(by_state)
    slopes[:, 0, n_v + 7] = slopes[:, 3, 2] = slopes[:, 4, n_v + 5] = 1.0
    slopes[:, 1, 6], slopes[:, 2, 6] = np.cos(hip), -np.sin(hip)
    assert_allclose(by_state, slopes, rtol=1e-15)


def test_quaternions_turn_as_finite_differences_say(states):
    readings = Readings(
        SIMULATIONS, [f"{joint}/q{i}" for joint in ("base", "tail") for i in "wxyz"]
    )
    found, by_state, _ = readings.linearize(states)
    assert_array_equal(found[:, :4], states[:, 3:7])
    for j, direction in enumerate(np.eye(SIMULATIONS.space.tangent_dim)):
        there, back = (SIMULATIONS.space.add(states, s * 1e-6 * direction) for s in (1, -1))
        slopes = (readings(there) - readings(back)) / 2e-6
        assert_allclose(by_state[..., j], slopes, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    "names", [["hip/position", "hip/velocity"], ["hip/sin", "gyro/x", "hip/velocity"]]
)
def test_a_derivative_is_pulled_back_to_the_states_deviations(names, states, rng):
    readings = Readings(SIMULATIONS, names)
    jacobians = rng.standard_normal((20, 4, len(names)))
    expected = jacobians @ readings.linearize(states)[1]
    assert_allclose(readings.pull_back(jacobians, states), expected, rtol=1e-12, atol=1e-12)


def test_number_of_threads_does_not_change_a_bit(states, controls):
    alone = Readings(Simulations(MODEL, threads=1), list(NUMBERS)).linearize(states, controls)
    for threads in (2, 3):
        shared = Readings(Simulations(MODEL, threads=threads), list(NUMBERS))
        for one, other in zip(alone, shared.linearize(states, controls), strict=True):
            assert_array_equal(one, other)


def test_a_state_that_diverged_reads_nan(states):
    states[3, 2] = np.nan
    found = Readings(SIMULATIONS, ["velocity/x", "load"])(states)
    assert np.isnan(found[3]).all()
    assert np.isfinite(np.delete(found, 3, axis=0)).all()


def test_an_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(InvalidInputError, match=r"'hipp/velocity'.* Did you mean 'hip/velocity'\?"):
        Readings(SIMULATIONS, ["hipp/velocity"])
    with pytest.raises(InvalidInputError, match="'tail/qq'"):
        Readings(SIMULATIONS, ["tail/qq"])
