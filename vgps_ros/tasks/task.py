# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The record of a control problem, and a digest of it."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property, partial
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from vgps_ros.core.augmentation import Augmentation
from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.observation import Observation
from vgps_ros.core.optimizer_settings import OptimizerSettings
from vgps_ros.core.records import Array, LinearDynamics, Trajectory
from vgps_ros.robot.bodies import UP
from vgps_ros.robot.controls import Controls
from vgps_ros.robot.deployment import Conditions, Deployment
from vgps_ros.robot.signals import Signals
from vgps_ros.robot.unrest import Unrest
from vgps_ros.simulation.dynamics import Dynamics
from vgps_ros.simulation.frames import state_layout
from vgps_ros.simulation.model import deviation_names, joint_names, sensor_numbers
from vgps_ros.simulation.readings import Readings
from vgps_ros.tasks.held_pose import carrying_forces


@dataclass(frozen=True)
class Nominal:
    """The motion from which a solve starts, and what is known of it.

    Attributes:
        trajectory: x, u.
        simulator_steps: simulator steps that it took, as far as they count as learning.
        linear_dynamics: f_x, f_u along it; None where they are not known.
        gaps: see `core.ddp.solve`, shape (T, n_dx); None where the motion was executed.
    """

    trajectory: Trajectory
    simulator_steps: int = 0
    linear_dynamics: LinearDynamics | None = None
    gaps: Array | None = None

    @classmethod
    def guessed(
        cls, trajectory: Trajectory, dynamics: Dynamics, simulator_steps: int = 0
    ) -> "Nominal":
        """Returns a motion that these dynamics did not make, so that the solve closes its gaps."""
        steps = simulator_steps + trajectory.horizon * dynamics.substeps
        return cls(trajectory, steps, gaps=dynamics.gaps(trajectory))


class FirstMotion(Protocol):
    """Makes the motion from which a task's first solve starts; see `tasks.first_motion`."""

    @property
    def goes_on(self) -> bool:
        """Whether it can last for longer than the task plans, as that of a law can."""

    def __call__(
        self,
        task: "Task",
        start: Array,
        steps: int,
        rng: np.random.Generator,
        is_cancelled: Callable[[], bool] = lambda: False,
        /,
    ) -> Nominal:
        """Returns a motion of so many steps from x_1, shape (n_x,), in the task's context.

        After cancellation any motion may be returned.

        Raises:
            DivergenceError: a recorded motion cannot be followed.
        """


