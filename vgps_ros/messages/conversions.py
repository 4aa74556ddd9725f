# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Records of the core to messages and back.

Arrays cross as their bytes, so a value that goes there and back keeps every bit.
"""

import hashlib
from array import array
from collections.abc import Sequence
from dataclasses import fields
from functools import lru_cache, reduce
from itertools import zip_longest
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, TwistStamped, Vector3, Wrench, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from vgps_msgs.msg import GaussianPolicy as GaussianPolicyMsg
from vgps_msgs.msg import LearningProgress, RobotModel, SolveStatus
from vgps_msgs.msg import Plan as PlanMsg
from vgps_msgs.msg import Signals as SignalsMsg
from vgps_msgs.msg import Trajectory as TrajectoryMsg
from vgps_msgs.msg import TrajectoryDistribution as TrajectoryDistributionMsg

from vgps_ros.core.checks import (
    array_shapes,
    arrays_of,
    declared_shapes,
    finite_array,
    from_arrays,
    quote,
)
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Array, Trajectory, TrajectoryDistribution
from vgps_ros.messages.names import CMD_VEL
from vgps_ros.robot.controls import ControlKind, Controls
from vgps_ros.robot.deployment import Deployment
from vgps_ros.robot.signals import Command

if TYPE_CHECKING:  # an executor takes none of them
    from vgps_ros.search.metrics import IterationMetrics
    from vgps_ros.search.mpc import Plan
    from vgps_ros.tasks import Task

Kind = TypeVar("Kind")

# Arrays of q(ζ) that have another name in the message.
_MESSAGE_NAMES = {
    "linear_dynamics.f_x": "state_jacobians",
    "linear_dynamics.f_u": "control_jacobians",
}


def pack(values: Array) -> array:
    """Returns the row-major values as an array that a message takes without a copy per number."""
    return array("d", np.ascontiguousarray(values, dtype=float).tobytes())


def plain(value: Any) -> Any:
    """Returns a message's list as a tuple of Python's values, and any other value as it is."""
    values = value.tolist() if hasattr(value, "tolist") else value
    return tuple(values) if isinstance(values, list) else values


def to_message(kind: type[Kind], *sources: Any, **given: Any) -> Kind:
    """Returns a message whose fields are given, or are the sources' attributes of the same names.

    A field that is not given and that no source has keeps its default.
    """
    for name in kind.get_fields_and_field_types():  # type: ignore[attr-defined]
        for source in sources:
            if name not in given and hasattr(source, name):
                value = getattr(source, name)
                given[name] = pack(value) if isinstance(value, np.ndarray) else value
    return kind(**given)


def from_message(kind: type[Kind], message: Any, **given: Any) -> Kind:
    """Returns a record whose fields are given, or are the message's fields of the same names."""
    names = [f.name for f in fields(kind) if f.name not in given]  # type: ignore[arg-type]
    return kind(**{name: plain(getattr(message, name)) for name in names}, **given)


def robot_model(mjcf: str, states: Sequence[str], controls: Sequence[str]) -> RobotModel:
    """Returns what a message says of its robot.

    Args:
        mjcf: the robot's MJCF, as on the topic `mjcf_description`.
        states: names of the coordinates of a state, shape (n_x,).
        controls: names of what the controls drive, shape (n_u,).
    """
    digest, names = _digest(mjcf), {"states": list(states), "controls": list(controls)}
    return RobotModel(format=RobotModel.FORMAT, digest=digest, **names)


@lru_cache(maxsize=8)
def _digest(mjcf: str) -> str:
    return hashlib.sha256(mjcf.encode()).hexdigest()


def robot_of(deployment: Deployment) -> RobotModel:
    """Returns what messages say of a task's robot."""
    return robot_model(deployment.mjcf, deployment.layout.names, deployment.controls.names)


def check_robot(what: str, given: Any, own: RobotModel) -> None:
    """Refuses the numbers of a message that are about another robot.

    Args:
        what: what the sentence calls the message, such as `The policy`.
        given: the message's field `robot`; what it leaves empty is unknown, and accepted.
        own: the robot of who receives it.

    Raises:
        InvalidInputError: the format is newer, or a name or the model is another.
    """
    if given.format > RobotModel.FORMAT:
        raise InvalidInputError(
            f"{what} has the format {given.format}, but this version reads formats up to "
            f"{RobotModel.FORMAT}; use the version that made it."
        )
    for names in ("controls", "states"):
        theirs, ours = list(getattr(given, names)), list(getattr(own, names))
        if theirs and ours and theirs != ours:
            pairs = zip_longest(theirs, ours, fillvalue="none")
            i, (their, our) = next((i, p) for i, p in enumerate(pairs) if p[0] != p[1])
            raise InvalidInputError(
                f"{what} is for another robot: its {names}[{i}] is {quote(their)}, but here it is "
                f"{quote(our)}; start all nodes with the same task."
            )
    if given.digest and own.digest and given.digest != own.digest:
        raise InvalidInputError(
            f"{what} is for another model: its digest is {quote(given.digest[:12])}, but here it "
            f"is {own.digest[:12]!r}; start all nodes with the same model and version of MuJoCo."
        )


