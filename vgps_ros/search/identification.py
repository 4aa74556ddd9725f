# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Fits what differs of a model to the measured motion of its robot, with uncertainties.

The motion is cut into short windows w. Each is simulated under the controls that the robot had,
from a first state x_w that nobody measured exactly; h(x) is what the sensors tell of a state x:

    min_θ Σ_w min_{x_w} Σ_t ‖(h(x_t(x_w, θ)) ⊖ y_t) / σ‖² + ‖x_w ⊖ x̂_w‖² + ‖θ‖²            (1)

So a base whose height and velocity no sensor tells is estimated in each window, together with θ.
The inner minimum is found by Gauss-Newton steps, and what it takes is projected out of the outer
Jacobian (variable projection); `scipy.optimize.least_squares` makes the outer steps. The last terms
are what was known before, in whose units θ is. A parameter is told by the motion if that leaves
less than half of its standard deviation; the others keep the model's values.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.rollout import rollout
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from vgps_ros.core.cores import count_cores
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import are_motors
from vgps_ros.tasks.disturbed_task import body_names, body_number
from vgps_ros.tasks.task import Task

_SECONDS = 0.3  # of a window
_WINDOWS = 48  # at most, of which each fourth only judges
_FEWEST = 8
_GAP = 1.5  # a longer step from state to state than so many usual ones is a gap
_SILENCE = 5.0  # likewise of commands, which drivers hold for a while
_LATEST = 0.15  # largest latency [s]
_LATE, _TURN = 0.05, 0.1  # what was known of the latency [s] and of the IMU's mounting [rad]
_EPS = 1e-4  # perturbation of the finite differences, in units of what was known before
_NOISE = 0.01, 0.2  # of measured positions and velocities, until it is known
_UNKNOWN = 0.05, 1.0  # standard deviation of x̂_w: of positions and of velocities
_COARSE, _FINE, _MOST = 1e-2, 1e-4, 25  # tolerances until σ is known and then, and iterations
_STRANGE = 5.0  # a window whose squared error is so many times the usual one is left out
_STRENGTHS = (-0.15, -0.3, -0.45)  # tried, since a servo that never reaches its limit has no slope
_STRENGTH, _LATENCY, _IMU = 4, 6, slice(7, None)  # places in θ
_MARGIN = 0.05  # by which a model that is right about nothing else may be wrong beside its noise
_ENDS = {"friction_loss": -1.0, "strength": 1.0, "mass": -1.0}  # sides of ranges
_VISCOUS = "N·m·s/rad"
_BOUND = 1e3  # of a residual, so that a window that diverges stays finite


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """What a robot measured and was told, in stamps that go forward.

    Attributes:
        time: of the states, shape (N,) [s].
        states: what was measured, as states x, shape (N, n_x).
        command_time: from which each control counts, shape (M,) [s].
        controls: u, shape (M, n_u).
        is_blind: whether an IMU told of the free base, whose place and velocity then do not count.
    """

    time: Array
    states: Array
    command_time: Array
    controls: Array
    is_blind: bool


class Parameter(NamedTuple):
    """One number that may differ; it is nominal + scale · θ.

    Attributes:
        name: what it is.
        unit: its unit, for people.
        nominal: the model's, the mean of those that are above zero.
        scale: standard deviation of what was known of it before.
        low: smallest θ.
        high: largest θ.
        value: what was found; the nominal one where the motion does not tell.
        std: its standard deviation.
        is_told: whether the motion tells it.
    """

    name: str
    unit: str
    nominal: float
    scale: float
    low: float
    high: float
    value: float = 0.0
    std: float = np.inf
    is_told: bool = False

    @property
    def spread(self) -> float:
        """How far its range reaches to both sides: two deviations, and what no deviation tells."""
        return 2.0 * self.std + _MARGIN * self.value


