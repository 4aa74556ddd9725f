"""A simulation as compiled loops see it, and its states x = (qpos, qvel, act)."""

from typing import NamedTuple

import mujoco

from vgps_ros.core.compilation import compiled
from vgps_ros.core.records import Array
from vgps_ros.simulation.model import control_range
from vgps_ros.simulation.mujoco_functions import address, mj_differentiate_pos, mj_integrate_pos


class Simulation(NamedTuple):
    """The arrays of a simulation, for the loops; valid only while its model and data live.

    Attributes:
        model: address of the model.
        data: address of the data, whose arrays the next fields are.
        low: lowest controls.
        high: highest controls; loops clip to both, and record what is left.
        substeps: simulator steps for which one control is held.
        may_skip: whether a step may skip stages: the Runge-Kutta method leaves none valid.
    """

    model: int
    data: int
    qpos: Array
    qvel: Array
    act: Array
    ctrl: Array
    warmstart: Array
    sensordata: Array
    low: Array
    high: Array
    substeps: int
    may_skip: bool


def simulation_of(model: mujoco.MjModel, data: mujoco.MjData, substeps: int) -> Simulation:
    """Returns the arrays of a simulation, for the loops."""
    arrays = (data.qpos, data.qvel, data.act, data.ctrl, data.qacc_warmstart, data.sensordata)
    may_skip = model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4
    limits = control_range(model)
    return Simulation(address(model), address(data), *arrays, *limits, substeps, bool(may_skip))


@compiled
def put_state(sim, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Puts the simulation into the state x with which z begins."""
    n_q, n_v, n_a = len(sim.qpos), len(sim.qvel), len(sim.act)
    sim.qpos[:] = z[:n_q]
    sim.qvel[:] = z[n_q : n_q + n_v]
    sim.act[:] = z[n_q + n_v : n_q + n_v + n_a]


@compiled
def get_state(sim, x):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes the simulation's state."""
    n_q, n_v = len(sim.qpos), len(sim.qvel)
    x[:n_q] = sim.qpos
    x[n_q : n_q + n_v] = sim.qvel
    x[n_q + n_v :] = sim.act


@compiled
def subtract(sim, x, origin, deviation):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes x ⊖ origin."""
    n_q, n_v = len(sim.qpos), len(sim.qvel)
    mj_differentiate_pos(sim.model, deviation.ctypes.data, 1.0, origin.ctypes.data, x.ctypes.data)
    for i in range(n_q, len(x)):
        deviation[i - n_q + n_v] = x[i] - origin[i]


@compiled
def add(sim, x, deviation, size):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Moves x by a deviation times `size`."""
    n_q, n_v = len(sim.qpos), len(sim.qvel)
    mj_integrate_pos(sim.model, x.ctypes.data, deviation.ctypes.data, size)
    for i in range(n_q, len(x)):
        x[i] += size * deviation[i - n_q + n_v]


@compiled
def move(sim, x, direction, j, size):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Moves x along coordinate j of its deviations; `direction`, (n_v,), is zero before and after.

    Coordinates from n_dx on are those of the control, which stands behind x in the same array.
    """
    n_v = len(sim.qvel)
    if j < n_v:
        direction[j] = size
        mj_integrate_pos(sim.model, x.ctypes.data, direction.ctypes.data, 1.0)
        direction[j] = 0.0
    else:
        x[j - n_v + len(sim.qpos)] += size
