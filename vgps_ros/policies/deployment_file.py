# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The file of what a robot's executor has to know of a task, by which it takes no MuJoCo.

The file has no kinematics. What a policy reads of the state must be linear in what sensors measure:

    h(x) = W (1, x, sin q, cos q, R, Rᵀv, Rω),                                           (1)

where q are the hinges, R, v and ω are the free base's rotation, its linear velocity in the world's
axes and its angular velocity in its own. That holds of joints, of gravity's direction, of a gyro,
a velocimeter and the pose of the base or what is fixed to it; not of the height of a foot. W is
fitted to the model's readings, and tried on states that it was not fitted to.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from vgps_ros.core.checks import (
    Shape,
    array_shapes,
    check_array,
    check_record,
    error_text,
    nearest,
    one_of,
    quote,
)
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.memory import PastInputs
from vgps_ros.core.observation import Observation
from vgps_ros.core.records import Array
from vgps_ros.robot.bodies import StateLayout
from vgps_ros.robot.controls import Controls
from vgps_ros.robot.deployment import Conditions, Deployment, Reader
from vgps_ros.robot.signals import SOURCE, Signals
from vgps_ros.storage.files import Text, from_tree, read_json, to_tree, write_json

_FORMAT = 2
_EPS = 1e-6  # perturbation of the finite differences
_EXACT = 1e-9  # largest deviation of a reading from what is fitted to it
_MOST, _LONGEST = 2000, 10**7  # names of a kind, and steps of a horizon
_DIGITS = 12  # to which the weights are rounded, so that 0 and 1 are exact

DEPLOYMENT = ".json"  # how the name of a deployment file ends


class MeasuredReadings:
    """Reads r numbers of states by (1), with their derivatives; an `Observation` of them.

    Attributes:
        names: name of each number.
        space: space of the states.
    """

    needs_controls = False

    def __init__(self, layout: StateLayout, names: Sequence[str], weights: Array):
        self.names, self.space = tuple(names), layout.space
        self._layout, self._weights = layout, weights

    def __call__(self, states: Array) -> Array:
        """Returns the numbers, shape (..., r), for states (..., n_x)."""
        return np.asarray(_measured(self._layout, states) @ self._weights.T)

    def pull_back(self, jacobians: Array, states: Array) -> Array:
        """Returns J ∂h/∂δ, shape (..., m, n_dx), for J (..., m, r) at states (..., n_x)."""
        steps = _EPS * np.eye(self.space.tangent_dim)
        here = states[..., None, :]
        ahead, back = (self(self.space.add(here, side * steps)) for side in (1.0, -1.0))
        slopes = (ahead - back) / (2.0 * _EPS)  # shape (..., n_dx, r)
        return np.asarray(jacobians @ np.swapaxes(slopes, -1, -2))


def _measured(layout: StateLayout, states: Array) -> Array:
    """Returns the numbers to the right of W in (1), shape (..., f)."""
    hinges = states[..., layout.joint_places[: len(layout.joints)]]
    parts = [np.ones((*states.shape[:-1], 1)), states, np.sin(hinges), np.cos(hinges)]
    if layout.base:
        _, q, v, omega = layout.base.parts(states)
        w, x, y, z = np.moveaxis(q, -1, 0)
        rows = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
        rotation = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
        parts += [
            rotation.reshape(*states.shape[:-1], 9),
            (v[..., None, :] @ rotation)[..., 0, :],
            (rotation @ omega[..., None])[..., 0],
        ]
    return np.concatenate(parts, axis=-1)


def _width(layout: StateLayout) -> int:
    """Returns f, the number of columns of W."""
    return _measured(layout, np.zeros(len(layout.names))).size


def _fitted(layout: StateLayout, read: Reader, names: Sequence[str]) -> dict[str, Array]:
    """Returns the weights (f,) of the readings of which (1) holds, by name."""
    rng, states = np.random.default_rng(0), []
    width = _width(layout)
    for _ in range(2):
        x = rng.standard_normal((2 * width, len(layout.names)))
        for first in layout.space.quaternions:
            x[:, first : first + 4] /= np.linalg.norm(x[:, first : first + 4], axis=1)[:, None]
        states.append(x)
    known, tried = (read(names)(x) for x in states)
    weights = np.linalg.lstsq(_measured(layout, states[0]), known, rcond=None)[0]
    weights = np.round(weights, _DIGITS) + 0.0
    error = np.abs(_measured(layout, states[1]) @ weights - tried).max(axis=0, initial=0.0)
    return {name: weights[:, i] for i, name in enumerate(names) if error[i] < _EXACT}


