"""The record of a control problem, and functions to build one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.records import Array, Trajectory
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.model import actuated_joint_names, joint_names


def never(states: Array) -> NDArray[np.bool_]:
    """Returns false for each of the states (..., n_x)."""
    return np.zeros(states.shape[:-1], dtype=bool)


@dataclass(frozen=True)
class Task:
    """A control problem: dynamics, cost, start, and settings that were measured to suit it.

    Attributes:
        name: its name in the registry.
        model_path: file of its MJCF.
        dynamics: x' = f(x, u).
        cost: c(x, u).
        horizon: T, the number of steps that are trained on and scored.
        initial_state: mean of x_1, shape (n_x,).
        varied_state_std: standard deviation of the initial states if one policy learns from
            several, shape (n_x,).
        observed: indices of the state's coordinates that a policy reads.
        initial_std: standard deviation of x_1, shape (n_x,).
        std_limit: largest standard deviation of each coordinate in the marginals, shape (n_x,); inf
            for none.
        guess: draws the controls, shape (T, n_u), from which the first solve starts, or None.
        demonstration: the trajectory from which the first solve starts if there is no guess.
        demonstrate: returns a demonstration from another x_1 for a number of steps; if it is None,
            a rollout from there follows the recorded demonstration.
        lookahead: number of steps that are optimised beyond T, so that the policy does not learn
            from the end of the optimised horizon, after which nothing has a cost.
        fallen: returns whether the robot has fallen in states (..., n_x), shape (...,).
        optimizer: settings of the trajectory optimisation that suit the task.
        search: settings of a policy search that suit the task, by dotted name.
    """

    name: str
    model_path: Path
    dynamics: Dynamics
    cost: FeatureCost
    horizon: int
    initial_state: Array
    varied_state_std: Array
    observed: tuple[int, ...]
    initial_std: Array
    std_limit: Array
    guess: Callable[[np.random.Generator], Array] | None = None
    demonstration: Trajectory | None = None
    demonstrate: Callable[[Array, int], Trajectory] | None = None
    lookahead: int = 0
    fallen: Callable[[Array], NDArray[np.bool_]] = never
    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    search: Mapping[str, Any] = field(default_factory=dict)

    @property
    def planned_horizon(self) -> int:
        """Number of steps that are optimised."""
        return self.horizon + self.lookahead

    @cached_property  # since every step needs it
    def joint_names(self) -> list[str]:
        """Names of all joints, in the order of positions and velocities in the state."""
        return joint_names(self.dynamics.model)

    @cached_property
    def hinges(self) -> NDArray[np.bool_]:
        """Mask of the positions that are angles, shape (n_x / 2,)."""
        types = self.dynamics.model.jnt_type
        return np.asarray(types == mujoco.mjtJoint.mjJNT_HINGE)

    @cached_property
    def actuated_joint_names(self) -> list[str]:
        """Names of the joints that the controls drive, in the order of the controls."""
        return actuated_joint_names(self.dynamics.model)

    def rollout_costs(self, states: Array, controls: Array) -> Array:
        """Returns Σ_t c of rollouts, shape (N,); inf for one that diverged.

        Args:
            states: shape (N, T+1, n_x), NaN where a rollout has diverged.
            controls: shape (N, T, n_u).
        """
        costs = self.cost(states[:, :-1], controls).sum(axis=1)
        diverged = ~np.isfinite(states).all(axis=(1, 2))
        return np.where(diverged, np.inf, costs)

    def distance(self, before: Array, after: Array) -> Array:
        """Returns how far states (..., n_x) lie ahead of others, shape (...,), [m].

        The root's first slide points ahead; a robot whose first joint is a hinge goes nowhere.
        """
        return np.where(self.hinges[0], 0.0, after[..., 0] - before[..., 0])

    def survived(self, states: Array) -> NDArray[np.bool_]:
        """Returns whether each rollout (N, T+1, n_x) neither diverged nor fell, shape (N,)."""
        sound = np.isfinite(states).all(axis=2) & ~self.fallen(states)
        return np.logical_and.reduce(sound, axis=1)

    def trajectory_cost(self, trajectory: Trajectory) -> float:
        """Returns Σ_t c of one trajectory."""
        return float(self.cost.values(trajectory).sum())


def load_model(path: Path, joints: Sequence[str]) -> mujoco.MjModel:
    """Compiles an MJCF file.

    Args:
        path: the file.
        joints: names that the task expects, in the order of the state.

    Raises:
        InvalidInputError: the file cannot be compiled, or has other joints.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise InvalidInputError(f"The model '{path}' cannot be compiled: {error}.") from error
    found = joint_names(model)
    if found != list(joints):
        raise InvalidInputError(
            f"The model '{path}' has the joints {', '.join(found)}, but its task needs "
            f"{', '.join(joints)}, in this order."
        )
    return model


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
