# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Readings: the numbers that a cost scores, a policy reads, and a fall is judged by.

Each has a name. A joint's coordinates are JOINT/position, JOINT/velocity, JOINT/sin and JOINT/cos
(see `state_names` for those of free bodies, balls and activations). A sensor of the model that
gives one number has its own name; of one that gives several, each is SENSOR/x, /y, /z, or /w, /x,
/y, /z for a quaternion.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.checks import nearest, quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation import compiled_readings as compiled
from vgps_ros.simulation.dynamics import Simulations
from vgps_ros.simulation.model import cyclic_positions, deviation_names, sensor_numbers, state_names

_EPS = 1e-7  # perturbation of the finite differences
_LEAST_READ = 200  # states that a thread reads at least, since it takes longer to hand fewer over
MEASURED = "measured/"  # before a sensor's name: what an inertial unit measures in its place
_FUNCTIONS = {"sin": compiled.SINE, "cos": compiled.COSINE}


class Readings:
    """Reads r numbers of states, with their derivatives; an `Observation` of them.

    On sloping ground a cost counts directions from the ground, as all of the model does, but what
    is `measured` counts them from the vertical (`MEASURED`).

    Attributes:
        names: name of each number.
        space: space of the states.
        needs_controls: whether a reading depends on the control too, as a contact force does.
        plan: how compiled loops compute the readings.

    A name may come twice.

    Raises:
        InvalidInputError: a name is unknown.
    """

    def __init__(self, simulations: Simulations, names: Sequence[str], *, measured: bool = False):
        self.names, self.space = tuple(names), simulations.space
        self._simulations = simulations
        self.plan = _plan(simulations, self.names, measured)
        self.needs_controls = self.plan.needs == compiled.EVERYTHING
        self._is_linear = bool((self.plan.kinds == compiled.COORDINATE).all())

    def __call__(self, states: Array, controls: Array | None = None) -> Array:
        """Returns the numbers, shape (..., r); NaN where a state is not finite.

        Args:
            states: shape (..., n_x).
            controls: shape (..., n_u); zero if they are left out.
        """
        if self._is_linear:
            return np.take(states, self.plan.places, axis=-1)
        x, u = self._rows(states, controls)
        out = np.empty((len(x), len(self.names)))
        self._simulations.in_threads(
            len(x),
            lambda sim, part: compiled.read_each(sim, self.plan, x[part], u[part], out[part]),
            _LEAST_READ,
        )
        return out.reshape(*states.shape[:-1], -1)

    def linearize(self, states: Array, controls: Array | None = None) -> tuple[Array, Array, Array]:
        """Returns the numbers (..., r), and their derivatives (..., r, n_dx), (..., r, n_u).

        Args:
            states: shape (..., n_x), finite.
            controls: shape (..., n_u); zero if they are left out.
        """
        x, u = self._rows(states, controls)
        n, r, n_dx = len(x), len(self.names), self.space.tangent_dim
        leading = states.shape[:-1]
        if self._is_linear:
            one = np.eye(n_dx)[self.plan.tangent]
            by_control = np.zeros((*leading, r, u.shape[1]))
            return self(states), np.broadcast_to(one, (*leading, r, n_dx)), by_control
        out, by_state, by_control = (np.empty((n, r, *m)) for m in ((), (n_dx,), (u.shape[1],)))
        self._simulations.in_threads(
            n,
            lambda sim, part: compiled.differentiate_each(
                *(sim, self.plan, _EPS, x[part], u[part]),
                *(out[part], by_state[part], by_control[part]),
            ),
            max(1, _LEAST_READ // (1 + len(self.plan.columns))),
        )
        return tuple(a.reshape(*leading, *a.shape[1:]) for a in (out, by_state, by_control))  # type: ignore[return-value]

    def pull_back(self, jacobians: Array, states: Array) -> Array:
        """Returns J ∂r/∂δ, shape (..., m, n_dx), for J (..., m, r) at states (..., n_x)."""
        if not self._is_linear:
            found: Array = jacobians @ self.linearize(states)[1]
            return found
        full = np.zeros((*jacobians.shape[:-1], self.space.tangent_dim))
        full[..., self.plan.tangent] = jacobians
        return full

    def _rows(self, states: Array, controls: Array | None) -> tuple[Array, Array]:
        """Returns states and controls one a row, as compiled loops take them."""
        x = np.ascontiguousarray(states, dtype=float).reshape(-1, states.shape[-1])
        n_u = self._simulations.model.nu
        u = np.zeros((len(x), n_u)) if controls is None else controls
        return x, np.ascontiguousarray(u, dtype=float).reshape(-1, n_u)


def _plan(simulations: Simulations, names: tuple[str, ...], measured: bool) -> compiled.ReadingPlan:
    """Finds each name in the model, and what MuJoCo has to compute for all of them."""
    model = simulations.model
    # A coordinate that is a plain number has the same name in a state and in its deviation.
    numbers, states, deviations = sensor_numbers(model), state_names(model), deviation_names(model)
    rows: list[tuple[int, int, int]] = []  # kind, place and coordinate of a deviation of each
    sensors = set()
    if measured:
        names = tuple(MEASURED + n if MEASURED + n in numbers else n for n in names)
    for name in names:
        owner, _, function = name.rpartition("/")
        coordinate = f"{owner}/position" if function in _FUNCTIONS else name
        if name in numbers:
            sensor, place = numbers[name]
            sensors.add(sensor)
            rows.append((compiled.SENSOR, place, 0))
        elif coordinate in states and coordinate in deviations:
            kind = _FUNCTIONS.get(function, compiled.COORDINATE)
            rows.append((kind, states.index(coordinate), deviations.index(coordinate)))
        elif name in states:  # w, x, y or z of a quaternion
            part = "wxyz".index(name[-1])
            first = deviations.index(f"{owner}/rx")
            rows.append((compiled.QUATERNION + part, states.index(name), first))
        else:
            known = [*numbers, *states]
            raise InvalidInputError(
                f"The model has no reading {quote(name)}; name a sensor's number or a joint's "
                f"coordinate, such as {', '.join(known[:3])}.{nearest(name, known)}"
            )
    needs, columns = compiled.NOTHING, np.zeros(0, dtype=np.int64)
    if any(_needs_everything(model, sensor) for sensor in sensors):
        needs = compiled.EVERYTHING
        columns = np.arange(len(deviations) + model.nu)[::-1].copy()
    elif sensors:
        needs, columns = compiled.KINEMATICS, _columns_felt(model, sorted(sensors))
    kinds, places, tangent = np.array(rows, dtype=np.int64).reshape(-1, 3).T.copy()
    return compiled.ReadingPlan(needs, kinds, places, tangent, columns)


def _columns_felt(model: mujoco.MjModel, sensors: list[int]) -> NDArray[np.int64]:
    """Returns the coordinates of a deviation that sensors may depend on, positions last."""
    positions, velocities = np.zeros((2, model.nv), dtype=bool)
    for sensor in sensors:
        bodies = [
            _body_of(model, model.sensor_objtype[sensor], model.sensor_objid[sensor]),
            _body_of(model, model.sensor_reftype[sensor], model.sensor_refid[sensor]),
        ]
        if _SENSOR(model.sensor_type[sensor]) in _OF_SUBTREES:
            bodies = [i for i in range(model.nbody) if bodies[0] in _ancestors(model, i)]
        moving = {each for body in bodies for each in _ancestors(model, body)}
        felt = np.isin(model.dof_bodyid, list(moving))
        if model.sensor_needstage[sensor] == mujoco.mjtStage.mjSTAGE_VEL:
            velocities |= felt
            felt[cyclic_positions(model)] = False  # how fast it goes is the same everywhere
        positions |= felt
    return np.r_[np.flatnonzero(velocities) + model.nv, np.flatnonzero(positions)].astype(np.int64)


_SENSOR, _OBJECT = mujoco.mjtSensor, mujoco.mjtObj
# Sensors of one frame, perhaps relative to another one.
_OF_FRAMES = {
    *(_SENSOR.mjSENS_FRAMEPOS, _SENSOR.mjSENS_FRAMEQUAT),
    *(_SENSOR.mjSENS_FRAMEXAXIS, _SENSOR.mjSENS_FRAMEYAXIS, _SENSOR.mjSENS_FRAMEZAXIS),
    *(_SENSOR.mjSENS_FRAMELINVEL, _SENSOR.mjSENS_FRAMEANGVEL),
    *(_SENSOR.mjSENS_GYRO, _SENSOR.mjSENS_VELOCIMETER),
}
# Sensors of a body with all that hangs on it.
_OF_SUBTREES = {
    *(_SENSOR.mjSENS_SUBTREECOM, _SENSOR.mjSENS_SUBTREELINVEL, _SENSOR.mjSENS_SUBTREEANGMOM)
}
_OF_JOINTS = {
    *(_SENSOR.mjSENS_JOINTPOS, _SENSOR.mjSENS_JOINTVEL),
    *(_SENSOR.mjSENS_BALLQUAT, _SENSOR.mjSENS_BALLANGVEL),
}


def _needs_everything(model: mujoco.MjModel, sensor: int) -> bool:
    """Returns whether a sensor needs more than the positions and velocities of bodies."""
    if _SENSOR(model.sensor_type[sensor]) not in {*_OF_FRAMES, *_OF_SUBTREES, *_OF_JOINTS}:
        return True
    frames = (model.sensor_objtype[sensor], model.sensor_reftype[sensor])
    return int(_OBJECT.mjOBJ_CAMERA) in frames


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Returns a body, and all between it and the world."""
    found = [body]
    while model.body_parentid[found[-1]] > 0:
        found.append(int(model.body_parentid[found[-1]]))
    return found


def _body_of(model: mujoco.MjModel, kind: int, index: int) -> int:
    """Returns the body to which an object is fixed; the world where there is no object."""
    if index < 0:
        return 0
    owners = {
        _OBJECT.mjOBJ_GEOM: model.geom_bodyid,
        _OBJECT.mjOBJ_SITE: model.site_bodyid,
        _OBJECT.mjOBJ_JOINT: model.jnt_bodyid,
    }
    of_bodies = owners.get(_OBJECT(kind))
    return index if of_bodies is None else int(of_bodies[index])
