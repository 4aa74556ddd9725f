# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds what the derivatives of a simulator step may leave out on a model.

MuJoCo computes a step in stages: positions, velocities, actuation, the acceleration at which all
forces balance, and its integration.
"""

from typing import NamedTuple

import mujoco
import numpy as np

_DISABLE, _ENABLE = mujoco.mjtDisableBit, mujoco.mjtEnableBit
_GAIN, _INTEGRATOR = mujoco.mjtGain, mujoco.mjtIntegrator


class StepStructure(NamedTuple):
    """Properties of a model's step.

    Attributes:
        may_skip: whether a step may skip stages: the Runge-Kutta method leaves none valid.
        may_predict: whether there are constraints, and the step is their balance of forces,
            integrated by a linear system whose matrix depends on positions alone.
        is_implicit: whether that integration is implicit in velocity.
        is_one_sided: whether constraints act only while they push, as contacts and limits do; then
            a constraint without force has none nearby either.
    """

    may_skip: bool
    may_predict: bool
    is_implicit: bool
    is_one_sided: bool


def step_structure(model: mujoco.MjModel) -> StepStructure:
    """Returns the structure of a model's step."""
    option = model.opt
    is_fast = option.integrator == _INTEGRATOR.mjINT_IMPLICITFAST
    other_stages = _ENABLE.mjENBL_SLEEP | _ENABLE.mjENBL_DIAGEXACT | _ENABLE.mjENBL_IPC
    may_predict = (
        (is_fast or option.integrator == _INTEGRATOR.mjINT_EULER)
        and not option.disableflags & _DISABLE.mjDSBL_CONSTRAINT
        and not option.enableflags & other_stages
        and not (option.noslip_iterations or model.nplugin or model.nflex)
        and not damping_varies(model)
    )
    return StepStructure(
        may_skip=bool(option.integrator != _INTEGRATOR.mjINT_RK4),
        may_predict=bool(may_predict),
        is_implicit=bool(is_fast),
        is_one_sided=not (
            model.neq
            or model.flg_adhesion
            or model.dof_frictionloss.any()
            or model.tendon_frictionloss.any()
        ),
    )


def damping_varies(model: mujoco.MjModel) -> bool:
    """Returns whether ∂(force)/∂(velocity) changes with velocity or control, as in a fluid.

    Drag even has a kink there: its damping is proportional to |v|.
    """
    polynomials = model.dof_dampingpoly, model.tendon_dampingpoly, model.actuator_dampingpoly
    is_fixed = model.actuator_gaintype == _GAIN.mjGAIN_FIXED
    is_affine = model.actuator_gaintype == _GAIN.mjGAIN_AFFINE
    is_plain = is_fixed | (is_affine & (model.actuator_gainprm[:, 2] == 0.0))
    return bool(
        model.opt.density
        or model.opt.viscosity
        or any(np.any(values) for values in polynomials)
        or not is_plain.all()
    )
