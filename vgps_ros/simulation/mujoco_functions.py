# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""MuJoCo's C functions for compiled loops.

MuJoCo's Python functions cannot be called from a compiled loop, so the loop calls those of the C
library. Two ways of numba were tried for that: machine code that calls a ctypes function cannot be
cached, and a WrapperAddressProtocol takes 10 µs at each call of a loop. So an intrinsic names the C
function, and LLVM is given its address, both by documented interfaces. LLVM does not load the
library itself, since its symbols would then come before those of libraries that are loaded later.

One private name is left, `_address` of MjModel and MjData (see `dynamics`): the C functions take no
Python objects, and MuJoCo offers no other way to their pointers
(github.com/google-deepmind/mujoco/issues/2564).
"""

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
from llvmlite import binding, ir
from numba import types
from numba.extending import intrinsic

_intrinsic: Callable[..., Callable[..., Any]] = intrinsic
_LIBRARY = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("libmujoco*"))))

# The Python bindings read the clock around each stage of a step, an eighth of its time here; no one
# asks for these times.
mujoco.set_mjcb_time(None)


def _call_of(name: str) -> Callable[..., Any]:
    """Returns what writes a call of a C function without a result into machine code."""
    binding.add_symbol(name, ctypes.cast(getattr(_LIBRARY, name), ctypes.c_void_p).value)

    def write(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [argument.type for argument in arguments])
        known = builder.module.globals.get(name)
        builder.call(known or ir.Function(builder.module, kind, name), arguments)
        return context.get_dummy_value()

    return write


def _of_simulation(name: str) -> Callable[..., Any]:
    """Returns a C function that works on a model and a data, given by their addresses."""
    call = _call_of(name)

    def function(_, model, data):  # type: ignore[no-untyped-def]
        return types.void(types.intp, types.intp), call

    return _intrinsic(function)


# Parts of MuJoCo's forward dynamics, by the names that its documentation gives them.
mj_kinematics = _of_simulation("mj_kinematics")
mj_com_pos = _of_simulation("mj_comPos")
mj_com_vel = _of_simulation("mj_comVel")
mj_subtree_vel = _of_simulation("mj_subtreeVel")
mj_sensor_pos = _of_simulation("mj_sensorPos")
mj_sensor_vel = _of_simulation("mj_sensorVel")
mj_forward = _of_simulation("mj_forward")
mj_fwd_actuation = _of_simulation("mj_fwdActuation")

_CALL_STEP_SKIP = _call_of("mj_stepSkip")
_CALL_EULER_SKIP, _CALL_IMPLICIT_SKIP = _call_of("mj_EulerSkip"), _call_of("mj_implicitSkip")
_CALL_DIFFERENTIATE, _CALL_INTEGRATE = _call_of("mj_differentiatePos"), _call_of("mj_integratePos")


@_intrinsic
def mj_step_skip(_, model, data, skipped_stage, skips_sensors):  # type: ignore[no-untyped-def]
    """Advances the simulation by one simulator step, without stages that are valid already."""
    return types.void(types.intp, types.intp, types.int32, types.int32), _CALL_STEP_SKIP


@_intrinsic
def mj_differentiate_pos(_, model, velocity, period, origin, positions):  # type: ignore[no-untyped-def]
    """Writes the velocity that leads from the origin to the positions; arrays by address."""
    return (
        types.void(types.intp, types.intp, types.float64, types.intp, types.intp),
        _CALL_DIFFERENTIATE,
    )


@_intrinsic
def mj_integrate_pos(_, model, positions, velocity, period):  # type: ignore[no-untyped-def]
    """Moves positions by a velocity for a period; arrays by address."""
    return types.void(types.intp, types.intp, types.intp, types.float64), _CALL_INTEGRATE


@_intrinsic
def mj_euler_skip(_, model, data, skips_factor):  # type: ignore[no-untyped-def]
    """Advances the state by the acceleration, without a factorisation that is valid already."""
    return types.void(types.intp, types.intp, types.int32), _CALL_EULER_SKIP


@_intrinsic
def mj_implicit_skip(_, model, data, skips_factor):  # type: ignore[no-untyped-def]
    """Does the same implicitly in velocity."""
    return types.void(types.intp, types.intp, types.int32), _CALL_IMPLICIT_SKIP


def _loader(kind: ir.Type, result: types.Type) -> Callable[..., Any]:
    """Returns what reads a number of some type from the i-th place behind an address."""

    def write(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        address, i = arguments
        return builder.load(builder.gep(builder.inttoptr(address, kind.as_pointer()), [i]))

    def function(_, address, i):  # type: ignore[no-untyped-def]
        return result(types.intp, types.intp), write

    return _intrinsic(function)


double_at = _loader(ir.DoubleType(), types.float64)
int32_at = _loader(ir.IntType(32), types.int32)
address_at = _loader(ir.IntType(64), types.intp)