@dataclass(frozen=True, eq=False)
class IdentifiedRobot:
    """What was found.

    Attributes:
        parameters: all that were looked for, by short names.
        model: the robot with what was found; where a range has one side only, as that of a payload,
            at that end of it from which situations draw.
        body: number of the body whose mass was looked for.
        ranges: settings of a search by which its situations draw what stays uncertain.
        time: of the states of each window that only judges, shape (W, K) [s].
        measured: these states, shape (W, K, n_x).
        before: as the given model predicts them, likewise.
        after: as the model that was found predicts them.
        errors: root mean squares of the joints' positions and velocities in which each is wrong.
        windows: how many told, how many only judged, and how many were left out as strange.
    """

    parameters: dict[str, Parameter]
    model: mujoco.MjModel
    body: int
    ranges: dict[str, Any]
    time: Array
    measured: Array
    before: Array
    after: Array
    errors: tuple[Array, Array]
    windows: tuple[int, int, int]

    @property
    def turns(self) -> list[Parameter]:
        """How the IMU is turned in the base, as a rotation vector; none without an IMU."""
        return [p for name, p in self.parameters.items() if name.startswith("imu_")]


def identify(task: Task, motions: Sequence[MeasuredMotion], body: str = "") -> IdentifiedRobot:
    """Finds what differs.

    Args:
        task: the robot as it is known.
        motions: what it did; there is one at least.
        body: the body whose mass is found; empty: the heaviest one.

    Raises:
        InvalidInputError: there is no such body, or the motions are too short.
    """
    steps = [step for motion in motions for step in np.diff(motion.time)]
    period = float(np.median(steps)) if steps else 1.0
    windows = [window for motion in motions for window in _windows(motion, period)]
    if len(windows) < _FEWEST:
        raise InvalidInputError(
            f"The motion has {len(windows)} stretches of {_SECONDS} s with states and commands "
            f"and without a gap, but at least {_FEWEST} are needed; record some 10 s in which the "
            "robot moves and is commanded."
        )
    number = body_number(task, body)
    robot = _Robot(task, motions[0].is_blind, number)
    windows = [windows[i] for i in np.linspace(0, len(windows) - 1, _WINDOWS).astype(int)]
    windows = list({id(window): window for window in windows}.values())
    telling, judging = [w for i, w in enumerate(windows) if i % 4 != 2], windows[2::4]
    fit = _Fit(robot, telling, np.where(robot.are_positions, *_NOISE))
    theta = fit.solved(robot.start, np.ones(len(robot.start), dtype=bool), _COARSE)
    wrong = np.square(fit.residuals).mean(axis=(1, 2))
    usual = wrong <= _STRANGE * np.median(wrong)
    noise = fit.noise.copy()
    noise[robot.are_measured] *= np.sqrt(np.square(fit.residuals[usual]).mean(axis=(0, 1))) + 1e-6
    kept = [window for window, is_usual in zip(telling, usual, strict=True) if is_usual]
    fit, told = _Fit(robot, kept, noise), np.ones(len(theta), dtype=bool)
    while True:
        theta = fit.solved(theta, told)
        std, prior = fit.uncertainty(theta, told)
        if prior.max(initial=0.0, where=told) < 0.5:
            break
        worst = np.argmax(np.where(told, prior, 0.0))  # others may be told once it stays
        told[worst], theta[worst] = False, 0.0
    judge = _Fit(robot, judging, noise)
    before, after = (judge.predicted(each) for each in (np.zeros(len(theta)), theta))
    places = state_layout(robot.base).joint_places.reshape(2, -1)
    errors = tuple(
        np.array([np.sqrt(np.square((x - judge.measured)[..., each]).mean()) for each in places])
        for x in (before, after)
    )
    found = {
        name: p._replace(value=p.nominal + p.scale * t, std=p.scale * s, is_told=True)
        if is_told
        else p._replace(value=p.nominal)
        for (name, p), t, s, is_told in zip(robot.parameters.items(), theta, std, told, strict=True)
    }
    ends = [
        _ENDS[k] * p.spread / p.scale if k in _ENDS and p.is_told else 0.0 for k, p in found.items()
    ]
    lowest = np.array([p.low for p in found.values()])
    return IdentifiedRobot(
        found,
        robot.model(np.maximum(theta + ends, lowest)),
        number,
        _ranges(found, body),
        *(judge.time, judge.measured, before, after, (errors[0], errors[1])),
        (len(kept), len(judging), len(telling) - len(kept)),
    )