def nanoseconds(stamp: Time) -> int:
    """Returns a stamp as one whole number [ns]."""
    return stamp.sec * 10**9 + stamp.nanosec


def stamp_of(nanoseconds: int) -> Time:
    """Returns a time [ns] as a stamp."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return Time(sec=seconds, nanosec=rest)


def policy_to_msg(
    policy: GaussianPolicy, task: str, iteration: int, stamp: Time, robot: RobotModel | None = None
) -> GaussianPolicyMsg:
    """Returns the policy as a message; without a robot it does not say which one it is for."""
    given = {"header": Header(stamp=stamp), "task": task, "iteration": iteration}
    given["robot"] = robot or RobotModel(format=RobotModel.FORMAT)
    return to_message(GaussianPolicyMsg, policy.architecture, policy, **given)


def policy_from_msg(message: GaussianPolicyMsg) -> GaussianPolicy:
    """Returns the message's policy.

    Raises:
        InvalidInputError: its sizes do not fit each other, or a value is not finite.
    """
    sizes = [int(size) for size in message.layer_sizes]
    if len(sizes) < 2 or sizes[0] != len(message.observed):
        raise InvalidInputError(
            f"The policy's layer_sizes are {quote(sizes)}, but they must start with the number of "
            f"numbers that it reads, {len(message.observed)}, and end with the number of controls."
        )
    units = {"hidden_units": tuple(sizes[1:-1]), "control_dim": sizes[-1]}
    arrays = {name: getattr(message, name) for name in declared_shapes(GaussianPolicy)}
    return GaussianPolicy(from_message(Architecture, message, **units), **arrays)


def distribution_to_msg(
    q: TrajectoryDistribution, robot: Deployment, trajectory_index: int, iteration: int, stamp: Time
) -> TrajectoryDistributionMsg:
    """Returns q(ζ) as a message."""
    message = TrajectoryDistributionMsg(
        header=Header(stamp=stamp),
        task=robot.name,
        trajectory_index=trajectory_index,
        iteration=iteration,
        time_step=robot.time_step,
        mean=TrajectoryMsg(robot=robot_of(robot), **_dims(q.mean)),
    )
    for name, values in arrays_of(q).items():
        *owner, field = _MESSAGE_NAMES.get(name, name).split(".")
        setattr(reduce(getattr, owner, message), field, pack(values))
    return message


def distribution_from_msg(message: TrajectoryDistributionMsg) -> TrajectoryDistribution:
    """Returns the message's q(ζ).

    Raises:
        InvalidInputError: an array does not fit the others, or a value is not finite.
    """
    n_x, n_u, horizon = _sizes(message.mean)
    arrays, n_dx = {}, len(message.gains) // (horizon * n_u)
    sizes = {"T": horizon, "n_x": n_x, "n_dx": n_dx, "n_u": n_u}
    sizes["n_z"] = len(message.context) // horizon
    for name, shape in array_shapes(TrajectoryDistribution, **sizes).items():
        field = _MESSAGE_NAMES.get(name, name)
        arrays[name] = finite_array(field, attrgetter(field)(message), shape)
    return from_arrays(TrajectoryDistribution, arrays)


def plan_to_msg(plan: "Plan", task: "Task", solve_time: float, stamp: Time) -> PlanMsg:
    """Returns a plan that took a time [s] as a message, stamped as the state it begins from."""
    robot, dims = robot_of(task.deployment), _dims(plan.trajectory)
    return PlanMsg(
        header=Header(stamp=stamp),
        task=task.name,
        time_step=task.dynamics.time_step,
        cost=plan.cost,
        solve_time=solve_time,
        outcome=outcome_of(plan.status.value),
        trajectory=to_message(TrajectoryMsg, plan.trajectory, robot=robot, **dims),
    )


def _dims(trajectory: Trajectory) -> dict[str, int]:
    return {"n_x": trajectory.states.shape[1], "n_u": trajectory.controls.shape[1]}


def outcome_of(status: str) -> SolveStatus:
    """Returns how a solve ended, such as `converged`, as a message with its constant."""
    return SolveStatus(code=getattr(SolveStatus, status.upper()))


def trajectory_from_msg(message: TrajectoryMsg) -> Trajectory:
    """Returns the message's states and controls.

    Raises:
        InvalidInputError: an array does not fit the other, or a value is not finite.
    """
    n_x, n_u, horizon = _sizes(message)
    return Trajectory(
        finite_array("states", message.states, (horizon + 1, n_x)),
        finite_array("controls", message.controls, (horizon, n_u)),
    )


def _sizes(message: TrajectoryMsg) -> tuple[int, int, int]:
    """Returns n_x, n_u and T, all above 0."""
    n_x, n_u = int(message.n_x), int(message.n_u)
    horizon = len(message.controls) // max(n_u, 1)
    if not n_x or not n_u or not horizon:
        raise InvalidInputError(
            f"The trajectory has n_x={n_x} and n_u={n_u} and {len(message.controls)} control "
            "values, but both must be above 0, and there must be the controls of a step at least."
        )
    return n_x, n_u, horizon


def progress_to_msg(metrics: "IterationMetrics", *, stamp: Time, **run: Any) -> LearningProgress:
    """Returns the metrics of an iteration that has ended as a message.

    `run` has the run's task, method, seed, iterations and remaining_seconds.
    """
    header = Header(stamp=stamp)
    return to_message(LearningProgress, metrics, header=header, iteration=metrics.k, **run)


def progress_from_msg(message: LearningProgress) -> "IterationMetrics":
    """Returns the message's metrics."""
    from vgps_ros.search.metrics import METRICS, IterationMetrics

    found = {name: plain(getattr(message, name)) for name in METRICS}
    return IterationMetrics(k=message.iteration, **found)