@dataclass(frozen=True, eq=False)
class _Content:
    """Holds what a deployment file says."""

    name: str
    mjcf: Text
    time_step: float
    horizon: int
    layout: StateLayout
    controls: Controls
    signals: Signals
    initial_state: Annotated[Array, Shape("n_x")]
    keyframes: tuple[str, ...]
    poses: Annotated[Array, Shape("keyframes", "n_x")]
    forces: Annotated[Array, Shape("keyframes+1", "n_u")]
    read: tuple[str, ...]
    told: tuple[str, ...]
    past: PastInputs | None
    limited: tuple[str, ...]
    lowest: Array
    highest: Array
    sensors: tuple[str, ...]
    weights: Annotated[Array, Shape("sensors", "columns")]

    def readings(self, names: Sequence[str]) -> MeasuredReadings:
        """Returns readings by their names; see `Deployment`.

        Raises:
            InvalidInputError: there is none of a name.
        """
        known = {name: i for i, name in enumerate(self.names)}
        for name in names:
            if name not in known:
                raise InvalidInputError(
                    f"The robot has no reading {quote(name)}; name a sensor's number or a joint's "
                    f"coordinate, such as {self.names[0]}.{nearest(name, known)}"
                )
        width = _width(self.layout)
        plain = np.eye(width)[1 : 1 + len(self.names) - len(self.sensors)]
        every = np.concatenate([plain, self.weights.reshape(-1, width)])
        return MeasuredReadings(self.layout, names, every[[known[name] for name in names]])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of all readings."""
        turned = (f"{joint}/{of}" for of in ("sin", "cos") for joint in self.layout.joints)
        return (*self.layout.names, *turned, *self.sensors)


def write_deployment(deployment: Deployment, path: Path) -> None:
    """Writes a deployment that `read_deployment` reads back.

    Raises:
        InvalidInputError: the policy or the limits read what only the model can tell.
    """
    layout, observation, limits = deployment.layout, deployment.observation, deployment.limits
    read = (*observation.readings.names, *limits.readings.names)
    plain = {*layout.names, *(f"{joint}/{of}" for joint in layout.joints for of in ("sin", "cos"))}
    names = [name for name in dict.fromkeys((*read, *deployment.sensors)) if name not in plain]
    fitted = _fitted(layout, deployment.read, names) if names else {}
    if lacking := [name for name in read if name not in plain and name not in fitted]:
        raise InvalidInputError(
            f"{deployment.name} reads {quote(lacking[0])}, which follows from no measurement "
            "without the robot's model; let observe and limits name joints and what the base "
            "feels, or let the executor load the task."
        )
    content = _Content(
        *(deployment.name, Text(deployment.mjcf), deployment.time_step, deployment.horizon),
        *(layout, deployment.controls, deployment.signals, deployment.initial_state),
        tuple(deployment.keyframes),
        np.array(list(deployment.keyframes.values())).reshape(-1, len(layout.names)),
        np.array([deployment.carrying[name] for name in ("", *deployment.keyframes)]),
        *(observation.readings.names, observation.told, observation.past),
        *(limits.readings.names, limits.lowest, limits.highest),
        tuple(fitted),
        np.array(list(fitted.values())).reshape(-1, _width(layout)),
    )
    arrays: dict[str, Array] = {}
    entries = to_tree(content, arrays)
    listed = {name: _to_lists(array) for name, array in arrays.items()}
    tree = {"format": _FORMAT, "sha256": _digest(entries, listed)}
    write_json(path, tree | {"deployment": entries, "arrays": listed})


def read_deployment(path: Path) -> Deployment:
    """Reads a deployment.

    Raises:
        InvalidInputError: the file is missing, is none, or was changed.
    """
    try:
        tree: Any = read_json(path)
        if tree["format"] != _FORMAT:
            raise ValueError(f"its format is {tree['format']}, but this version reads {_FORMAT}")
        if tree["sha256"] != _digest(tree["deployment"], tree["arrays"]):
            raise ValueError("its content has changed since it was written")
        arrays = {name: np.array(each, dtype=float) for name, each in tree["arrays"].items()}
        content: _Content = from_tree(_Content, tree["deployment"], arrays)
        _check(content)
        poses = dict(zip(content.keyframes, content.poses, strict=True))
        carrying = dict(zip(("", *content.keyframes), content.forces, strict=True))
        observation = Observation.of(
            content.readings(content.read), content.told, content.signals.names, content.past
        )
        limits = Conditions(content.readings(content.limited), content.lowest, content.highest)
        limits.broken(content.initial_state)
        observation.within(np.zeros(len(content.signals.names)))(content.initial_state)
    except (OSError, KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InvalidInputError(
            f"'{path}' is no deployment ({error_text(error)}); write one with "
            "'vgps export --deployment'."
        ) from error
    return Deployment(
        *(content.name, content.mjcf, content.time_step, content.horizon, content.layout),
        *(content.controls, content.signals, content.initial_state, poses, carrying),
        *(observation, limits, content.readings, content.sensors),
    )


def _check(content: _Content) -> None:
    """Checks what a record's types do not tell of a robot: sizes, units, places and ranges."""
    layout, robot, past = content.layout, content.controls, content.past
    commands = content.signals.commands
    named = [content.names, layout.joints, robot.names, content.keyframes]
    named += [tuple(each.name for each in of) for of in (layout.bodies, commands)]
    of_each = *named, layout.mounts, content.read, content.limited
    if max(map(len, of_each)) > _MOST or (past and not 0 <= past.history <= _MOST):
        raise InvalidInputError(f"it has more than {_MOST} names of a kind")
    for names in named:
        for name, count in Counter(names).items():
            if count > 1 or not name:
                raise InvalidInputError(f"the name {quote(name)} stands {count} times")
    for name, kind, unit in zip(robot.names, robot.kinds, robot.units, strict=True):
        one_of(f"the unit of {quote(name)}", unit, kind.units)
    sizes = {"n_x": len(layout.names), "n_u": len(robot.names), "xyz": 3, "wxyz": 4}
    sizes |= {"keyframes": len(content.keyframes), "mounts": len(layout.mounts)}
    sizes |= {"sensors": len(content.sensors), "columns": _width(layout)}
    for path, shape in array_shapes(_Content, **sizes).items():
        if (values := attrgetter(path)(content)).size or 0 not in shape:  # of which JSON says []
            check_array(f"'{path}'", values, shape)
    places = [layout.first_activation - 1, *(b.first_position for b in layout.bodies)]
    places += [b.first_velocity + 2 for b in layout.bodies]
    if base := layout.planar:
        check_record("its planar base", base, **sizes, slides=len(base.joints) - 1)
        places += [*base.positions, *base.velocities]
    counts, ranges = [len(robot.names)] * 2, [*robot.limits]
    if past:
        check_array("'past.resting'", past.resting, (counts[0],))
        counts, ranges = counts * 2, [*ranges, *past.limits]
    ranges += [*layout.ranges, content.lowest, content.highest]
    counts += [len(layout.joints)] * 2 + [len(content.limited)] * 2
    signals, step, n_x = content.signals, content.time_step, len(layout.names)
    shapes = [each.shape for each in ranges] == [(count,) for count in counts]
    bounds = all(-_LONGEST < c.lowest <= c.highest < _LONGEST for c in commands)
    right = {
        "limits": shapes and not any(np.isnan(each).any() for each in ranges),
        "places in the state": all(place in range(n_x) for place in places),
        "control period": 0.0 < step <= 10.0 and signals.time_step == step,
        "horizon": 0 < content.horizon <= _LONGEST,
        "commands": bounds and all(SOURCE.fullmatch(c.source) for c in commands if c.source),
        "clock": 0.0 <= signals.frequency * step <= 1.0,
    }
    if wrong := [what for what, is_right in right.items() if not is_right]:
        raise InvalidInputError(f"its {', '.join(wrong)} cannot be a robot's")


def make_deployment(reference: str) -> Deployment:
    """Returns what an executor has to know of a task; of a deployment file without MuJoCo.

    Args:
        reference: a deployment file, or what `make_task` takes.

    Raises:
        InvalidInputError: the file holds no deployment, or as `make_task` does.
    """
    if reference.endswith(DEPLOYMENT):
        return read_deployment(Path(reference).expanduser())
    from vgps_ros.tasks import make_task

    return make_task(reference).deployment


def _digest(*content: Any) -> str:
    """Returns a digest of what the file holds, which tells a damaged file from a whole one."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _to_lists(array: Array) -> list[Any]:
    """Returns an array as lists, with infinities and NaN as text, since JSON has none."""
    plain = array.astype(object)
    plain[~np.isfinite(array)] = array[~np.isfinite(array)].astype(str)
    return plain.tolist()
