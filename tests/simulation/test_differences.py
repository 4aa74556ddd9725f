# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Derivatives of steps, against MuJoCo's own differences of full steps."""

import mujoco
import numpy as np
import pytest

from tests.simulation.robots import EVERYTHING, random_states
from vgps_ros.core.records import Trajectory
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import damping_varies

# Whose force has mostly reached its limit.
SERVO = '<position name="hip" joint="hip" kp="90" kv="2" forcerange="-9 9"/>'


def model_with(option="", old="", new=""):
    mjcf = EVERYTHING.replace('integrator="implicitfast"', option or 'integrator="implicitfast"')
    return mujoco.MjModel.from_xml_string(mjcf.replace(old, new))


def centred_differences(model, state, control):
    data, n_dx = mujoco.MjData(model), 2 * model.nv + model.na
    data.qpos, data.qvel, data.act = np.split(state, [model.nq, model.nq + model.nv])
    data.ctrl = control
    a, b = np.empty((n_dx, n_dx)), np.empty((n_dx, model.nu))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, a, b, None, None)
    return np.hstack([a, b])


@pytest.mark.parametrize(
    "changes",
    [
        (),
        ('integrator="Euler"',),
        ("", '<fixed name="both">', '<fixed name="both" damping="2">'),
        ("", '<position name="pull" tendon="both"', '<position name="pull" kv="1" tendon="both"'),
    ],
)
def test_differences_are_those_of_full_steps(changes, rng):
    model = model_with(*changes)
    states, controls = random_states(model, rng, 13), rng.uniform(-1, 1, (12, model.nu))
    linear, _ = Dynamics(model, threads=1).linearize(Trajectory(states, controls), centred=True)
    errors = []
    for t, control in enumerate(controls):
        expected = centred_differences(model, states[t], control)
        found = np.hstack([linear.f_x[t], linear.f_u[t]])
        errors.append(np.abs(found - expected).max() / np.abs(expected).max())
    assert np.quantile(errors, 0.8) < 1e-5


BOX = '<geom type="box" size=".1 .2 .3" mass="1"/>'
FREE = f'<body><freejoint name="j"/>{BOX}'
BALL = f'<body><joint name="j" type="ball" damping=".1"/>{BOX}'
HINGE = f'<body pos="0 0 .4"><joint axis="0 1 0" damping=".1"/>{BOX}</body></body>'


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
@pytest.mark.parametrize(
    "bodies",
    [
        f"{FREE}</body>",
        f'{FREE}<body pos="0 0 .4" euler="10 0 0">{BOX}</body></body>',
        FREE + HINGE,
        f"{BALL}</body>",
        BALL + HINGE,
        f'{BALL}</body><body pos="9 0 0"><freejoint/>{BOX}</body>',
    ],
    ids=["free", "welded", "free base", "ball", "ball and hinge", "beside a free one"],
)
def test_fast_turns_in_long_steps_differentiate_as_full_steps_do(bodies, integrator, rng):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.05" integrator="{integrator}"/>'
        f"<worldbody>{bodies}</worldbody>"
        '<actuator><motor joint="j" gear="1 .2 .3 .1 .2 .3"/></actuator></mujoco>'
    )
    state, control = np.r_[model.qpos0, 3.0 * rng.standard_normal(model.nv)], np.full(1, 0.3)
    dynamics = Dynamics(model, threads=1)
    after = dynamics.step(state, control)
    linear, _ = dynamics.linearize(Trajectory(np.stack([state, after]), control[None]))
    expected = centred_differences(model, state, control)
    np.testing.assert_allclose(np.hstack([linear.f_x[0], linear.f_u[0]]), expected, atol=1e-6)


def test_where_damping_depends_on_velocity_it_is_said_to_vary(swimmer):
    assert damping_varies(swimmer.dynamics.model)
    assert not damping_varies(model_with())