def _ranges(found: Mapping[str, Parameter], body: str) -> dict[str, Any]:
    """Returns the settings by which situations draw what stays uncertain."""
    told = {name: (p.value, p.spread) for name, p in found.items() if p.is_told}
    shares = {name: spread / max(value, 1e-9) for name, (value, spread) in told.items()}
    ranges: dict[str, Any] = {}
    if {"damping", "armature"} <= set(told):
        ranges["disturb.joints"] = min(max(shares["damping"], shares["armature"]), 10.0)
    if "gain" in told:
        ranges["disturb.gain"] = shares["gain"]
    for name, setting in (("friction_loss", "friction_loss"), ("mass", "payload")):
        if name in told:
            ranges[f"disturb.{setting}"] = told[name][1] + min(told[name])
    if "strength" in told:
        value, spread = told["strength"]
        ranges["disturb.strength"] = min(2.0 * spread / (value + spread), 0.99)
    ranges = {name: float(f"{value:.3g}") for name, value in ranges.items()}
    return ranges | ({"disturb.body": body} if body and "mass" in told else {})


class _Window(NamedTuple):
    time: Array  # (K,) [s]
    states: Array  # (K, n_x)
    command_time: Array
    told: Array  # integral of u up to each command, (M, n_u)
    controls: Array


def _windows(motion: MeasuredMotion, period: float) -> list[_Window]:
    """Cuts a motion into windows of as many states each, in which nothing is missing."""
    time, commands = motion.time, motion.command_time
    if len(commands) < 2:
        return []
    silence = _SILENCE * max(period, float(np.median(np.diff(commands))))
    lasting = np.diff(commands, prepend=commands[0])[:, None]
    told = np.cumsum(lasting * np.roll(motion.controls, 1, axis=0), axis=0)
    steps, found = max(round(_SECONDS / period), 1), []
    for first in range(0, len(time) - steps, steps):
        part = slice(first, first + steps + 1)
        t, begin = time[part], time[first] - _LATEST
        i, j = np.searchsorted(commands, (begin, time[first + steps]), "right")
        at = slice(max(i - 1, 0), j)
        quiet = np.diff(np.r_[commands[at], t[-1]]).max(initial=0.0)
        if i and quiet <= silence and np.diff(t).max() <= _GAP * period:
            found.append(
                _Window(t, motion.states[part], commands[at], told[at], motion.controls[at])
            )
    return found


