"""A headless Rerun recording of a run: the robot in motion, its joints, and how learning goes.

Joint states stand where Rerun's own MCAP reader puts them, on the same timeline, so that a live
recording and one made from a bag look alike. No port is opened and no screen is needed.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array, TrajectoryDistribution
from vgps_ros.tasks import Task
from vgps_ros.views.robot_shape import RobotShape

TIME = "ros2_timestamp"
ITERATION = "iteration"

_LEARNED, _DDP = (31, 95, 191), (0, 0, 0)


class RobotScene:
    """Writes a recording while a run goes on.

    Args:
        task: whose robot.
        path: file to write; it must not exist.

    Raises:
        InvalidInputError: the file exists, or its folder cannot be made.
    """

    def __init__(self, task: Task, path: Path):
        if path.exists():
            raise InvalidInputError(f"The recording '{path}' exists already; name another file.")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch(exist_ok=False)
        except OSError as error:
            raise InvalidInputError(
                f"The recording '{path}' cannot be written: {error}."
            ) from error
        self._shape = RobotShape(task.dynamics.model)
        self._task = task
        self._centre: Array | None = None
        self._solutions: dict[int, TrajectoryDistribution] = {}
        self._recording = rr.RecordingStream("vgps_ros")
        self._recording.save(path, default_blueprint=_blueprint())
        self._log_static(task)

    def log_state(self, stamp: int, state: Array, efforts: Array | None = None) -> None:
        """Shows the robot in a state x at a time [ns], and its joints' efforts where known."""
        self._set_time(stamp)
        half = len(state) // 2
        self._recording.log("joint_states/position", rr.Scalars(state[:half]))
        self._recording.log("joint_states/velocity", rr.Scalars(state[half:]))
        if efforts is not None:
            self._recording.log("joint_states/effort", rr.Scalars(efforts))
        centres, rotations = self._shape.poses(state)
        for capsule, centre, rotation in zip(self._shape.capsules, centres, rotations, strict=True):
            self._recording.log(
                f"world/robot/{capsule.name}", rr.Transform3D(translation=centre, mat3x3=rotation)
            )
        centre = self._shape.centre_of_mass(state)
        if self._centre is not None:
            self._recording.log(
                "world/centre_of_mass",
                rr.LineStrips3D([[self._centre, centre]], colors=_LEARNED, radii=0.015),
            )
        self._centre = centre

    def restart_path(self) -> None:
        """Begins a new path of the centre of mass, after a reset."""
        self._centre = None

    def log_command(self, stamp: int, torques: Array) -> None:
        """Shows torques [N·m] at a time [ns]."""
        self._set_time(stamp)
        self._recording.log("joint_command/effort", rr.Scalars(torques))

    def log_progress(self, iteration: int, figures: Mapping[str, float]) -> None:
        """Shows figures of an iteration of Algorithm 1, by name."""
        self._recording.reset_time()
        self._recording.set_time(ITERATION, sequence=iteration)
        for name, figure in figures.items():
            if np.isfinite(figure):
                self._recording.log(f"learning/{name}", rr.Scalars(figure))

    def log_noise(self, iteration: int, noise_std: Array) -> None:
        """Shows the noise [N·m] of the policy of an iteration of Algorithm 1."""
        self._recording.reset_time()
        self._recording.set_time(ITERATION, sequence=iteration)
        self._recording.log("policy/noise_std", rr.Scalars(noise_std))

    def log_solver_iteration(self, stamp: int, solver: str, cost: float) -> None:
        """Shows the modified cost after an iteration of DDP, by the optimizer's full name."""
        self._set_time(stamp)
        self._recording.log(f"solves/{solver.strip('/')}", rr.Scalars(cost))

    def keep_solution(self, index: int, q: TrajectoryDistribution) -> None:
        """Keeps q(ζ) of a trajectory: the tube of the last one is drawn when the file ends."""
        self._solutions[index] = q

    def log_initial_solution(self, index: int, states: Array) -> None:
        """Shows the path of the centre of mass of an initial DDP solution, at all times."""
        self._recording.log(
            f"world/initial_ddp/{index}",
            rr.LineStrips3D([self._shape.path(states)], colors=_DDP, radii=0.008),
            static=True,
        )

    def close(self) -> None:
        """Completes the file; only now are the last solutions' tubes known."""
        for index, q in self._solutions.items():
            self._log_tubes(index, q)
        self._recording.flush()
        self._recording.disconnect()

    def _set_time(self, stamp: int) -> None:
        self._recording.reset_time()
        self._recording.set_time(TIME, timestamp=np.datetime64(stamp, "ns"))

    def _log_tubes(self, index: int, q: TrajectoryDistribution) -> None:
        """Shows two standard deviations around the mean of each angle, from time 0."""
        model = self._task.dynamics.model
        steps = np.arange(len(q.mean.states)) * round(self._task.dynamics.time_step * 1e9)
        times = rr.TimeColumn(TIME, timestamp=steps.astype("datetime64[ns]"))
        deviations = np.sqrt(np.diagonal(q.state_covariances, axis1=1, axis2=2).clip(0.0))
        for i, name in enumerate(self._task.joint_names):
            if model.joint(name).type[0] != mujoco.mjtJoint.mjJNT_HINGE:
                continue
            tube = q.mean.states[:, i, None] + np.outer(deviations[:, i], [-2.0, 0.0, 2.0])
            entity = f"trajectory_distribution/{index}/{name}"
            names = [f"{name} −2 sd", f"{name} mean", f"{name} +2 sd"]
            self._recording.log(entity, rr.SeriesLines(names=names), static=True)
            columns = rr.Scalars.columns(scalars=tube).partition([3] * len(tube))
            self._recording.send_columns(entity, [times], columns)

    def _log_static(self, task: Task) -> None:
        for signal, names in (
            ("joint_states/position", task.joint_names),
            ("joint_states/velocity", task.joint_names),
            ("joint_states/effort", task.joint_names),
            ("joint_command/effort", task.actuated_joint_names),
            ("policy/noise_std", task.actuated_joint_names),
        ):
            self._recording.log(signal, rr.SeriesLines(names=names), static=True)
        for capsule in self._shape.capsules:
            self._recording.log(
                f"world/robot/{capsule.name}",
                # Rerun's capsule starts at its origin, MuJoCo's is centred on it.
                rr.Capsules3D(
                    lengths=[2 * capsule.half_length],
                    radii=[capsule.radius],
                    translations=[[0.0, 0.0, -capsule.half_length]],
                    colors=[_bytes(capsule.colour)],
                    fill_mode="solid",
                ),
                static=True,
            )