def result_from_msgs(
    history: Sequence[LearningProgress], policy: GaussianPolicy | None
) -> dict[str, Any]:
    """Returns the content of result.json of a training that messages tell of, at least one."""
    last, metrics = history[-1], [progress_from_msg(message) for message in history]
    from vgps_ros.search.metrics import result_content

    return result_content(last.task, last.method, int(last.seed), policy, metrics)


def state_to_msg(
    state: Array, joint_names: Sequence[str], stamp: Time, efforts: Array | None = None
) -> JointState:
    """Returns (positions, velocities) as joint states, with efforts [N·m] where known."""
    n, message = len(joint_names), JointState()
    message.header.stamp, message.name = stamp, list(joint_names)
    message.position, message.velocity = pack(state[:n]), pack(state[n:])
    if efforts is not None:
        message.effort = pack(efforts)
    return message


def state_from_msg(message: JointState, joint_names: Sequence[str]) -> Array:
    """Returns (positions, velocities), whatever the order of the message's joints.

    Further joints do not matter, whatever their values are.

    Raises:
        InvalidInputError: a joint is missing, or a value is missing or not finite.
    """
    order = name_order(tuple(message.name), tuple(joint_names))
    parts = []
    for name in ("position", "velocity"):
        given = np.asarray(getattr(message, name), dtype=float)
        if len(given) != len(message.name):
            raise InvalidInputError(
                f"joint_states.{name} has {len(given)} values, but the message names "
                f"{len(message.name)} joints."
            )
        parts.append(finite_array(f"joint_states.{name}", given[order], order.shape, joint_names))
    return np.concatenate(parts)


def command_to_msg(control: Array, controls: Controls, stamp: Time) -> JointState:
    """Returns u, shape (n_u,), as a joint command, in the fields and units of its kinds.

    NaN stands in a field that is not that of a control.
    """
    values, message = controls.at_joints(control), JointState()
    message.header.stamp, message.name = stamp, list(controls.names)
    for name, mask in controls.fields.items():
        setattr(message, name, pack(np.where(mask, values, np.nan)))
    return message


def command_from_msg(message: JointState, controls: Controls) -> Array:
    """Returns u, shape (n_u,).

    The target of a servo may come with a feed-forward effort, and that of a position with a target
    of the velocity.

    Raises:
        InvalidInputError: a joint is missing, or a value that it needs is missing or not finite.
    """
    order = name_order(tuple(message.name), controls.names)

    def field(name: str, needed: NDArray[np.bool_] | None = None) -> Array:
        """Returns a field's values where they are needed, or where it has any; otherwise zero."""
        values = np.array(getattr(message, name), dtype=float)
        if needed is None:
            if not len(values):
                return np.zeros(len(order))
            values[np.isnan(values)] = 0.0
        if len(values) == len(message.name):
            own = values[order] if needed is None else np.where(needed, values[order], 0.0)
            values[:] = 0.0
            values[order] = own
        return finite_array(f"joint_command.{name}", values, (len(message.name),))[order]

    values = sum((field(*each) for each in controls.fields.items()), np.zeros(len(order)))
    control = controls.from_joints(values)
    if "position" not in controls.fields:
        return control
    ahead = (field("effort") + controls.damping * field("velocity")) / controls.strength
    return control + np.where(controls.are(ControlKind.POSITION), ahead, 0.0)


