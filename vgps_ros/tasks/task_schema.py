# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The form of a task file: a control problem as data.

Each field has a description with its unit, and an example: errors and editors show them. From
these records `scripts/write_task_schema.py` writes the JSON schema `task.schema.json`, and
`vgps_ros.tasks.task_file` reads a file.
"""

from math import inf
from typing import Annotated, Any, Literal

from msgspec import Meta, field

from vgps_ros.tasks.model_schema import Changes, Sensor
from vgps_ros.tasks.reading_schema import CostTerm, Limit, Observation
from vgps_ros.tasks.schema_types import Coordinates, Name, NonNegative, Positive, Record, about

SettingValue = bool | int | float | str | tuple[bool | int | float | str, ...]
Settings = dict[str, SettingValue | dict[str, SettingValue]]


class Spread(Record, frozen=True, kw_only=True):
    """Standard deviations of a state; what is left out is exact."""

    position: Annotated[NonNegative, about("of each position [m, rad]", 0.01)] = 0.0
    velocity: Annotated[NonNegative, about("of each velocity [m/s, rad/s]", 0.1)] = 0.0
    activation: Annotated[NonNegative, about("of each actuator's activation", 0.0)] = 0.0
    overrides: Annotated[
        dict[str, NonNegative],
        about(
            "others, by JOINT/position or JOINT/velocity, or a pattern", {"root_x/position": 0.0}
        ),
    ] = field(default_factory=dict)


class Start(Record, frozen=True, kw_only=True):
    """The state from which a task starts: a keyframe, or the model's first state, and changes."""

    keyframe: Annotated[
        Name | Annotated[int, Meta(ge=0, le=1_000_000)] | None,
        about("a keyframe of the model, by name or number", "stand"),
    ] = None
    positions: Annotated[
        dict[str, Coordinates],
        about(
            "positions by joint [m, rad]; 4 numbers w x y z of a ball, 7 numbers x y z w x y z of "
            "a free joint",
            {"hip": 0.1},
        ),
    ] = field(default_factory=dict)
    velocities: Annotated[
        dict[str, Coordinates],
        about(
            "velocities by joint [m/s, rad/s]; 3 numbers of a ball, 6 of a free joint", {"hip": 0.0}
        ),
    ] = field(default_factory=dict)
    std: Annotated[
        Spread,
        about("standard deviations of the start", {"position": 0.01, "velocity": 0.1}),
    ] = Spread(position=0.01, velocity=0.1)
    varied: Annotated[
        Spread | None,
        about(
            "standard deviations of several starts from which one policy learns; left out: std",
            {"position": 0.1, "velocity": 0.1},
        ),
    ] = None


class SpreadLimit(Record, frozen=True, kw_only=True):
    """Holds the largest standard deviations of a state; those left out have no limit (.inf)."""

    position: Annotated[Annotated[float, Meta(gt=0)], about("[m, rad]", 0.3)] = inf
    velocity: Annotated[Annotated[float, Meta(gt=0)], about("[m/s, rad/s]", 4.0)] = inf
    activation: Annotated[Annotated[float, Meta(gt=0)], about("of an actuator", 1.0)] = inf
    overrides: Annotated[
        dict[str, Annotated[float, Meta(gt=0)]],
        about(
            "others, by JOINT/position or JOINT/velocity, or a pattern", {"root_x/position": 1.0}
        ),
    ] = field(default_factory=dict)


class Marginals(Record, frozen=True, kw_only=True):
    """Limits of the trajectory distribution's width."""

    std_limit: Annotated[
        SpreadLimit,
        about("largest standard deviations", {"position": 0.3, "velocity": 4.0}),
    ] = SpreadLimit()


class Zero(Record, frozen=True, kw_only=True, tag_field="law", tag="zero"):
    """Controls of zero."""


class Noise(Record, frozen=True, kw_only=True, tag_field="law", tag="noise"):
    """Controls that vary smoothly at random."""

    std: Annotated[
        Positive | tuple[NonNegative, ...],
        about("standard deviation of controls, or one for each actuator [N·m]", 30.0),
    ]
    time_constant: Annotated[Positive, about("time over which they vary [s]", 0.5)] = 0.5


class Pd(Record, frozen=True, kw_only=True, tag_field="law", tag="pd"):
    """Torques that hold a pose: stiffness · (pose − position) − damping · velocity."""

    pose: Annotated[
        Name | Annotated[int, Meta(ge=0, le=1_000_000)] | None,
        about("a keyframe, by name or number; left out: the start", "stand"),
    ] = None
    stiffness: Annotated[
        NonNegative | dict[str, NonNegative] | None,
        about(
            "[N·m/rad], for all joints or by name or pattern; left out: suited to their inertia",
            300.0,
        ),
    ] = None
    damping: Annotated[
        NonNegative | dict[str, NonNegative] | None,
        about(
            "[N·m·s/rad], for all joints or by name or pattern; left out: suited to the stiffness",
            30.0,
        ),
    ] = None


