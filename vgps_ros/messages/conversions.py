"""Records of the core to messages and back.

Arrays cross as their bytes, so a value that goes there and back keeps every bit.
"""

from array import array
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from vgps_msgs.msg import (
    GaussianPolicy as GaussianPolicyMsg,
)
from vgps_msgs.msg import (
    Trajectory as TrajectoryMsg,
)
from vgps_msgs.msg import (
    TrajectoryDistribution as TrajectoryDistributionMsg,
)

from vgps_ros.core.checks import finite_array, quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.records import Array, LinearDynamics, Trajectory, TrajectoryDistribution


def pack(values: Array) -> array:
    """Returns the row-major values as an array that a message takes without a copy per number."""
    return array("d", np.ascontiguousarray(values, dtype=float).tobytes())


def nanoseconds(stamp: Time) -> int:
    """Returns a stamp as one whole number [ns]."""
    return stamp.sec * 10**9 + stamp.nanosec


def stamp_of(nanoseconds: int) -> Time:
    """Returns a time [ns] as a stamp."""
    seconds, rest = divmod(nanoseconds, 10**9)
    return Time(sec=seconds, nanosec=rest)


def policy_to_msg(
    policy: GaussianPolicy, task: str, iteration: int, stamp: Time
) -> GaussianPolicyMsg:
    """Returns the policy as a message."""
    shape = policy.architecture
    message = GaussianPolicyMsg(
        task=task,
        iteration=iteration,
        observed=list(shape.observed),
        layer_sizes=list(shape.layer_sizes),
        activation=shape.activation,
        hidden_bias=shape.hidden_bias,
        output_bias=shape.output_bias,
        parameters=pack(policy.parameters),
        noise_std=pack(policy.noise_std),
    )
    message.header.stamp = stamp
    return message


def policy_from_msg(message: GaussianPolicyMsg) -> GaussianPolicy:
    """Returns the message's policy.

    Raises:
        InvalidInputError: its sizes do not fit each other, or a value is not finite.
    """
    sizes = [int(size) for size in message.layer_sizes]
    if len(sizes) < 2 or sizes[0] != len(message.observed):
        raise InvalidInputError(
            f"The policy's layer_sizes are {quoted(sizes)}, but they must start with the number of "
            f"observed coordinates, {len(message.observed)}, and end with the number of controls."
        )
    shape = Architecture(
        observed=tuple(int(i) for i in message.observed),
        hidden_units=tuple(sizes[1:-1]),
        control_dim=sizes[-1],
        activation=message.activation,
        hidden_bias=message.hidden_bias,
        output_bias=message.output_bias,
    )
    return GaussianPolicy(
        shape,
        finite_array("policy.parameters", message.parameters, (shape.num_parameters,)),
        finite_array("policy.noise_std", message.noise_std, (shape.control_dim,)),
    )


def distribution_to_msg(
    q: TrajectoryDistribution,
    *,
    task: str,
    trajectory_index: int,
    iteration: int,
    time_step: float,
    stamp: Time,
) -> TrajectoryDistributionMsg:
    """Returns q(ζ) as a message."""
    message = TrajectoryDistributionMsg(
        task=task,
        trajectory_index=trajectory_index,
        iteration=iteration,
        time_step=time_step,
        mean=TrajectoryMsg(
            n_x=q.mean.states.shape[1],
            n_u=q.mean.controls.shape[1],
            states=pack(q.mean.states),
            controls=pack(q.mean.controls),
        ),
        gains=pack(q.gains),
        control_covariances=pack(q.control_covariances),
        state_jacobians=pack(q.linear_dynamics.f_x),
        control_jacobians=pack(q.linear_dynamics.f_u),
        state_covariances=pack(q.state_covariances),
    )
    message.header.stamp = stamp
    return message


def distribution_from_msg(message: TrajectoryDistributionMsg) -> TrajectoryDistribution:
    """Returns the message's q(ζ).

    Raises:
        InvalidInputError: an array does not fit the others, or a value is not finite.
    """
    n_x, n_u = int(message.mean.n_x), int(message.mean.n_u)
    if not n_x or not n_u:
        raise InvalidInputError(
            f"The trajectory has n_x={n_x} and n_u={n_u}; both must be above 0."
        )
    horizon = len(message.mean.controls) // n_u
    if not horizon:
        raise InvalidInputError(
            f"The trajectory has {len(message.mean.controls)} control values for n_u={n_u}, but it "
            "must have a step at least."
        )
    return TrajectoryDistribution(
        mean=Trajectory(
            finite_array("mean.states", message.mean.states, (horizon + 1, n_x)),
            finite_array("mean.controls", message.mean.controls, (horizon, n_u)),
        ),
        gains=finite_array("gains", message.gains, (horizon, n_u, n_x)),
        control_covariances=finite_array(
            "control_covariances", message.control_covariances, (horizon, n_u, n_u)
        ),
        linear_dynamics=LinearDynamics(
            finite_array("state_jacobians", message.state_jacobians, (horizon, n_x, n_x)),
            finite_array("control_jacobians", message.control_jacobians, (horizon, n_x, n_u)),
        ),
        state_covariances=finite_array(
            "state_covariances", message.state_covariances, (horizon + 1, n_x, n_x)
        ),
    )


def state_to_msg(
    state: Array, joint_names: Sequence[str], stamp: Time, efforts: Array | None = None
) -> JointState:
    """Returns x = (positions, velocities) as joint states, with efforts [N·m] where known."""
    n = len(joint_names)
    message = JointState(name=list(joint_names), position=pack(state[:n]), velocity=pack(state[n:]))
    if efforts is not None:
        message.effort = pack(efforts)
    message.header.stamp = stamp
    return message


def state_from_msg(message: JointState, joint_names: Sequence[str]) -> Array:
    """Returns x, shape (n_x,), whatever the order of the message's joints.

    Raises:
        InvalidInputError: a joint is missing, or a value is missing or not finite.
    """
    order = _order(message, joint_names)
    n = len(message.name)
    positions = finite_array("joint_states.position", message.position, (n,))
    velocities = finite_array("joint_states.velocity", message.velocity, (n,))
    return np.concatenate([positions[order], velocities[order]])


def command_to_msg(control: Array, joint_names: Sequence[str], stamp: Time) -> JointState:
    """Returns torques [N·m] as a joint command."""
    message = JointState(name=list(joint_names), effort=pack(control))
    message.header.stamp = stamp
    return message


def command_from_msg(message: JointState, joint_names: Sequence[str]) -> Array:
    """Returns the torques [N·m], shape (n_u,).

    Raises:
        InvalidInputError: a joint is missing, or a torque is missing or not finite.
    """
    order = _order(message, joint_names)
    return finite_array("joint_command.effort", message.effort, (len(message.name),))[order]


def _order(message: JointState, joint_names: Sequence[str]) -> NDArray[np.intp]:
    return _order_of(tuple(message.name), tuple(joint_names))


@lru_cache(maxsize=16)  # a sender keeps to one order
def _order_of(names: tuple[str, ...], joint_names: tuple[str, ...]) -> NDArray[np.intp]:
    index = {name: i for i, name in enumerate(names)}
    missing = [name for name in joint_names if name not in index]
    if missing or len(index) != len(names):
        raise InvalidInputError(
            f"The message has the joints {quoted(list(names))}, but each of "
            f"{list(joint_names)} must be there once."
        )
    return np.array([index[name] for name in joint_names], dtype=np.intp)
