# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a look over a task finds: its cost, derivatives, DDP's progress, and what looks wrong."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from vgps_ros.core.checks import list_names
from vgps_ros.core.ddp.solve import Iteration
from vgps_ros.core.errors import VgpsError
from vgps_ros.core.records import Array, LinearDynamics, Trajectory, TrajectoryDistribution
from vgps_ros.robot.controls import Mask
from vgps_ros.search.judgement import CommandReadings
from vgps_ros.search.optimization_request import OptimizationRequest, first_request, initial_motion
from vgps_ros.search.settings import search_settings
from vgps_ros.search.situations import check_situations
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.tasks import Task
from vgps_ros.tasks.first_motion import Best
from vgps_ros.tasks.task import Nominal

_POINTS = 40  # steps whose derivatives are compared with centred differences
_HARD = 1e-2  # error of a derivative from which on contact is too hard
_AT_LIMIT = 0.1  # share of the steps in which a control may be at its limit
_SMALL = 1e-3  # an iteration of DDP that brings a smaller share of the cost is the last one
_DEEP = 0.05  # depth from which on geoms overlap, as a share of the model's extent
_DIVES = 1.5  # how much faster than usual the centre of mass sinks, if the motion dives
_WILD = 5.0  # noise from which on, as a multiple of half a control's range, its limits rule
_NOWHERE = 0.9  # share of what it costs to do nothing from which on a motion goes nowhere
_FAR = 0.7  # share of the start's cost from which on a step at the end is as far from the goal
_NEAR = 0.1  # share of it up to which the motion has arrived, so that little is left to improve
_MUCH = 0.1  # share of the cost from which on a part of it is what the task is for
_UNTOUCHED = 0.5  # share of the steps in which a reading stays as it was, if nothing touches it
_PER_COMMAND = 10  # most iterations of DDP for each command
_STANDS = 0.5  # share of a command that DDP's motion misses, if it does little of it
_UNMOVED = 1e-9  # a reading that all controls together move by less does not count as moved


@dataclass
class TaskCheck:
    """The findings about a task."""

    # Each part of the cost: its name, what it costs along the first and the optimised motion.
    parts: list[tuple[str, float, float]] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)  # at first, and after each iteration of DDP
    is_guess: bool = False  # whether the first motion is one that no robot can follow, as a path
    seconds: float = 0.0  # wall time of all iterations
    errors: list[float] = field(default_factory=list)  # of the derivatives, of the largest entry
    # Each command alone, at an end of its range: its name, unit, value, and what DDP's motion does.
    commands: list[tuple[str, str, float, float]] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)  # a sentence on each
    notes: list[str] = field(default_factory=list)  # what may be meant
    optimized: Trajectory | None = None


def examine_task(
    task: Task,
    iterations: int,
    seed: int,
    on_iteration: Callable[[int, float], None],
    seconds: float = np.inf,
) -> TaskCheck:
    """Looks a task over.

    `on_iteration` is called with the number of each iteration and the cost after it. The choice of
    a first motion, DDP, and the look at each command end after so many seconds each.

    Raises:
        InvalidInputError: the task's settings of the policy search are out of range, or do not
            suit its robot.
    """
    settings = search_settings(task)
    check_situations(task, settings, seed)
    found = TaskCheck(troubles=_examine_start(task))
    request = first_request(task, seed, iterations)
    nominal = _find_first_motion(task, request, seconds, found)
    if nominal is None:
        return found
    first = nominal.trajectory
    rest = np.clip(task.cost.control_targets, *task.dynamics.control_limits)
    still = task.dynamics.rollout(task.initial_state, lambda *_: rest, first.horizon)
    found.notes += _nothing_to_do(task, still)
    if too_slow := _slow_derivatives(task, first, seconds):
        found.troubles += too_slow
        return found
    linear, _ = task.dynamics.linearize(first)
    is_unmoved = _find_unmoved(task, first, linear)
    found.troubles += [
        f"No control moves the cost's {name}: is it the right sensor, does the robot touch what it "
        "measures, and are the actuators strong enough?"
        for name in np.array(task.cost_names)[is_unmoved]
    ]
    if not found.is_guess:
        found.errors = derivative_errors(task, first)
        found.troubles += explain_inexact_derivatives(task, found.errors)
    start = replace(nominal, linear_dynamics=linear)
    q = _optimize(task, request, start, on_iteration, seconds, found)
    if found.is_guess:  # whose feet rest just where contact begins, where no derivative exists
        found.errors = derivative_errors(task, found.optimized or first)
        found.troubles += explain_inexact_derivatives(task, found.errors)
    names = [*task.cost_names, "controls"]
    costs = (_cost_parts(task, motion) for motion in (first, found.optimized or first))
    found.parts = list(zip(names, *costs, strict=True))
    if q:
        alpha, cost = settings.alphas[0], task.cost.values(still)
        found.troubles += [
            *_excessive_noise(task, q, alpha),
            *_examine_result(task, q.mean, found, cost),
        ]
        found.troubles += _name_untouched(task, q.mean, is_unmoved)
        found.commands = _measure_commands(task, request, q.mean, on_iteration, seconds)
        found.troubles += [
            f"Commanded {value:.3g} {unit} {name}, DDP's motion does {does:.3g}: give the reading "
            "that follows this command more weight or controls less (cost), or command less "
            "(commands)."
            for name, unit, value, does in found.commands
            if abs(does - value) > _STANDS * abs(value)
        ]
    return found


