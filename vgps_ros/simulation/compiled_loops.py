# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Rollouts in compiled loops, which call MuJoCo's C functions without Python."""

import mujoco
import numpy as np

from vgps_ros.core.compilation import compiled
from vgps_ros.core.executed_control import network_output
from vgps_ros.simulation.compiled_readings import read
from vgps_ros.simulation.compiled_states import (
    add,
    get_state,
    push_at,
    put_state,
    subtract,
)
from vgps_ros.simulation.mujoco_functions import mj_step_skip

# No stage of a step is skipped.
_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)


@compiled
def advance(sim, bounds, times, states, controls, after):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Does a control step of N rollouts, each at a time; `bounds` are those of states and controls.

    Clips the controls to their limits. Writes f(x, u) to `after`, but NaN where x, u or f(x, u) is
    out of bounds, and NaN to controls where x is. Returns how many controls were executed, and how
    many rollouts are within bounds.
    """
    executed = inside = 0
    for i in range(len(states)):
        x = after[i]
        x[:] = states[i]
        is_inside = _is_within(x, bounds[0])
        for j in range(len(sim.ctrl)):
            controls[i, j] = sim.ctrl[j] = _clipped(sim, j, controls[i, j])
        if not is_inside:
            controls[i] = np.nan
        elif _is_within(controls[i], bounds[1]):
            executed += 1
            is_inside = _advance(sim, times[i], x, bounds[0])
        else:
            is_inside = False
        if is_inside:
            inside += 1
        else:
            x[:] = np.nan
    return executed, inside


@compiled
def follow(  # type: ignore[no-untyped-def]  # pragma: no cover
    sim, bounds, nominal_states, nominal_controls, gains, gaps, states, controls
):
    """Writes the rollout of u = ū + K (x ⊖ x̄) from states[0], up to where it leaves its bounds.

    Where `gaps` has rows, one a step, each state stays short of f(x, u) by its row.
    """
    x, deviation = states[0].copy(), np.empty(gains.shape[2])
    if not _is_within(x, bounds[0]):
        return
    for t in range(len(controls)):
        subtract(sim, x, nominal_states[t], deviation)
        for i in range(len(sim.ctrl)):
            sim.ctrl[i] = nominal_controls[t, i]
            for j in range(len(deviation)):
                sim.ctrl[i] += gains[t, i, j] * deviation[j]
            sim.ctrl[i] = _clipped(sim, i, sim.ctrl[i])
        controls[t] = sim.ctrl
        if not (_is_within(sim.ctrl, bounds[1]) and _advance(sim, t, x, bounds[0])):
            return
        if len(gaps):
            add(sim, x, gaps[t], -1.0)
        states[t + 1] = x


@compiled
def replay(sim, bounds, controls, states):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Writes rollouts of given controls from states[:, 0], up to where they leave their bounds."""
    for rollout in range(len(states)):
        x = states[rollout, 0].copy()
        if not _is_within(x, bounds[0]):
            continue
        for t in range(controls.shape[1]):
            sim.ctrl[:] = controls[rollout, t]
            if not (_is_within(sim.ctrl, bounds[1]) and _advance(sim, t, x, bounds[0])):
                break
            states[rollout, t + 1] = x


@compiled
def execute(  # type: ignore[no-untyped-def]  # pragma: no cover
    sim, bounds, network, observation, history, resting, lag, misread, told, noise, states, controls
):
    """Writes rollouts of u = μ_θ(o) + noise from states[:, 0], up to where they leave bounds.

    The policy reads the state of `lag` steps before, with `misread` (N, T, r) added where it has
    columns; what it read in the `history` steps before; the last control, which was `resting` in
    the first step, where that has numbers. `told` has z of each rollout and step, shape (N, T, c).
    """
    n_read = len(observation.kinds)
    n_past = history * n_read
    memory = np.empty(n_past + len(resting))
    n_known = n_read + len(memory)
    past = np.empty((lag + 1, n_read))
    a, z = np.empty(np.max(network[1])), np.empty(np.max(network[1]))
    for rollout in range(len(states)):
        x = states[rollout, 0].copy()
        if not _is_within(x, bounds[0]):
            continue
        for t in range(noise.shape[1]):
            read(sim, observation, x, past[t % (lag + 1)])
            a[:n_read] = past[(t + 1) % (lag + 1) if t >= lag else 0]
            for i in range(misread.shape[2]):
                a[i] += misread[rollout, t, i]
            if t == 0:
                for i in range(n_past):
                    memory[i] = a[i % n_read]
                memory[n_past:] = resting
            a[n_read:n_known] = memory
            memory[:n_past] = a[:n_past]
            for i in range(told.shape[2]):
                a[n_known + i] = told[rollout, t, i]
            network_output(network, a, z)
            for i in range(len(sim.ctrl)):
                sim.ctrl[i] = _clipped(sim, i, a[i] + noise[rollout, t, i])
            controls[rollout, t] = sim.ctrl
            memory[n_past:] = sim.ctrl[: len(resting)]
            if not (_is_within(sim.ctrl, bounds[1]) and _advance(sim, t, x, bounds[0])):
                break
            states[rollout, t + 1] = x


@compiled
def _advance(sim, t, x, bound):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Lets the control of step t act on x; returns false if x then is outside the bound."""
    put_state(sim, x)
    push_at(sim, t)
    sim.warmstart[:] = 0.0  # nothing carries over from one control to the next
    for _ in range(sim.substeps):
        mj_step_skip(sim.model, sim.data, _NOTHING, 1)
    push_at(sim, -1)  # readings of states are those without a push
    get_state(sim, x)
    return _is_within(x, bound)


@compiled
def _clipped(sim, i, control):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns a control within its limits; NaN stays."""
    return min(max(control, sim.low[i]), sim.high[i])


@compiled
def _is_within(values, bound):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Returns whether all values are inside the bound; NaN is not."""
    return np.all(np.abs(values) < bound)