class Sampling(Record, frozen=True, kw_only=True, tag_field="law", tag="sampling"):
    """A motion found by sampling: short plans, one after another, each improved by samples."""

    method: Annotated[
        Literal["predictive", "cross_entropy"],
        about("the best sample becomes the plan, or the mean of the best ones", "predictive"),
    ] = "predictive"
    plan: Annotated[Positive, about("length of a plan [s]", 0.8)] = 0.8
    period: Annotated[
        Positive, about("time after which the next plan is made [s]; long is fast", 0.05)
    ] = 0.05
    samples: Annotated[
        Annotated[int, Meta(ge=2, le=100_000)], about("plans tried in an iteration", 32)
    ] = 32
    iterations: Annotated[
        Annotated[int, Meta(ge=1, le=1000)], about("rounds of samples for each plan", 2)
    ] = 2
    elites: Annotated[
        Annotated[int, Meta(ge=2, le=100_000)],
        about("best samples whose mean cross_entropy takes", 8),
    ] = 8
    knots: Annotated[
        Annotated[int, Meta(ge=2, le=1000)],
        about("points in a plan between which a sample's change is linear", 6),
    ] = 6
    noise: Annotated[
        Positive,
        about("largest standard deviation of a sample, as a share of half a control's range", 0.3),
    ] = 0.3
    std: Annotated[
        Positive | tuple[Positive, ...] | None,
        about("the same in the control's own unit, or one for each actuator [N·m]", 30.0),
    ] = None
    ddp_iterations: Annotated[
        Annotated[int, Meta(ge=0, le=1000)], about("iterations of DDP on each plan", 5)
    ] = 5


class Demonstration(Record, frozen=True, kw_only=True, tag_field="law", tag="demonstration"):
    """A recorded motion."""

    file: Annotated[
        Name,
        about("file with columns time, JOINT/position, JOINT/velocity, JOINT/effort", "walk.csv"),
    ]


class Path(Record, frozen=True, kw_only=True, tag_field="law", tag="path"):
    """Positions over time, which no robot needs to be able to follow; the solve closes the gaps.

    Without keyframes and file the robot stays in the air, or wherever it starts.
    """

    through: Annotated[
        tuple[Name | Annotated[int, Meta(ge=0, le=1_000_000)], ...],
        about("keyframes to pass on straight lines from the start, at even times", ["stand"]),
    ] = ()
    file: Annotated[
        Name | None,
        about(
            "or a file with columns time and JOINT/position, also of another robot: joints that it "
            "lacks stay as they start",
            "walk.csv",
        ),
    ] = None
    scale: Annotated[
        Positive, about("of the file's lengths, as the ratio of two robots' sizes", 0.8)
    ] = 1.0


Begin = Zero | Noise | Pd | Sampling | Demonstration | Path


class TaskFile(Record, frozen=True, kw_only=True):
    """A control problem for vgps_ros. Units are SI: m, kg, s, rad, N, N·m."""

    model: Annotated[
        Name,
        about(
            "the robot's MJCF: a path from this file's folder, or package://PACKAGE/PATH",
            "hopper.xml",
        ),
    ]
    changes: Annotated[
        Changes, about("changes of the model, made in memory", {"option": {"timestep": 0.005}})
    ] = field(default_factory=Changes)
    control_period: Annotated[
        Positive, about("time between controls, a multiple of the simulator's time step [s]", 0.01)
    ]
    horizon: Annotated[Positive, about("time that is trained on and scored [s]", 4.0)]
    lookahead: Annotated[
        NonNegative, about("time that is optimised beyond the horizon [s]", 0.6)
    ] = 0.0
    start: Annotated[Start, about("the start", {"keyframe": "stand"})] = field(
        default_factory=Start
    )
    sensors: Annotated[
        dict[str, Sensor],
        about("sensors to add, by name", {"height": {"type": "framepos", "body": "torso"}}),
    ] = field(default_factory=dict)
    cost: Annotated[
        tuple[CostTerm, ...],
        Meta(
            description="terms whose sum is the cost of a step",
            examples=[[{"sensor": "height", "index": "z", "target": 1.2, "weight": 5.0}]],
            min_length=1,
        ),
    ]
    observe: Annotated[
        tuple[Name | Observation, ...],
        Meta(
            description="values that the policy reads: joint_positions, joint_velocities, scalars "
            "by full name, or mappings",
            examples=[["joint_positions", "joint_velocities", {"sensor": "up"}]],
            min_length=1,
        ),
    ] = ("joint_positions", "joint_velocities")
    fallen: Annotated[
        tuple[Limit, ...],
        about("limits beyond which the robot has fallen", [{"sensor": "height/z", "below": 0.7}]),
    ] = ()
    limits: Annotated[
        tuple[Limit, ...],
        about(
            "limits beyond which the executor stops the policy",
            [{"sensor": "pitch", "beyond": 1.0}],
        ),
    ] = ()
    marginals: Annotated[
        Marginals, about("limits of the width of q", {"std_limit": {"position": 0.3}})
    ] = field(default_factory=Marginals)
    begin: Annotated[
        Begin, about("motion from which the first solve starts", {"law": "pd", "pose": "stand"})
    ] = field(default_factory=Zero)
    optimizer: Annotated[
        Settings,
        about("settings of the trajectory optimization", {"ddp.regularization_floor": 0.1}),
    ] = field(default_factory=dict)
    search: Annotated[Settings, about("settings of the policy search", {"hidden_units": [10]})] = (
        field(default_factory=dict)
    )


def flattened(settings: dict[str, Any]) -> dict[str, Any]:
    """Returns nested settings by their dotted names."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{key}": entry for key, entry in value.items()}
        else:
            flat[name] = value
    return flat