def _find_first_motion(
    task: Task, request: OptimizationRequest, seconds: float, found: TaskCheck
) -> Nominal | None:
    """Returns the task's first motion, and notes how it went; None where there is none."""
    is_late = _timer(seconds)
    try:
        nominal = initial_motion(task.in_context(request.situation.context), request, is_late)
        first, found.is_guess = nominal.trajectory, nominal.gaps is not None
        found.costs.append(float(task.cost.values(first).sum()))
    except VgpsError as error:
        found.troubles.append(f"The first rollout fails: {error}")
        return None
    if not (np.isfinite(first.states).all() and np.isfinite(found.costs[0])):
        found.troubles.append(
            "The first rollout diverges: begin with smaller controls (begin: std), add damping "
            '(changes: {joints: {"*": {damping: 1.0}}}), or choose a shorter time step.'
        )
        return None
    if is_late():
        found.notes.append(
            f"the choice of a first motion (begin) ended after {seconds:g} s, so what follows is "
            "of the best one so far; raise --seconds."
        )
    return nominal


def _timer(seconds: float) -> Callable[[], bool]:
    """Returns a function that says whether so many seconds have passed since now."""
    end = time.perf_counter() + seconds
    return lambda: time.perf_counter() > end


def _measure_commands(
    task: Task,
    request: OptimizationRequest,
    motion: Trajectory,
    on_iteration: Callable[[int, float], None],
    seconds: float,
) -> list[tuple[str, str, float, float]]:
    """Returns what DDP's motion does of each command alone, at both ends of its range.

    It is the mean over the later half of the horizon. DDP begins with the motion that it found for
    the first situation, and ends after so many seconds in all.
    """
    signals, achieved = task.signals, CommandReadings.of(task)
    is_late, found = _timer(seconds), list[tuple[str, str, float, float]]()

    def note(iteration: Iteration) -> None:
        on_iteration(
            request.max_iterations + _PER_COMMAND * len(found) + iteration.index, iteration.cost
        )

    for column, i in enumerate(achieved.commands):
        command = signals.commands[i]
        for value in sorted({command.lowest, command.highest} - {command.rest}):
            commands = np.where(np.arange(len(signals.rest)) == i, value, signals.rest)
            context = signals.constant_context(commands, task.planned_horizon)
            situation = replace(request.situation, context=context)
            asked = replace(request, situation=situation, max_iterations=_PER_COMMAND)
            try:
                q = optimize(task, asked, note, is_late, Nominal(motion)).distribution
            except VgpsError:
                continue
            late = slice(task.horizon // 2, task.horizon)
            errors = achieved.errors(q.mean.states[None], q.mean.controls[None], context[None])
            done = value + float(errors[0, late, column].mean())
            found.append((command.name, command.unit, value, done))
    return found


def _optimize(
    task: Task,
    request: OptimizationRequest,
    start: Nominal,
    on_iteration: Callable[[int, float], None],
    seconds: float,
    found: TaskCheck,
) -> TrajectoryDistribution | None:
    """Returns what DDP finds in so many seconds, and notes how it went; None where it fails."""
    began, q = time.perf_counter(), None

    def note(iteration: Iteration) -> None:
        found.costs.append(iteration.cost)
        on_iteration(iteration.index, iteration.cost)

    quick = replace(task, optimizer=replace(task.optimizer, first_tolerance=_SMALL))
    try:
        q = optimize(quick, request, note, _timer(seconds), start).distribution
        found.optimized = q.mean
    except VgpsError as error:
        if getattr(error, "status", "") != "indefinite_quu" or not found.troubles:  # the cause
            found.troubles.append(f"DDP fails: {error}")
    found.seconds = time.perf_counter() - began
    gain = 1.0 - found.costs[-1] / found.costs[-2] if found.costs[1:] and found.costs[-2] else 0.0
    if found.seconds > seconds and gain > _SMALL:
        found.notes.append(
            f"DDP stopped after {seconds:g} s, though its last iteration still brought "
            f"{100 * gain:.2g} %, so what is said of its motion may change; raise --seconds."
        )
    return q


def _cost_parts(task: Task, motion: Trajectory) -> list[float]:
    """Returns what each reading, and last the controls, cost along a motion."""
    readings = task.cost.parts(motion.states[:-1], motion.controls).sum(axis=0)
    deviations = motion.controls - task.cost.control_targets
    return [*readings.tolist(), float((deviations**2 @ task.cost.control_weights).sum())]


def _examine_start(task: Task) -> list[str]:
    """Names what is wrong with the state from which the task starts."""
    model, troubles = task.dynamics.model, list[str]()
    data = mujoco.MjData(model)
    data.qpos[:] = task.initial_state[: model.nq]
    mujoco.mj_forward(model, data)
    for contact in sorted(data.contact, key=lambda contact: contact.dist):
        # MuJoCo leaves out contacts of a link with what carries it, but for a base that stands.
        base, link = sorted(model.geom_bodyid[contact.geom])
        is_carried = bool(model.body_parentid[model.body_weldid[link]] == base > 0)
        is_carried &= bool(model.body_weldid[base] == 0)
        if contact.dist >= (0.0 if is_carried else -_DEEP * model.stat.extent):
            continue
        one, other = (model.geom(int(i)).name for i in contact.geom)
        why = " though one carries the other" * is_carried
        troubles.append(
            f"At the start the geoms {one} and {other} are {-contact.dist:.2g} m inside each "
            f"other{why}, which throws the robot off: change the start (start: positions), or "
            "leave this contact out (changes: only_contacts)."
        )
        break
    for i in np.flatnonzero(model.jnt_limited & (model.jnt_type >= 2)):
        at, (low, high) = data.qpos[model.jnt_qposadr[i]], model.jnt_range[i]
        if not low - 0.01 <= at <= high + 0.01:
            troubles.append(
                f"The joint {model.joint(i).name} starts at {at:.3g}, beyond its range from "
                f"{low:.3g} to {high:.3g}: change the start (start: positions)."
            )
    return troubles


def _nothing_to_do(task: Task, still: Trajectory) -> list[str]:
    """Says whether the start is the goal: nothing costs there, and the robot stays by itself."""
    moves = np.abs(still.states - task.initial_state).max()
    if task.cost.values(still).sum() > 1e-9 or not moves < 1e-6:
        return []
    return [
        "the start is the goal, where the robot stays without a control; a policy learns no more "
        "than to hold it. Start elsewhere, or choose another target, if more is meant."
    ]


def explain_inexact_derivatives(task: Task, errors: list[float]) -> list[str]:
    """Names what makes derivatives worthless: a solver that ends early, cones, or contact."""
    if (hardness := float(np.quantile(errors, 0.9))) < _HARD:
        return []
    option, solver = task.dynamics.model.opt, "Newton"
    share = (
        f"The derivatives are off by {100 * min(hardness, 99.0):.0f} % in a tenth of the steps: "
    )
    exact = "(changes: {option: {solver: Newton, tolerance: 1.0e-10, iterations: 100}})."
    if option.solver != mujoco.mjtSolver.mjSOL_NEWTON:
        solver = mujoco.mjtSolver(option.solver).name.removeprefix("mjSOL_")
    if solver != "Newton" or option.tolerance > 1e-9 or option.iterations < 20:
        return [
            f"{share}the solver of constraints, {solver} with a tolerance of {option.tolerance:g} "
            f"and {option.iterations} iterations, ends before they balance; let it go on {exact}"
        ]
    if option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC:
        return [
            f"{share}friction in elliptic cones is not smooth where contact is light; make them "
            "pyramids (changes: {option: {cone: pyramidal}})."
        ]
    model = task.dynamics.model
    softest = float(model.geom_solref[:, 0].max(initial=0.0))
    if softest > 0.0 and not model.geom_solimp[:, 0].any():
        return [
            f"{share}contact changes abruptly though it is soft, as between edges and corners; "
            "leave out what need not touch (changes: only_contacts)."
        ]
    return [
        f"{share}contact is too hard; let its force begin softly, by the solref and solimp that "
        "`vgps new` writes for this robot (changes: geoms)."
    ]


def _excessive_noise(task: Task, q: TrajectoryDistribution, alpha: float) -> list[str]:
    """Names controls whose noise, as the weights leave it, is wilder than what they can do."""
    variances = np.diagonal(q.control_covariances, axis1=1, axis2=2)
    stds = np.median(np.sqrt(variances), axis=0) / alpha**0.5
    low, high = task.dynamics.control_limits
    half = (high - low) / 2
    wild = np.flatnonzero(np.isfinite(half) & (stds > _WILD * half))
    if not wild.size:
        return []
    i = wild[(stds[wild] / half[wild]).argmax()]
    more = (stds[i] / half[i]) ** 2
    return [
        f"The first noise of the control of {task.controls.names[i]} has a standard deviation of "
        f"{stds[i]:.2g}, beyond its limits of ±{half[i]:.2g}, so that mostly the limits act: give "
        f"controls about {more:.2g} times the weight, or scale the other terms (cost)."
    ]


def _slow_derivatives(task: Task, motion: Trajectory, limit: float) -> list[str]:
    """Says that derivatives along a motion take longer than a limit [s], by those of a step."""
    step, took = Trajectory(motion.states[:2], motion.controls[:1]), np.inf
    for _ in range(2):  # the first time, loops may have to be compiled
        began = time.perf_counter()
        task.dynamics.linearize(step)
        took = min(took, (time.perf_counter() - began) * motion.horizon)
        if took <= limit:
            break
    if not took > limit > 0.0:
        return []
    return [
        f"Derivatives along one motion take about {took:.3g} s, more than the {limit:g} s of "
        "--seconds, so that DDP makes no iteration, and a training would take long: remove "
        "bodies or lock joints that the task can do without (changes), or shorten its horizon."
    ]


def derivative_errors(task: Task, trajectory: Trajectory) -> list[float]:
    """Returns the error of f_x, f_u against centred differences, at steps along a trajectory."""
    at = np.unique(np.linspace(0, trajectory.horizon - 1, _POINTS).astype(int))
    points = Trajectory(trajectory.states[[*at, at[-1] + 1]], trajectory.controls[at])
    plain, centred = (
        np.concatenate([linear.f_x, linear.f_u], axis=2)
        for linear, _ in (task.dynamics.linearize(points, centred=c) for c in (False, True))
    )
    sizes = np.abs(centred).max(axis=(1, 2))
    return list((np.abs(plain - centred).max(axis=(1, 2)) / sizes).tolist())


def _find_unmoved(task: Task, motion: Trajectory, linear: LinearDynamics) -> Mask:
    """Returns which readings of the cost no control changes along a motion, by the chain rule.

    A part of a sensor counts as moved where another one is, as an axis that turns in a plane.
    """
    states, controls = motion.states[:-1], motion.controls
    _, j_x, j_u = task.cost.features.linearize(states, controls)
    moved = np.abs(j_u).sum(axis=(0, 2))
    adjoint: Array = np.zeros(j_x.shape[1:])  # of the sum of each reading over the later steps
    for t in reversed(range(motion.horizon)):
        moved += np.abs(adjoint @ linear.f_u[t]).sum(axis=1)
        adjoint = j_x[t] + adjoint @ linear.f_x[t]
    sensors = [name.rpartition("/")[0] or name for name in task.cost_names]
    is_moved = {sensor for sensor, by in zip(sensors, moved, strict=True) if by >= _UNMOVED}
    return np.array([sensor not in is_moved for sensor in sensors], dtype=bool)


def _name_untouched(task: Task, motion: Trajectory, is_known: Mask) -> list[str]:
    """Names what the task is for and does not change in most steps; some of it is known already.

    What a robot moves by itself always changes a little, so this is of a thing that it must touch.
    """
    states, controls = motion.states[:-1], motion.controls
    readings, parts = task.cost.features(states, controls), task.cost.parts(states, controls)
    shares = (np.abs(readings - readings[0]) < _UNMOVED).mean(axis=0)
    costly = parts.sum(axis=0) > max(_MUCH * task.cost.values(motion).sum(), _UNMOVED)
    return [
        f"The cost's {task.cost_names[i]} does not change in {100 * shares[i]:.0f} % of the "
        "optimised motion, so the robot hardly touches what it measures, and no derivative shows "
        "the way there: find a first motion that touches it (`begin: {law: sampling}`), start "
        "nearer (start: positions), or score how far away it is (cost)."
        for i in np.flatnonzero(costly & (shares > _UNTOUCHED) & ~is_known)
    ]


def _sinks_at_end(task: Task, motion: Trajectory) -> bool:
    """Returns whether the centre of mass is lowest at the end, and sinks faster than before."""
    model, heights = task.dynamics.model, list[float]()
    data = mujoco.MjData(model)
    for state in motion.states:
        data.qpos[:] = state[: model.nq]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        heights.append(float(data.subtree_com[0, 2]))
    speeds = np.diff(heights)
    before = np.quantile(np.abs(speeds[: -max(1, len(speeds) // 5)]), 0.9, method="lower")
    return bool(heights[-1] == min(heights) and -speeds[-1] > _DIVES * before)


def _examine_result(task: Task, motion: Trajectory, found: TaskCheck, still: Array) -> list[str]:
    """Names what looks wrong about the optimised motion.

    `still` is what each step costs without a control.
    """
    troubles = []
    low, high = task.dynamics.control_limits
    rest = task.cost.control_targets  # a muscle at rest is at an end of its range
    beyond = ((motion.controls <= low) & (rest > low)) | ((motion.controls >= high) & (rest < high))
    beyond &= np.isfinite(high)
    shares = dict(zip(task.actuated_joint_names, beyond.mean(axis=0).tolist(), strict=True))
    at = sorted((name for name in shares if shares[name] > _AT_LIMIT), key=shares.__getitem__)
    if at:
        shown = list_names([f"{name} ({100 * shares[name]:.0f} %)" for name in reversed(at)])
        troubles.append(
            f"Controls are at their limits in a part of the steps: {shown}. DDP keeps to limits: "
            "allow more, or give controls more weight, if they should have some left for what "
            "disturbs the robot."
        )
    costs = found.costs  # none is below 0
    is_poor = costs[0] and (len(costs) < 2 or costs[-1] > 0.99 * costs[0]) and not found.is_guess
    ends = task.cost.values(motion)[-1]
    if costs[-1] > max(_NOWHERE * still.sum(), 1e-9) and ends > max(_FAR * still[0], 1e-9):
        best = "begin with the best of several first motions (`begin: {law: best}`)"
        more = "allow stronger controls, give them less weight, or score the way to the goal (cost)"
        troubles.append(
            f"The motion costs {costs[-1]:.4g}, and {still.sum():.4g} without any control, so it "
            f"goes nowhere: {more if isinstance(task.begin, Best) else f'{best}, or {more}'}."
        )
    elif is_poor and ends > _NEAR * still[0] and not isinstance(task.begin, Best):  # improved
        troubles.append(
            "DDP hardly lowers the cost: begin with another motion, or raise "
            "ddp.initial_regularization and ddp.regularization_floor (optimizer)."
        )
    if task.fallen.readings.names and not task.lookahead and _sinks_at_end(task, motion):
        troubles.append(
            "The motion lets itself fall at its end, since nothing after it counts: add a "
            "lookahead of about 0.5 s."
        )
    if task.fallen(motion.states[: task.horizon]).any():
        troubles.append(
            "The optimised motion falls: score what keeps the robot up, or begin with the best of "
            "several first motions (`begin: {law: best}`)."
        )
    return troubles