def _bytes(colour: Sequence[float]) -> list[int]:
    return [round(255 * part) for part in colour]


def _blueprint() -> rrb.Blueprint:
    """Lays everything out, so that the file opens ready to read."""
    whole_run = rrb.VisibleTimeRanges(
        rrb.VisibleTimeRange(
            TIME,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    )
    costs = [
        f"learning/{name}"
        for name in ("stochastic_cost", "deterministic_cost", "ddp_cost", "initial_ddp_cost")
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(
                    origin="world", name="robot", overrides={"world/centre_of_mass": [whole_run]}
                ),
                rrb.TimeSeriesView(contents=costs, name="cost by iteration"),
                rrb.Tabs(
                    rrb.TimeSeriesView(contents=["learning/alpha"], name="alpha by iteration"),
                    rrb.TimeSeriesView(origin="policy/noise_std", name="policy noise [N·m]"),
                    rrb.TimeSeriesView(origin="solves", name="modified cost of the DDP solves"),
                ),
                row_shares=[4, 2, 1],
            ),
            rrb.Vertical(
                rrb.Tabs(
                    rrb.TimeSeriesView(origin="joint_states/position", name="position [m, rad]"),
                    rrb.TimeSeriesView(
                        origin="trajectory_distribution", name="mean and ±2 sd of q [rad]"
                    ),
                ),
                rrb.TimeSeriesView(origin="joint_states/velocity", name="velocity [m/s, rad/s]"),
                rrb.TimeSeriesView(origin="joint_command/effort", name="torque [N·m]"),
            ),
        ),
        collapse_panels=True,
    )