def gains_to_msg(controls: Controls, stamp: Time) -> SignalsMsg:
    """Returns the gains k_p and k_d of each joint's loop as a message."""
    gains = {"stiffness": controls.stiffness, "damping": controls.damping}
    names = [f"{joint}/{gain}" for gain in gains for joint in controls.names]
    return signals_to_msg(np.concatenate([*gains.values()]), names, stamp)


def gains_from_msg(message: SignalsMsg, controls: Controls) -> tuple[Array, Array]:
    """Returns k_p and k_d of each control's joint, shapes (n_u,).

    Raises:
        InvalidInputError: a gain is missing or not finite.
    """
    given, found = signals_from_msg(message), []
    for gain in ("stiffness", "damping"):
        names = [f"{joint}/{gain}" for joint in controls.names]
        if missing := [name for name in names if name not in given]:
            raise InvalidInputError(f"It lacks {quote(missing[0])}; name all gains of the robot.")
        found.append(np.array([given[name] for name in names]))
    return found[0], found[1]


def efforts_from_msg(message: JointState, joint_names: Sequence[str]) -> Array:
    """Returns the efforts of joints, shape (n,) [N·m, N].

    Raises:
        InvalidInputError: a joint is missing, or an effort is missing or not finite.
    """
    order = name_order(tuple(message.name), tuple(joint_names))
    return finite_array("joint_states.effort", message.effort, (len(message.name),))[order]


def signals_to_msg(values: Array, names: Sequence[str], stamp: Time) -> SignalsMsg:
    """Returns commands, or commands and clock, as a message."""
    return SignalsMsg(header=Header(stamp=stamp), names=list(names), values=pack(values))


def signals_from_msg(message: SignalsMsg) -> dict[str, float]:
    """Returns the message's numbers by name.

    Raises:
        InvalidInputError: a name comes twice, or a value is missing or not finite.
    """
    names = list(message.names)
    values = finite_array("values", message.values, (len(names),)).tolist()
    if len(set(names)) != len(names):
        raise InvalidInputError(f"The names are {quote(names)}, but each may come only once.")
    return dict(zip(names, values, strict=True))


def twist_to_msg(velocities: Array, stamp: Time) -> TwistStamped:
    """Returns linear and angular velocities (x, y, z each), shape (6,), [m/s, rad/s]."""
    linear, angular = (Vector3(x=x, y=y, z=z) for x, y, z in velocities.reshape(2, 3).tolist())
    return TwistStamped(header=Header(stamp=stamp), twist=Twist(linear=linear, angular=angular))


def commands_from_twist(
    message: Any, commands: Sequence[Command], base_frame: str
) -> dict[str, float]:
    """Returns the commands that a message on cmd_vel tells, by name.

    Args:
        message: a TwistStamped, or a Twist, of rclpy or of a bag.
        commands: the commands; those with a source are read.
        base_frame: the frame in which a TwistStamped must be.

    Raises:
        InvalidInputError: it is in another frame, or a value is not finite.
    """
    twist = message
    if hasattr(message, "header"):
        twist, frame = message.twist, message.header.frame_id
        if frame not in ("", base_frame):
            raise InvalidInputError(
                f"its frame is {quote(frame)}, but it must be that of the robot's base, "
                f"{quote(base_frame)}, or empty."
            )
    sources = {c.name: c.source.removeprefix(f"{CMD_VEL}/") for c in commands if c.source}
    found = [attrgetter(source.replace("/", "."))(twist) for source in sources.values()]
    return dict(zip(sources, finite_array(CMD_VEL, found, (len(found),)).tolist(), strict=True))


def push_to_msg(body: str, wrench: Array) -> WrenchStamped:
    """Returns a push of a body: force at its origin and torque, along its axes, shape (6,)."""
    force, torque = (Vector3(x=x, y=y, z=z) for x, y, z in wrench.reshape(2, 3).tolist())
    return WrenchStamped(header=Header(frame_id=body), wrench=Wrench(force=force, torque=torque))


def wrench_from_msg(message: Wrench) -> Array:
    """Returns a force [N] and a torque [N·m], shape (6,).

    Raises:
        InvalidInputError: a value is not finite.
    """
    parts = [(v.x, v.y, v.z) for v in (message.force, message.torque)]
    return finite_array("wrench", parts, (6,))


@lru_cache(maxsize=16)  # the joints of a sender always come in the same order
def name_order(names: tuple[str, ...], joint_names: tuple[str, ...]) -> NDArray[np.intp]:
    """Returns where each of our names stands among a message's names.

    Raises:
        InvalidInputError: a name is missing, or a name comes twice.
    """
    index = {name: i for i, name in enumerate(names)}
    missing = [name for name in joint_names if name not in index]
    if missing or len(index) != len(names):
        raise InvalidInputError(
            f"The message has the joints {quote(list(names))}, but each of "
            f"{list(joint_names)} must be there once."
        )
    return np.array([index[name] for name in joint_names], dtype=np.intp)