class _Robot:
    """Its parameters, its model with others, and what its sensors tell of a state."""

    def __init__(self, task: Task, is_blind: bool, body: int):
        m = self.base = task.dynamics.model
        self.space, self.is_blind, self._body = task.dynamics.space, is_blind, body
        self._free = state_layout(m).base
        joints = m.actuator_trnid[m.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT), 0]
        inertia = np.where(np.isin(m.dof_jntid, joints), m.dof_M0, 0.0)
        # What a model has none of is expected to be a share of what its joints' inertia suggests.
        self._damping = m.dof_damping if m.dof_damping.any() else inertia
        self._armature = m.dof_armature if m.dof_armature.any() else 0.3 * inertia
        self._friction = np.where(inertia > 0.0, _mean(inertia), 0.0)
        limited = m.actuator_forcelimited > 0
        self._is_limited = limited | (are_motors(m) & (m.actuator_ctrllimited > 0))
        by_control = np.sort(m.actuator_gainprm[:, :1] * m.actuator_ctrlrange, axis=1)
        self._limits = np.where(limited[:, None], m.actuator_forcerange, by_control)
        damping, armature, dry = map(_mean, (m.dof_damping, m.dof_armature, m.dof_frictionloss))
        gain, strength = _mean(task.controls.stiffness), _mean(self._limits[self._is_limited, 1])
        of_gain = ("servos' stiffness", "N·m/rad") if gain else ("motors' gain", "1")
        gain, mass, name = gain or 1.0, float(m.body_mass[body]), body_names(task.mjcf)[body]
        viscous, rotor = 0.95 * bool(damping), 0.95 * bool(armature)
        rows: dict[str, tuple[str, str, float, float, float, float]] = {
            "damping": ("joints' damping", _VISCOUS, damping, _mean(self._damping), viscous, 10),
            "armature": ("rotors' inertia", "kg·m²", armature, _mean(self._armature), rotor, 10),
            "friction_loss": ("dry friction", "N·m", dry, _mean(self._friction), 0, 50),
            "gain": (*of_gain, gain, gain, 0.9, 4),
            "strength": ("largest torque", "N·m", strength, strength, 0.9, 1),
            "mass": (f"mass of {name}", "kg", mass, mass, 0.9, 4),
            "latency": ("latency", "s", 0.0, _LATE, 0, _LATEST / _LATE),
        }
        for axis in ("roll", "pitch", "yaw") if is_blind else ():
            rows[f"imu_{axis}"] = (f"IMU's {axis}", "rad", 0.0, _TURN, 8, 8)
        self.parameters = {key: Parameter(*row)._replace(low=-row[4]) for key, row in rows.items()}
        self.start = np.array([0.2 if p.low == 0 else 0.0 for p in self.parameters.values()])
        at = np.arange(self.space.tangent_dim)
        self.are_positions, self.are_measured = at < m.nv, np.ones(len(at), dtype=bool)
        if self._free and is_blind:
            place = self._free.first_velocity - m.nq + np.arange(3)
            self.are_measured[[place, m.nv + place]] = False

    def model(self, theta: Array) -> mujoco.MjModel:
        """Returns the model with θ."""
        m, (damping, armature, friction, gain, strength, mass, *_) = copy(self.base), theta
        m.dof_damping[:] += damping * self._damping
        m.dof_armature[:] += armature * self._armature
        m.dof_frictionloss[:] += friction * self._friction
        m.actuator_gainprm[:, 0] *= 1.0 + gain
        m.actuator_biasprm[:, :3] *= 1.0 + gain
        if strength:
            on = self._is_limited
            m.actuator_forcelimited[on] = 1
            m.actuator_forcerange[on] = (1.0 + strength) * self._limits[on]
        m.body_mass[self._body] *= 1.0 + mass
        m.body_inertia[self._body] *= 1.0 + mass
        mujoco.mj_setConst(m, mujoco.MjData(m))
        return m

    def sensed(self, states: Array, theta: Array) -> Array:
        """Returns h(x), shape (..., n_x): how the IMU is turned, and its rates, are the base's."""
        if not (self.is_blind and self._free and theta[_IMU].any()):
            return states
        y, mount = states.copy(), Rotation.from_rotvec(_TURN * theta[_IMU])
        _, quaternion, _, rate = self._free.parts(y)
        turned = Rotation.from_quat(quaternion.reshape(-1, 4), scalar_first=True) * mount
        quaternion[:] = turned.as_quat(scalar_first=True).reshape(quaternion.shape)
        rate[:] = rate @ mount.as_matrix()
        return y

    def guess(self, x: Array) -> Array:
        """Returns a state (n_x,) with the lowest part of a blind robot on the floor, at rest."""
        m, floors = self.base, np.flatnonzero(self.base.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        if not (self.is_blind and self._free and floors.size):
            return x
        data, x = mujoco.MjData(m), x.copy()
        position, _, linear, _ = self._free.parts(x)
        position[:] = 0.0, 0.0, 10.0
        mujoco.mj_setState(m, data, np.r_[0.0, x], mujoco.mjtState.mjSTATE_FULLPHYSICS)
        mujoco.mj_forward(m, data)
        ends = np.zeros((m.ngeom, 6))
        near = [
            mujoco.mj_geomDistance(m, data, floors[0], geom, 100.0, ends[geom])
            if m.geom_contype[geom] | m.geom_conaffinity[geom] and geom not in floors else np.inf
            for geom in range(m.ngeom)
        ]  # fmt: skip
        lowest = int(np.argmin(near))
        if np.isfinite(near[lowest]):
            moved = np.zeros((3, m.nv))
            mujoco.mj_jac(m, data, moved, None, ends[lowest, 3:], m.geom_bodyid[lowest])
            position[2] -= near[lowest]
            linear[:] -= moved @ data.qvel
        return x


def _mean(values: Array) -> float:
    """Returns the mean of those above zero; 0 if there are none."""
    return float(values[values > 0.0].mean()) if (values > 0.0).any() else 0.0


class _Fit:
    """Solves (1) over some windows.

    Attributes:
        noise: σ, shape (n_dx,).
        time: of the windows' states, shape (W, K) [s].
        measured: these states, shape (W, K, n_x).
        residuals: of what is measured, (W, K, m), where it was last solved.
    """

    def __init__(self, robot: _Robot, windows: Sequence[_Window], noise: Array):
        self._robot, self._windows, self.noise = robot, windows, noise
        self.time = np.array([window.time for window in windows])
        self.measured = np.array([window.states for window in windows])
        self._guess = np.array([robot.guess(x) for x in self.measured[:, 0]])
        self._unknown = np.where(robot.are_positions, *_UNKNOWN)
        self._dt = robot.base.opt.timestep
        ends = (self.time - self.time[:, :1]) / self._dt
        self._before = np.floor(ends + 1e-9).astype(int)
        self._share = (ends - self._before)[..., None]
        self._steps = int(self._before.max()) + 1
        self._data = [mujoco.MjData(robot.base) for _ in range(count_cores())]
        self._first = np.zeros((len(windows), len(noise)))  # δ of x_w = x̂_w ⊕ δ, in its units
        self.residuals = np.empty(0)

    def _controls(self, latency: float) -> Array:
        """Returns the mean control of each simulator step, shape (W, n, n_u)."""
        found = []
        for window in self._windows:
            ends = window.time[0] - latency + self._dt * np.arange(self._steps + 1)
            at = np.searchsorted(window.command_time, ends, "right") - 1
            passed = (ends - window.command_time[at])[:, None]
            integral = window.told[at] + passed * window.controls[at]
            found.append(np.diff(integral, axis=0) / self._dt)
        return np.array(found)

    def _states(self, thetas: Array, firsts: Array) -> Array:
        """Returns the states of the windows, (C, W, K, n_x), by θ (C, P) and δ (C, W, n_dx)."""
        robot, (count, of) = self._robot, firsts.shape[:2]
        models, controls = list[mujoco.MjModel](), list[Array]()
        for i, theta in enumerate(thetas):
            same = i and np.array_equal(theta, thetas[i - 1])
            models.append(models[-1] if same else robot.model(theta))
            controls.append(controls[-1] if same else self._controls(_LATE * theta[_LATENCY]))
        x = robot.space.add(self._guess, self._unknown * firsts).reshape(count * of, -1)
        start = np.concatenate([np.zeros((len(x), 1)), x], axis=1)
        each = [model for model in models for _ in range(of)]
        along, _ = rollout(each, self._data, start, np.concatenate(controls))
        along = np.concatenate([start[:, None], along], axis=1)[..., 1:]
        along = np.nan_to_num(along).reshape(count, of, self._steps + 1, -1)
        window = np.arange(of)[:, None]
        before, after = (along[:, window, self._before + side] for side in (0, 1))
        return before + self._share * (after - before)

    def _residuals(self, thetas: Array, firsts: Array) -> Array:
        """Returns the residuals of what is measured, shape (C, W, K, m)."""
        robot, states = self._robot, self._states(thetas, firsts)
        sensed = [robot.sensed(x, theta) for x, theta in zip(states, thetas, strict=True)]
        wrong = robot.space.subtract(np.array(sensed), self.measured) / self.noise
        return np.clip(wrong[..., robot.are_measured], -_BOUND, _BOUND)

    def _settle(self, theta: Array) -> Array:
        """Finds δ by a Gauss-Newton step; returns the residuals by its columns, (W, K·m, n_dx)."""
        of, n = self._first.shape
        moved = np.concatenate([np.zeros((1, n)), _EPS * np.eye(n)])
        found = self._residuals(np.tile(theta, (n + 1, 1)), self._first + moved[:, None])
        found = found.reshape(n + 1, of, -1)
        slopes = np.moveaxis((found[1:] - found[0]) / _EPS, 0, -1)
        normal = np.swapaxes(slopes, 1, 2) @ slopes + np.eye(n)
        down = (np.swapaxes(slopes, 1, 2) @ found[0, ..., None])[..., 0] + self._first
        self._first = self._first - np.linalg.solve(normal, down[..., None])[..., 0]
        return slopes

    def _settled(self, theta: Array) -> Array:
        """Returns the values of (1), whose squares it adds up, after some steps of δ."""
        self._value(theta)
        return self._value(theta)

    def _value(self, theta: Array) -> Array:
        """Returns them after one step of δ, as it goes on from the last one."""
        self._slopes = self._settle(theta)
        self.residuals = self._residuals(theta[None], self._first[None])[0]
        return np.concatenate([self.residuals.ravel(), self._first.ravel(), theta])

    def _jacobian(self, theta: Array, free: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Returns the outer Jacobian by window, of residuals (W, K·m, p) and of δ (W, n_dx, p)."""
        of, n = self._first.shape
        moved = theta + _EPS * np.eye(len(theta))[free]
        found = self._residuals(moved, np.tile(self._first, (len(moved), 1, 1)))
        slopes = (found - self.residuals) / _EPS
        slopes = np.moveaxis(slopes.reshape(len(moved), of, -1), 0, -1)
        across = np.swapaxes(self._slopes, 1, 2)
        follows = -np.linalg.solve(across @ self._slopes + np.eye(n), across @ slopes)
        return np.asarray(slopes + self._slopes @ follows), np.asarray(follows)

    def solved(self, theta: Array, free: NDArray[np.bool_], tolerance: float = _FINE) -> Array:
        """Returns the best θ from one on, to a relative change; those that are not free stay."""
        low, high = np.array([(p.low, p.high) for p in self._robot.parameters.values()]).T[:, free]
        p = int(free.sum())

        def whole(values: Array) -> Array:
            found = theta.copy()
            found[free] = values
            return found

        def jacobian(values: Array) -> Array:
            parts = self._jacobian(whole(values), free)
            return np.concatenate(
                [*(each.reshape(-1, p) for each in parts), np.eye(len(theta))[:, free]]
            )

        def search(start: Array) -> tuple[float, Array]:
            inside = np.clip(start[free], low + 1e-3, high - 1e-3)
            self._settled(whole(inside))
            found = least_squares(
                lambda values: self._value(whole(values)), inside, jacobian, (low, high),
                xtol=tolerance, ftol=tolerance, max_nfev=_MOST,
            )  # fmt: skip
            return float(found.cost), whole(found.x)

        cost, best = search(theta)
        if free[_STRENGTH] and not best[_STRENGTH]:
            weaker = np.tile(best, (len(_STRENGTHS), 1))
            weaker[:, _STRENGTH] = _STRENGTHS
            costs = [0.5 * np.square(self._settled(each)).sum() for each in weaker]
            if min(costs) < 1.5 * cost:
                best = min(
                    (cost, best), search(weaker[np.argmin(costs)]), key=lambda pair: pair[0]
                )[1]
        return best

    def uncertainty(self, theta: Array, free: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Returns standard deviations of θ, shape (P,): of what windows tell, and with the prior's.

        Errors of a window go together where the model is wrong, so windows are what is counted.
        """
        self._value(theta)
        slopes = np.concatenate(self._jacobian(theta, free), axis=1)
        wrong = np.concatenate([self.residuals.reshape(len(slopes), -1), self._first], axis=1)
        inverse = np.linalg.inv(
            (np.swapaxes(slopes, 1, 2) @ slopes).sum(axis=0) + np.eye(int(free.sum()))
        )
        pulls = (np.swapaxes(slopes, 1, 2) @ wrong[..., None])[..., 0]
        spread = inverse @ pulls.T @ pulls @ inverse * len(pulls) / max(len(pulls) - 1, 1)
        std, prior = np.full(len(theta), np.inf), np.full(len(theta), np.inf)
        prior[free] = np.sqrt(np.diag(inverse))
        std[free] = np.maximum(prior[free], np.sqrt(np.diag(spread)))
        return std, prior

    def predicted(self, theta: Array) -> Array:
        """Returns what the sensors should tell, shape (W, K, n_x), from the best first states."""
        self._first[:] = 0.0
        self._settled(theta)
        return self._robot.sensed(self._states(theta[None], self._first[None])[0], theta)
