# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The motion from which a task's first solve starts: drawn, held by a law, a path, or recorded."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np

from vgps_ros.core.checks import find_name, matching_names
from vgps_ros.core.ddp.solve import Status, solve
from vgps_ros.core.ddp.tracking import track
from vgps_ros.core.errors import DivergenceError, InvalidInputError, at_entry, refuse_if
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.core.slow_steps import progress_lines
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.robot.executed_control import Driver
from vgps_ros.simulation.controls import resting_controls
from vgps_ros.simulation.model import joint_names, state_names
from vgps_ros.tasks.motion_table import load_demonstration, read_columns, read_rows
from vgps_ros.tasks.sampled_motion import FALLEN, Arrival, SampledMotion, Sampler, half_ranges
from vgps_ros.tasks.schema import (
    Begin,
    BestMotion,
    Noise,
    PathMotion,
    Pd,
    Pose,
    RecordedMotion,
    Sampling,
)
from vgps_ros.tasks.task import FirstMotion, Nominal, Task
from vgps_ros.tasks.task_file import file_inside

_MOST_DAMPING = 0.5  # of what stops a joint within one control; more makes a held torque unstable


def with_beginning(task: Task, entry: Begin, folder: Path) -> Task:
    """Returns the task with the first motion that its file in a folder describes.

    Raises:
        InvalidInputError: the entry does not fit the model.
    """
    begin: FirstMotion
    if isinstance(entry, RecordedMotion):
        with at_entry("file"):
            return with_demonstration(task, file_inside(folder, entry.file))
    if isinstance(entry, Pd):
        begin = FunctionMotion(partial(_execute, _pd_law(task, entry)))
    elif isinstance(entry, Sampling):
        begin = _sampling_search(task, entry)
    elif isinstance(entry, PathMotion):
        begin = AlongPath(_path_states(task, entry, folder))
    elif isinstance(entry, BestMotion):
        begin = _several(task, entry)
    elif isinstance(entry, Noise):
        std, n_u = np.array(entry.std), task.dynamics.control_dim
        refuse_if(
            std.size not in (1, n_u),
            f"it has {std.size} values, but the model has {n_u} actuators.",
            "std",
        )
        begin = RandomControls(std, entry.time_constant)
    else:
        begin = RandomControls()
    return replace(task, begin=begin)


def with_demonstration(task: Task, path: Path) -> Task:
    """Returns the task with the demonstration of a file.

    It starts from the first state of a recorded motion. A policy drives it from its own start.

    Raises:
        InvalidInputError: the file is unreadable, or names, rate or size do not fit the task; or it
            is a policy that does not fit the robot, or whose motion diverges.
    """
    if path.suffix not in (".onnx", ".json"):  # of policies
        recorded = load_demonstration(task, path)
        return replace(task, begin=TrackedMotion(recorded), initial_state=recorded.states[0])
    drive = partial(_driven, driver_of(task.deployment, open_policy(path)))
    shown = drive(task, task.initial_state, task.planned_horizon)
    sound = np.isfinite(shown.states).all(axis=1)
    if not sound.all():
        seconds = sound.argmin() * task.dynamics.time_step
        raise InvalidInputError(
            f"The motion of '{path}' diverges after {seconds:.2f} s, so no training can start from "
            "it; check the metadata's joint_names, observation_names and action_scale."
        )
    return replace(task, begin=TrackedMotion(shown, FunctionMotion(drive)))


@dataclass(frozen=True)
class RandomControls:
    """Executes controls that do not look at the state: zero, or smooth noise.

    Attributes:
        std: standard deviation of each control, shape (1,) or (n_u,), [N·m]; None: zero.
        time_constant: time over which they vary [s].
    """

    std: Array | None = None
    time_constant: float = 0.5
    goes_on: ClassVar[bool] = False

    def controls(self, task: Task, steps: int, rng: np.random.Generator) -> Array:
        """Returns controls within their limits, shape (steps, n_u)."""
        controls = np.zeros((steps, task.dynamics.control_dim))
        if self.std is not None:
            time_constant = self.time_constant / task.dynamics.time_step
            controls = self.std * smoothed_noise(rng, controls.shape, 1.0, time_constant)
        return np.clip(controls, *task.dynamics.control_limits)

    def __call__(
        self, task: Task, start: Array, steps: int, rng: np.random.Generator, *_: Any
    ) -> Nominal:
        """Returns the rollout of the controls."""
        controls, dynamics = self.controls(task, steps, rng), task.dynamics
        rollout = dynamics.rollout(start, lambda t, _: controls[t], steps)
        return Nominal(rollout, steps * dynamics.substeps)