@dataclass(frozen=True, eq=False)  # two tasks are the same only if they are one
class Task:
    """A control problem: dynamics, cost, start, and settings that were measured to suit it.

    Attributes:
        name: its name in the registry.
        mjcf: the robot's MJCF, in one text.
        dynamics: x' = f(x, u).
        cost: c(x, u).
        horizon: T, the number of steps that are trained on and scored.
        initial_state: mean of x_1, shape (n_x,).
        varied_state_std: standard deviation of the initial states if one policy learns from
            several, shape (n_dx,).
        observation: what a policy reads of a state.
        initial_std: standard deviation of x_1, shape (n_dx,).
        std_limit: largest standard deviation of each coordinate in the marginals, shape (n_dx,);
            inf for none.
        fallen: tells whether the robot has fallen in states (..., n_x).
        limits: tells whether an executor must stop the policy in states (..., n_x).
        begin: makes the motion from which the first solve starts.
        lookahead: number of steps that are optimised beyond T, so that the policy does not learn
            from the end of the optimised horizon, after which nothing has a cost.
        signals: the commands and the clock.
        augmentation: what becomes of the samples that a policy is fitted to; None: they stay.
        context: what they are over the planned horizon, shape (T, n_z); None where there are none.
        optimizer: settings of the trajectory optimisation that suit the task.
        search: settings of a policy search that suit the task, by dotted name.
    """

    name: str
    mjcf: str
    dynamics: Dynamics
    cost: FeatureCost
    horizon: int
    initial_state: Array
    varied_state_std: Array
    observation: Observation
    initial_std: Array
    std_limit: Array
    fallen: Conditions
    limits: Conditions
    begin: FirstMotion
    lookahead: int = 0
    signals: Signals = field(default_factory=Signals)
    augmentation: Augmentation | None = None
    context: Array | None = None
    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    search: Mapping[str, Any] = field(default_factory=dict)

    @property
    def planned_horizon(self) -> int:
        """Number of steps that are optimised."""
        return self.horizon + self.lookahead

    @cached_property  # since every step needs it
    def joint_names(self) -> list[str]:
        """Names of the joints that turn or slide along one axis, in the order of the state."""
        return joint_names(self.dynamics.model)

    @property
    def dims(self) -> dict[str, int]:
        """The sizes of a state, of a deviation and of a control, by their symbols."""
        space = self.dynamics.space
        return {
            "n_x": space.state_dim,
            "n_dx": space.tangent_dim,
            "n_u": self.dynamics.control_dim,
            "n_z": len(self.signals.names),
        }

    @property
    def planned_context(self) -> Array:
        """The commands and the clock of each step that is optimised, shape (T, n_z)."""
        if self.context is None:
            return np.empty((self.planned_horizon, 0))
        return self.context[: self.planned_horizon]

    def in_context(self, context: Array) -> "Task":
        """Returns the task where commands and clock are z over the planned horizon, (T, n_z)."""
        if not self.signals.names:
            return self
        return replace(
            self,
            context=context,
            cost=self.cost.in_context(context),
            observation=self.observation.within(context),
        )

    def commanded(self, commands: Array, phase: float = 0.0) -> "Task":
        """Returns the task with commands (n_c,) that do not change, and the clock's first φ."""
        return self.in_context(self.signals.constant_context(commands, self.planned_horizon, phase))

    @cached_property
    def unrest(self) -> Unrest | None:
        """When a clock that stops turns again; None where it never stops."""
        gravity, layout = self.dynamics.model.opt.gravity, state_layout(self.dynamics.model)
        up = -gravity / np.linalg.norm(gravity) if gravity.any() else UP
        return Unrest.of(self.signals, layout, self.initial_state, up)

    @cached_property
    def deployment(self) -> Deployment:
        """What an executor has to know of the task."""
        model, dynamics = self.dynamics.model, self.dynamics
        still = np.zeros(model.nv + model.na)
        keyframes = [model.key(i) for i in range(model.nkey)]
        poses = {key.name: np.r_[key.qpos, still] for key in keyframes if key.name}
        layout, carrying = state_layout(model), dict[str, Array]()
        for name, pose in {"": self.initial_state, **poses}.items():
            carrying[name] = np.zeros(model.nu)
            if layout.base:
                carrying[name] = carrying_forces(dynamics, self.controls, pose)
        return Deployment(
            name=self.name,
            mjcf=self.mjcf,
            time_step=dynamics.time_step,
            horizon=self.horizon,
            layout=layout,
            controls=self.controls,
            signals=self.signals,
            initial_state=self.initial_state,
            keyframes=poses,
            carrying=carrying,
            observation=self.observation,
            limits=self.limits,
            read=partial(Readings, dynamics.simulations),
            sensors=tuple(sensor_numbers(model)),
        )

    @property
    def velocities(self) -> slice:
        """The place of the velocities in a deviation; positions come before them."""
        n_v = self.dynamics.model.nv
        return slice(n_v, 2 * n_v)

    @cached_property
    def position_names(self) -> list[str]:
        """Names of the positions among a deviation's coordinates."""
        return deviation_names(self.dynamics.model)[: self.dynamics.model.nv]

    @cached_property
    def angles(self) -> NDArray[np.bool_]:
        """Mask of the positions among a deviation's coordinates that are angles, shape (n_v,)."""
        model = self.dynamics.model
        slides = model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE]
        free = model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
        return ~np.isin(np.arange(model.nv), [*slides, *free, *(free + 1), *(free + 2)])

    @cached_property
    def actuated_joint_names(self) -> list[str]:
        """Names of the joints that the controls drive, in the order of the controls."""
        return list(self.controls.names)

    @property
    def controls(self) -> Controls:
        """What the robot's controls are."""
        return self.dynamics.controls

    @property
    def cost_names(self) -> tuple[str, ...]:
        """Names of the readings that the cost scores."""
        features = self.cost.features
        names: tuple[str, ...] = getattr(features, "names", ())
        return names or tuple(f"feature {i}" for i in range(len(self.cost.smooth)))

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

        The root's first slide, or its free joint's x, points ahead; a robot whose first joint is
        a hinge or a ball goes nowhere.
        """
        return np.where(self.angles[0], 0.0, after[..., 0] - before[..., 0])

    def survived(self, states: Array) -> NDArray[np.bool_]:
        """Returns whether each rollout (N, T+1, n_x) neither diverged nor fell, shape (N,)."""
        sound = np.isfinite(states).all(axis=2) & ~self.fallen(states)
        return np.logical_and.reduce(sound, axis=1)

    def trajectory_cost(self, trajectory: Trajectory) -> float:
        """Returns Σ_t c of one trajectory."""
        return float(self.cost.values(trajectory).sum())


# What a training's identity has by name: the task, and the settings of which these are defaults.
_NAMED = ("name", "optimizer", "search")


def task_digest(task: Task) -> str:
    """Returns twelve hexadecimal digits that another robot, cost, start or fall changes."""
    content = {f.name: getattr(task, f.name) for f in fields(task) if f.name not in _NAMED}
    return hashlib.sha256(repr(_plain(content)).encode()).hexdigest()[:12]


def _plain(value: Any, *around: int) -> Any:
    """Returns a value as tuples whose text is the same in each process.

    `around` are the identities of the values that hold it, since a function may hold itself.
    """
    if id(value) in around:
        return "itself"
    parts: Any
    if value is None or isinstance(value, bool | int | float | str | bytes):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, Dynamics):  # its model is that of the task's MJCF
        parts = (value.substeps,)
    elif isinstance(value, Readings):
        parts = value.names
    elif is_dataclass(value) and not isinstance(value, type):
        parts = [(f.name, getattr(value, f.name)) for f in fields(value)]
    elif isinstance(value, Mapping):
        parts = sorted(value.items(), key=repr)
    elif isinstance(value, tuple | list):
        parts = value
    elif isinstance(value, partial):
        parts = value.func, value.args, value.keywords
    else:
        cells = getattr(value, "__closure__", None) or ()
        parts = [getattr(value, "__qualname__", ""), *(cell.cell_contents for cell in cells)]
    inner = (*around, id(value))
    return type(value).__name__, *(_plain(part, *inner) for part in parts)
