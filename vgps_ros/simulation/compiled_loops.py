# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Rollouts in compiled loops, which call MuJoCo's C functions without Python."""

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.compilation import compile_at_first_call, compiled_part
from vgps_ros.core.policy import ACTIVATIONS, GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.robot.executed_control import (
    ARTANH,
    EXP,
    INVERSE_LOG_2,
    LOG_2_HIGH,
    LOG_2_LOW,
    SMALLEST_EXPONENT,
)
from vgps_ros.robot.unrest import RATE, TILT
from vgps_ros.simulation.compiled_readings import read
from vgps_ros.simulation.compiled_states import (
    NEVER,
    add,
    copy,
    get_state,
    is_within,
    push_at,
    put_state,
    subtract,
)
from vgps_ros.simulation.mujoco_functions import mj_step_skip

# No stage of a step is skipped.
_NOTHING = np.int32(mujoco.mjtStage.mjSTAGE_NONE)


@compile_at_first_call
def advance(sim, bounds, times, states, controls, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Does a control step of N rollouts, each at a time; `bounds` are those of states and controls.

    Clips the controls to their limits. Writes f(x, u) to `after`, but NaN where x, u or f(x, u) is
    out of bounds, and NaN to controls where x is. Returns how many controls were executed, and how
    many rollouts are within bounds.
    """
    executed = inside = 0
    for i in range(len(states)):
        x = after[i]
        copy(states[i], x)
        is_inside = is_within(x, bounds[0])
        for j in range(len(sim.ctrl)):
            controls[i, j] = sim.ctrl[j] = _clip(sim, j, controls[i, j])
        if not is_inside:
            controls[i] = np.nan
        elif is_within(controls[i], bounds[1]):
            executed += 1
            is_inside = _advance(sim, times[i], x, bounds[0])
        else:
            is_inside = False
        if is_inside:
            inside += 1
        else:
            x[:] = np.nan
    return executed, inside


@compile_at_first_call
def follow(  # type: ignore[no-untyped-def]  # pragma: no cover
    sim, bounds, nominal_states, nominal_controls, gains, gaps, states, controls
):
    """Writes the rollout of u = ū + K (x ⊖ x̄) from states[0], up to where it leaves its bounds.

    Where `gaps` has rows, one a step, each state stays short of f(x, u) by its row.
    """
    x, deviation = states[0].copy(), np.empty(gains.shape[2])
    if not is_within(x, bounds[0]):
        return
    for t in range(len(controls)):
        subtract(sim, x, nominal_states[t], deviation)
        for i in range(len(sim.ctrl)):
            sim.ctrl[i] = nominal_controls[t, i]
            for j in range(len(deviation)):
                sim.ctrl[i] += gains[t, i, j] * deviation[j]
            sim.ctrl[i] = _clip(sim, i, sim.ctrl[i])
        copy(sim.ctrl, controls[t])
        if not (is_within(sim.ctrl, bounds[1]) and _advance(sim, t, x, bounds[0])):
            return
        if len(gaps):
            add(sim, x, gaps[t], -1.0)
        copy(x, states[t + 1])


@compile_at_first_call
def replay(sim, bounds, controls, states):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes rollouts of given controls from states[:, 0], up to where they leave their bounds."""
    for rollout in range(len(states)):
        x = states[rollout, 0].copy()
        if not is_within(x, bounds[0]):
            continue
        for t in range(controls.shape[1]):
            copy(controls[rollout, t], sim.ctrl)
            if not (is_within(sim.ctrl, bounds[1]) and _advance(sim, t, x, bounds[0])):
                break
            copy(x, states[rollout, t + 1])


@compile_at_first_call
def execute(  # type: ignore[no-untyped-def]  # pragma: no cover
    sim,
    bounds,
    network,
    observation,
    history,
    resting,
    unrest,
    lag,
    misread,
    told,
    calm,
    noise,
    states,
    controls,
):
    """Writes rollouts of u = μ_θ(o) + noise from states[:, 0], up to where they leave bounds.

    The policy reads the state of `lag` steps before, with `misread` (N, T, r) added where it has
    columns; what it read in the `history` steps before; the last control, which was `resting` in
    the first step, where that has numbers. `told` has z of each rollout and step, shape (N, T, c),
    and `calm` that while the robot is not restless, and for `unrest[-1]` steps has not been.
    """
    n_read = len(observation.kinds)
    n_past = history * n_read
    memory = np.empty(n_past + len(resting))
    n_known = n_read + len(memory)
    past = np.empty((lag + 1, n_read))
    a, z = np.empty(np.max(network[1])), np.empty(np.max(network[1]))
    for rollout in range(len(states)):
        x = states[rollout, 0].copy()
        awake = 0  # up to this step
        if not is_within(x, bounds[0]):
            continue
        for t in range(noise.shape[1]):
            if _is_restless(x, unrest):
                awake = t + unrest[-1]
            read(sim, observation, x, past[t % (lag + 1)])
            copy(past[(t + 1) % (lag + 1) if t >= lag else 0], a[:n_read])
            for i in range(misread.shape[2]):
                a[i] += misread[rollout, t, i]
            if t == 0:
                for i in range(n_past):
                    memory[i] = a[i % n_read]
                copy(resting, memory[n_past:])
            copy(memory, a[n_read:n_known])
            copy(a, memory[:n_past])
            for i in range(told.shape[2]):
                a[n_known + i] = told[rollout, t, i] if t < awake else calm[rollout, t, i]
            network_output(network, a, z)
            for i in range(len(sim.ctrl)):
                sim.ctrl[i] = _clip(sim, i, a[i] + noise[rollout, t, i])
            copy(sim.ctrl, controls[rollout, t])
            copy(sim.ctrl, memory[n_past:])
            if not (is_within(sim.ctrl, bounds[1]) and _advance(sim, t, x, bounds[0])):
                break
            copy(x, states[rollout, t + 1])


@compiled_part
def _is_restless(x, unrest):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns whether a robot is restless, by `robot.unrest`; never, if no place is known."""
    rotation, rate, up, vertical, steps = unrest
    if steps == 0:
        return False
    w, i, j, k = x[rotation], x[rotation + 1], x[rotation + 2], x[rotation + 3]
    n, m, h = vertical[0], vertical[1], vertical[2]
    a = (1.0 - 2.0 * (j * j + k * k)) * n + 2.0 * (i * j + w * k) * m + 2.0 * (i * k - w * j) * h
    b = 2.0 * (i * j - w * k) * n + (1.0 - 2.0 * (i * i + k * k)) * m + 2.0 * (j * k + w * i) * h
    c = 2.0 * (i * k + w * j) * n + 2.0 * (j * k - w * i) * m + (1.0 - 2.0 * (i * i + j * j)) * h
    along = x[rate] * a + x[rate + 1] * b + x[rate + 2] * c
    u, v, w = x[rate] - along * a, x[rate + 1] - along * b, x[rate + 2] - along * c
    is_tilted = a * up[0] + b * up[1] + c * up[2] < math.cos(TILT)
    return is_tilted or u * u + v * v + w * w > RATE * RATE


@compiled_part
def _advance(sim, t, x, bound):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Lets the control of step t act on x; returns false if x then is outside the bound."""
    put_state(sim, x)
    push_at(sim, t)
    sim.warmstart[:] = 0.0  # nothing carries over from one control to the next
    for _ in range(sim.substeps):
        mj_step_skip(sim.model, sim.data, _NOTHING, 1)
    push_at(sim, NEVER)  # readings of states are those without a push
    get_state(sim, x)
    return is_within(x, bound)


@compiled_part
def _clip(sim, i, control):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns a control within its limits; NaN stays."""
    return min(max(control, sim.low[i]), sim.high[i])


CompiledNetwork = tuple[Array, NDArray[np.int64], NDArray[np.bool_], int]

_ACTIVATIONS = tuple(ACTIVATIONS)
_SOFTPLUS, _TANH = _ACTIVATIONS.index("softplus"), _ACTIVATIONS.index("tanh")


def compiled_network(policy: GaussianPolicy) -> CompiledNetwork:
    """Returns θ, the layers' sizes, which of them have biases, and the activation."""
    shape = policy.architecture
    return (
        np.array(policy.parameters),
        np.array(shape.layer_sizes),
        np.array(shape.biased),
        _ACTIVATIONS.index(shape.activation),
    )


@compile_at_first_call
def network_output(network, a, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes μ_θ(o) over o, the beginning of a; a and z must be as long as the widest layer.

    Its bits are those of `robot.executed_control.ExactMean`.
    """
    parameters, sizes, biased, activation = network
    start = 0
    for layer in range(len(biased)):
        n_in, n_out = sizes[layer], sizes[layer + 1]
        end = start + n_out * n_in
        for o in range(n_out):
            z[o] = parameters[end + o] if biased[layer] else 0.0
            for i in range(n_in):
                z[o] += parameters[start + o * n_in + i] * a[i]
        last = layer == len(biased) - 1
        for o in range(n_out):
            a[o] = z[o] if last else _activate(activation, z[o])
        start = end + n_out if biased[layer] else end


@compiled_part
def _activate(activation, z):  # type: ignore[no-untyped-def]  # pragma: no cover
    if activation == _SOFTPLUS:
        return max(z, 0.0) + _log1p(_exp(-abs(z)))
    if activation == _TANH:
        e = _exp(-2.0 * abs(z))
        return math.copysign((1.0 - e) / (1.0 + e), z)
    return max(z, 0.0)


@compiled_part
def _exp(z):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns exp(z) for z ≤ 0: 2^n times the series at r = z − n log 2, |r| ≤ 0.35."""
    if z != z:
        return z  # NaN
    z = max(z, SMALLEST_EXPONENT)
    n = np.floor(z * INVERSE_LOG_2 + 0.5)
    r = (z - n * LOG_2_HIGH) - n * LOG_2_LOW
    return math.ldexp(_series(EXP, r), int(n))


@compiled_part
def _log1p(y):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns log(1 + y) for y in [0, 1]: 2 artanh(s) with s = y / (2 + y), |s| ≤ 1/3."""
    s = y / (2.0 + y)
    return 2.0 * s * _series(ARTANH, s * s)


@compiled_part
def _series(coefficients, x):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns 1 + Σ c_k x^k; the first two terms, which are large, are added last."""
    power, rest = x * x, coefficients[1] * (x * x)
    for k in range(2, len(coefficients)):
        power *= x
        rest += coefficients[k] * power
    return 1.0 + (coefficients[0] * x + rest)