@dataclass(frozen=True)
class AlongPath:
    """Goes through given states, with servos at rest at the start; the solve closes the gaps.

    Attributes:
        states: they need not satisfy the dynamics, shape (T+1, n_x).
    """

    states: Array
    goes_on: ClassVar[bool] = False

    def __call__(
        self, task: Task, start: Array, steps: int, rng: np.random.Generator, *_: Any
    ) -> Nominal:
        """Returns the path, which begins at the start."""
        states = np.concatenate([start[None], self.states[1 : steps + 1]])
        rest = task.dynamics.controls.resting(start)
        return Nominal.guessed(Trajectory(states, np.tile(rest, (steps, 1))), task.dynamics)


@dataclass(frozen=True)
class FunctionMotion:
    """A motion that a function makes, from any start and for as long as it is asked to.

    Attributes:
        make: maps the task, x_1 (n_x,) and a number of steps to the motion. It is known before the
            training, so that its simulator steps do not count as learning.
    """

    make: Callable[[Task, Array, int], Trajectory]
    goes_on: ClassVar[bool] = True

    def __call__(self, task: Task, start: Array, steps: int, *_: Any) -> Nominal:
        """Returns the motion."""
        return Nominal(self.make(task, start, steps))


@dataclass(frozen=True)
class TrackedMotion:
    """A recorded motion, which a rollout follows.

    Attributes:
        motion: x̄, ū over the planned horizon.
        elsewhere: makes the motion from other starts, or for longer; None: the rollout follows the
            recorded one from there too.
    """

    motion: Trajectory
    elsewhere: FirstMotion | None = None

    @property
    def goes_on(self) -> bool:
        """Whether the motion from other starts goes on."""
        return self.elsewhere is not None and self.elsewhere.goes_on

    def __call__(self, task: Task, start: Array, steps: int, *rest: Any) -> Nominal:
        """Returns the rollout."""
        shown = self.motion.first(steps)
        here = np.array_equal(start, shown.states[0]) and shown.horizon == steps
        if self.elsewhere and not here:
            return self.elsewhere(task, start, steps, *rest)
        tolerance = task.optimizer.demonstration_tolerance
        return Nominal(*track(task.dynamics, shown, start, task.position_names, tolerance))


@dataclass(frozen=True, eq=False)
class Best:
    """The best of several motions after a few iterations of DDP.

    Each step in which the robot lies costs more than any motion. From other starts than the task's
    the best one's law goes on, or the motion is a guess whose gap at the start the solve closes.

    Attributes:
        task: the task, in whose own context and from whose start they are compared.
        candidates: what makes them.
        iterations: iterations of DDP on each; the better half gets twice as many more, and so on.
    """

    task: Task
    candidates: tuple[FirstMotion, ...]
    iterations: int
    _choice: list[tuple[FirstMotion, Trajectory]] = field(default_factory=list, init=False)
    goes_on: ClassVar[bool] = False

    def choose(
        self, is_cancelled: Callable[[], bool] = lambda: False
    ) -> tuple[FirstMotion, Trajectory]:
        """Returns the one that is best, and its motion from the task's start.

        After cancellation it is the best one so far, and the next call compares them anew.
        """
        if self._choice:
            return self._choice[0]
        choice = self._compare(is_cancelled)
        if not is_cancelled():
            self._choice.append(choice)
        return choice

    def _compare(self, is_cancelled: Callable[[], bool]) -> tuple[FirstMotion, Trajectory]:
        task, iterations = self.task, self.iterations
        rounds = len(self.candidates).bit_length()
        report = progress_lines(f"Tries first motions of {task.name}")
        left = list[tuple[float, int, Nominal]]()
        for i, candidate in enumerate(self.candidates):
            if left and is_cancelled():
                break
            rng = np.random.default_rng(0)
            first = candidate(task, task.initial_state, task.planned_horizon, rng, is_cancelled)
            left.append((np.inf, i, first))
            report(0.5 * (i + 1) / len(self.candidates))
        for count in range(rounds):
            for done, (_, i, motion) in enumerate(left):
                left[done] = self._solved(motion, iterations, i, is_cancelled)
                report(0.5 + 0.5 * (count + (done + 1) / len(left)) / rounds)
            left.sort(key=itemgetter(0, 1))
            left = left[: max(1, len(left) // 2)]
            iterations *= 2
        return self.candidates[left[0][1]], left[0][2].trajectory

    def _solved(
        self, motion: Nominal, iterations: int, i: int, is_cancelled: Callable[[], bool]
    ) -> tuple[float, int, Nominal]:
        task = self.task
        try:
            solution = solve(
                *(task.dynamics, task.cost, motion.trajectory, task.optimizer.ddp, iterations),
                gaps=motion.gaps,
                is_cancelled=is_cancelled,
            )
        except DivergenceError:
            return np.inf, i, motion
        if motion.gaps is not None and solution.status is Status.CANCELLED:  # a guess still
            return np.inf, i, motion
        fallen = task.fallen(solution.trajectory.states).sum()
        return solution.cost + FALLEN * fallen, i, Nominal(solution.trajectory)

    def __call__(
        self,
        task: Task,
        start: Array,
        steps: int,
        rng: np.random.Generator,
        is_cancelled: Callable[[], bool] = lambda: False,
    ) -> Nominal:
        """Returns the motion, whose simulator steps do not count as learning."""
        law, motion = self.choose(is_cancelled)
        if steps == motion.horizon and np.array_equal(start, motion.states[0]):
            return Nominal(motion)
        if law.goes_on:
            return law(task, start, steps, rng, is_cancelled)
        states = np.concatenate([start[None], motion.states[1 : steps + 1]])
        return Nominal.guessed(Trajectory(states, motion.controls[:steps]), task.dynamics)


def _several(task: Task, entry: BestMotion) -> Best:
    """Returns the motions of which the best one is chosen."""
    low, high = task.dynamics.control_limits
    still = np.tile(_at_rest(task), (task.planned_horizon + 1, 1))
    held = FunctionMotion(partial(_execute, _pd_law(task, Pd())))
    half = half_ranges(low, high)
    noisy = [RandomControls(share * half, time) for share in (0.1, 0.3, 1.0) for time in (0.1, 0.5)]
    arriving = [Arrival(window, seed) for window in (0.3, 0.6, 1.0) for seed in (0, 1)]
    # And short plans, one after another, for what is struck or turned again and again:
    step, std = task.dynamics.time_step, tuple(half.tolist())
    plan, period = max(0.5, step), max(0.05, step)
    short = Sampling(plan=plan, period=period, samples=64, knots=8, std=std)
    going_on = _sampling_search(task, short, iterations=4, ddp_iterations=0)
    return Best(task, (held, AlongPath(still), *noisy, *arriving, going_on), entry.iterations)


def _execute(
    law: Callable[[int, Array], Array], task: Task, start: Array, steps: int
) -> Trajectory:
    return task.dynamics.rollout(start, law, steps)


def _driven(driver: Driver, task: Task, start: Array, steps: int) -> Trajectory:
    """Returns the motion of a policy without its noise."""
    context, mean = task.planned_context, driver.new_law()

    def law(t: int, x: Array) -> Array:
        told = driver.observation.within(context[min(t, len(context) - 1)])
        return mean(told(x))

    return task.dynamics.rollout(start, law, steps)


def smoothed_noise(
    rng: np.random.Generator, shape: tuple[int, int], amplitude: float, time_constant: float
) -> Array:
    """Draws controls that vary smoothly: white noise through a first-order filter.

    Args:
        rng: source of the draw.
        shape: (T, n_u).
        amplitude: stationary standard deviation [N·m].
        time_constant: time constant of the filter, in steps.
    """
    decay = np.exp(-1.0 / time_constant)
    noise = amplitude * rng.standard_normal(shape)
    for t in range(1, shape[0]):
        noise[t] = decay * noise[t - 1] + np.sqrt(1.0 - decay**2) * noise[t]
    return noise


def _pd_law(task: Task, begin: Pd) -> Callable[[int, Array], Array]:
    """Returns the law of controls that hold a pose; it maps states (N, n_x) to (N, n_u).

    A motor gets the torque stiffness · (pose − position) − damping · velocity. A servo of positions
    gets the target by which it rests there, and what pulls at no joint, such as a rotor, what holds
    up the weight.
    """
    model: mujoco.MjModel = task.dynamics.model
    with at_entry("pose"):
        data = pose_data(model, task.initial_state, begin.pose or "start")
    of_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    joints = np.where(of_joint, model.actuator_trnid[:, 0], 0)
    of_joint &= model.jnt_type[joints] >= int(mujoco.mjtJoint.mjJNT_SLIDE)  # or a hinge
    joints = np.where(of_joint, joints, 0)
    places, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    mass = inertia[dofs, dofs]
    names = [model.joint(j).name for j in joints]
    weight = model.body_subtreemass[0] * np.linalg.norm(model.opt.gravity)
    suited = np.where(of_joint, weight * model.stat.extent / 4 + mass, 0.0)
    stiffness = _by_joint(begin.stiffness, suited, names, "stiffness")
    # The implicit part of the integration does not see these torques, so they must be mild.
    mild = np.minimum(2 * np.sqrt(stiffness * mass), _MOST_DAMPING * mass / task.dynamics.time_step)
    damping = _by_joint(begin.damping, mild, names, "damping")
    strength = model.actuator_gainprm[:, 0] * model.actuator_gear[:, 0]
    is_servo = model.actuator_biasprm[:, 1] != 0
    is_plain = (model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_FIXED)) & (
        model.actuator_dyntype == int(mujoco.mjtDyn.mjDYN_NONE)
    )
    lift = _lift(data, model.actuator_gainprm[:, 0] * (is_plain & ~of_joint & ~is_servo))
    held = np.where(is_servo, resting_controls(data), lift)
    pose, limits = data.qpos[places].copy(), task.dynamics.control_limits

    def law(_: int, x: Array) -> Array:
        torques = stiffness * (pose - x[:, places]) - damping * x[:, model.nq + dofs]
        motors = np.where(of_joint & (strength != 0), torques / np.where(strength, strength, 1), 0)
        return np.clip(np.where(is_servo | ~of_joint, held, motors), *limits)

    return law


def _lift(data: mujoco.MjData, strength: Array) -> Array:
    """Returns the controls with which actuators hold up what they pull at, shape (n_u,).

    Actuators with zero gain are skipped.
    """
    model = data.model
    moment = np.zeros((model.nu, model.nv))
    rows = (data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    mujoco.mju_sparse2dense(moment, data.actuator_moment.ravel(), *rows)
    pulls = moment.T * strength
    pulled = np.abs(pulls).max(axis=1, initial=0.0) > 0
    held: Array = np.linalg.lstsq(pulls[pulled], data.qfrc_bias[pulled], rcond=None)[0]
    return held


def pose_data(model: mujoco.MjModel, start: Array, pose: Pose) -> mujoco.MjData:
    """Returns the data of a pose: the start, a keyframe, or the start but for some joints.

    Raises:
        InvalidInputError: the model has no such keyframe or joint.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = start[: model.nq]
    if isinstance(pose, dict):
        for pattern, position in pose.items():
            with at_entry(pattern):
                for name in matching_names("hinge or slide", pattern, joint_names(model)):
                    data.joint(name).qpos[:] = position
    elif pose != "start":
        data.qpos[:] = model.key_qpos[keyframe(model, pose)]
    mujoco.mj_forward(model, data)
    return data


def _by_joint(given: Any, default: Array, names: list[str], key: str) -> Array:
    """Returns a value for each control: one for all, or by its joint's name or pattern."""
    if given is None:
        return default
    if not isinstance(given, dict):
        return np.full(len(names), float(given))
    values = default.copy()
    for pattern, value in given.items():
        with at_entry(key, pattern):
            found = matching_names("driven joint", pattern, names)
        values[[i for i, name in enumerate(names) if name in found]] = value
    return values


def _sampling_search(
    task: Task, begin: Sampling, iterations: int = 2, ddp_iterations: int = 5
) -> SampledMotion:
    """Returns what finds a motion by so many rounds of samples, and of DDP, for each plan."""
    step = task.dynamics.time_step
    for key, time in (("plan", begin.plan), ("period", begin.period)):
        refuse_if(
            time < step,
            f"it is {time:g} s, but it must be at least the control_period, {step:g} s.",
            key,
        )
    refuse_if(
        begin.period > begin.plan,
        f"it is {begin.period:g} s, but a plan of {begin.plan:g} s has no more to execute.",
        "period",
    )
    low, high = task.dynamics.control_limits
    return SampledMotion(
        Sampler(
            steps=round(begin.plan / step),
            knots=begin.knots,
            samples=begin.samples,
            iterations=iterations,
            std=_std(begin, low, high),
            low=low,
            high=high,
        ),
        round(begin.period / step),
        ddp_iterations,
    )


def _std(begin: Sampling, low: Array, high: Array) -> Array:
    """Returns the standard deviation of each control's samples, shape (n_u,)."""
    if begin.std is None:
        refuse_if(
            bool(np.isinf(high - low).any()),
            "a control of the model has no range; give `std`, the standard deviation of the "
            "samples [N·m], or a ctrlrange (changes: actuators: limit).",
        )
        return np.asarray(begin.noise * (high - low) / 2)
    std = np.array(begin.std)
    refuse_if(
        std.size not in (1, low.size),
        f"it has {std.size} values, but the model has {low.size} actuators.",
        "std",
    )
    return np.broadcast_to(std, low.shape).astype(float)


def _path_states(task: Task, begin: PathMotion, folder: Path) -> Array:
    """Returns the states of a path over the planned horizon, shape (T+1, n_x).

    Positions are those of the path, velocities are their differences over time, and activations
    are zero.
    """
    states = np.tile(_at_rest(task), (task.planned_horizon + 1, 1))
    if begin.file is not None:
        with at_entry("file"):
            _put_recorded(task, file_inside(folder, begin.file), states)
    n_q, n_v = task.dynamics.model.nq, task.dynamics.model.nv
    space, period = task.dynamics.space, task.dynamics.time_step
    moves = space.subtract(states[1:], states[:-1])[:, :n_v]
    states[:, n_q : n_q + n_v] = np.concatenate([moves, moves[-1:]]) / period
    return states


def _put_recorded(task: Task, path: Path, states: Array) -> None:
    """Puts the positions that a file has into states (T+1, n_x)."""
    model = task.dynamics.model
    positions = state_names(model)[: model.nq]
    header, _ = read_rows(path)
    names = [name for name in positions if name in header]
    if not names:
        raise InvalidInputError(
            f"{path.name} has none of the columns {', '.join(positions)}; name them time and "
            "JOINT/position."
        )
    times = task.dynamics.time_step * np.arange(len(states))
    states[:, [positions.index(name) for name in names]] = read_columns(path, names, times)
    for state in states:
        mujoco.mj_normalizeQuat(model, state[: model.nq])


def _at_rest(task: Task) -> Array:
    """Returns the start without its velocities and activations, shape (n_x,)."""
    state = task.initial_state.copy()
    state[task.dynamics.model.nq :] = 0.0
    return state


def keyframe(model: mujoco.MjModel, wanted: str | int) -> int:
    """Returns the number of a keyframe.

    Raises:
        InvalidInputError: the model has none of this name or number.
    """
    names = [model.key(i).name or str(i) for i in range(model.nkey)]
    if isinstance(wanted, int) and wanted < model.nkey:
        return wanted
    return names.index(find_name("keyframe", str(wanted), names))
