# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The form of a task file: a control problem as data.

Each field has a description with its unit, and an example: errors and editors show them. From
these records `scripts/write_task_schema.py` writes the JSON schema `task.schema.json`, and
`vgps_ros.tasks.task_file` reads a file.
"""

from math import inf
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

from vgps_ros.core.settings import Range
from vgps_ros.simulation.sensor_types import SENSOR_TYPES


class Record(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """Base of all records of a task file; a key that is not a field is an error.

    Records repeat `frozen` and `kw_only`, which they inherit, since mypy does not see that.
    """

    def __init_subclass__(cls) -> None:
        """Says in the words of msgspec what settings say too: ranges and descriptions."""
        super().__init_subclass__()
        cls.__annotations__ = {
            name: Annotated[(form.__origin__, *map(_as_meta, form.__metadata__))]
            for name, form in cls.__annotations__.items()
        }


def _as_meta(note: Any) -> Meta:
    """Returns what msgspec reads in place of a range or a description."""
    if isinstance(note, Range):
        return Meta(ge=note.low, le=note.high)
    return Meta(description=note) if isinstance(note, str) else note


def example(value: Any) -> Meta:
    """Returns an example of a key's value, for errors and editors."""
    return Meta(examples=[value])


Number = Annotated[float, Meta(ge=-1e12, le=1e12)]
Positive = Annotated[float, Meta(gt=0, le=1e12)]
NonNegative = Annotated[float, Meta(ge=0, le=1e12)]
Count = Annotated[int, Meta(ge=0, le=1_000_000)]
Name = Annotated[str, Meta(min_length=1, max_length=200)]
Keyframe = Name | Count
Pose = Keyframe | dict[Name, Number]
Vector = tuple[Number, Number, Number]
Coordinates = Number | tuple[Number, ...]


Index = str | Annotated[int, Meta(ge=0, le=10_000)]
Indices = Index | tuple[Index, ...]


class Followed(Record, frozen=True, kw_only=True):
    """A target that follows a command or the clock."""

    command: Annotated[Name | None, "the command that is added to rest", example("forward")] = None
    swing: Annotated[
        Number | None,
        "height of max(0, sin(2π(clock + phase))), which is added to rest",
        example(0.06),
    ] = None
    phase: Annotated[Number, "with swing, its lead on the clock [turns]", example(0.5)] = 0.0
    rest: Annotated[
        Number, "the target where the command is zero, or a foot is down", example(0.02)
    ] = 0.0


Target = Number | Followed


class Stance(Record, frozen=True, kw_only=True):
    """When a foot whose swings have this lead on the clock is down."""

    stance: Annotated[Number, "its lead on the clock, as of its swing [turns]", example(0.5)]


class CostTerm(Record, frozen=True, kw_only=True):
    """A term of the cost: weight · norm(sensor[index] − target) at each step, or of controls."""

    sensor: Annotated[
        Name | None,
        "a sensor, or a scalar's full name such as height/z or hip/position",
        example("velocity"),
    ] = None
    index: Annotated[
        Indices | None, "parts of the sensor, by name or number; left out: all", example("x")
    ] = None
    target: Annotated[
        Target | tuple[Target, ...],
        "wanted value, or one for each part, in the sensor's unit; or what it follows, as "
        "{command: forward} or {swing: 0.06, phase: 0.5, rest: 0.02}",
        example(1.0),
    ] = 0.0
    weight: Annotated[
        NonNegative | tuple[NonNegative, ...],
        "weight, or one for each part [1 / square of the unit]",
        example(1.0),
    ] = 1.0
    norm: Annotated[
        Literal["quadratic", "smooth_abs"],
        "d², or smooth_abs, √(d² + width²) − width, which is milder far away",
        example("smooth_abs"),
    ] = "quadratic"
    width: Annotated[
        Positive, "deviation below which smooth_abs is round, in the sensor's unit", example(0.1)
    ] = 0.1
    when: Annotated[
        Literal["moving", "still"] | Stance | None,
        "moving: it counts only while anything is commanded; still: only while nothing is; "
        "{stance: PHASE}: while a foot with this phase is down, times max(0, -sin(2π(clock + "
        "PHASE)))",
        example("still"),
    ] = None
    control: Annotated[
        Name | tuple[Name, ...] | None,
        "instead of a sensor, actuators whose u² counts [N²·m²]: all, or names",
        example("all"),
    ] = None
    pose: Annotated[
        Pose | None,
        "with control, start, a keyframe, or positions of joints that differ from the start: "
        "what counts is (u − u*)², where u* is the control by which a servo of positions rests "
        "in this pose, in the unit of its ctrlrange, and 0 of other actuators",
        example("start"),
    ] = None


class CommandEntry(Record, frozen=True, kw_only=True):
    """A number that the policy is told as it runs, and shall bring about."""

    range: Annotated[
        tuple[Number, Number], "smallest and largest value that is learned", example((-0.5, 1.0))
    ]
    source: Annotated[
        Name | None,
        "topic and field that it comes from, under the node's namespace; left out: it comes by "
        "the topic `command` alone",
        example("cmd_vel/linear/x"),
    ] = field(name="from", default=None)
    unit: Annotated[str, "its unit, for people", example("m/s")] = ""


class MirrorEntry(Record, frozen=True, kw_only=True):
    """The exchange of left and right, by names."""

    swap: Annotated[
        tuple[tuple[Name, Name], ...], "parts of names to exchange", example([["left", "right"]])
    ]
    flip: Annotated[
        tuple[Name, ...],
        "what has the other sign on the other side, by name or pattern: joints, readings, "
        "command/NAME, clock/*",
        example(["*_hip", "up/y", "turning/[xz]", "command/turn"]),
    ] = ()


class Clock(Record, frozen=True, kw_only=True):
    """A phase that turns with time."""

    frequency: Annotated[Positive, "turns in a second [Hz]", example(2.0)]
    stops: Annotated[
        bool,
        "whether it stands still while all commands are at rest, and the base has neither been "
        "tilted nor pushed lately: sine and cosine, and what swings with them, are zero then, "
        "so that the robot learns to stand",
        example(True),
    ] = False


class Except(Record, frozen=True, kw_only=True):
    """Joints that are left out."""

    excluded: Annotated[
        tuple[Name, ...], "names or patterns of joints to leave out", example(["root_x"])
    ] = field(name="except")


class ObservedEntry(Record, frozen=True, kw_only=True):
    """Values that the policy reads: of one joint, one sensor, or all joints but some."""

    joint: Annotated[Name | None, "a hinge or slide, or a pattern", example("hip")] = None
    form: Annotated[
        Literal["position", "velocity", "sin_cos"],
        "with joint, how it is read; sin_cos gives sine and cosine of an angle",
        example("sin_cos"),
    ] = field(name="as", default="position")
    sensor: Annotated[Name | None, "a sensor", example("up")] = None
    index: Annotated[
        Indices | None, "parts of the sensor, by name or number; left out: all", example("z")
    ] = None
    joint_positions: Annotated[
        Except | None,
        "positions of all hinges and slides but these",
        example({"except": ["root_x"]}),
    ] = None
    joint_velocities: Annotated[
        Except | None,
        "velocities of all hinges and slides but these",
        example({"except": ["root_x"]}),
    ] = None


class Limit(Record, frozen=True, kw_only=True):
    """A bound of one scalar, which is crossed below, above, or on either side of zero."""

    sensor: Annotated[
        Name,
        "a sensor, or a scalar's full name such as height/z or hip/position",
        example("height"),
    ]
    index: Annotated[Index | None, "the part of the sensor", example("z")] = None
    below: Annotated[Number | None, "crossed below this value", example(0.7)] = None
    above: Annotated[Number | None, "crossed above this value", example(2.0)] = None
    beyond: Annotated[NonNegative | None, "crossed where |value| is above this", example(1.0)] = (
        None
    )


MOST_CONTACTS = 31  # pairs, since MuJoCo marks them by the bits of an integer


class Option(Record, frozen=True, kw_only=True):
    """Options of the simulation, under MuJoCo's names; the model keeps those that are left out."""

    timestep: Annotated[Positive | None, "the simulator's time step [s]", example(0.005)] = None
    integrator: Annotated[
        Literal["Euler", "RK4", "implicit", "implicitfast"] | None,
        "the method of integration; implicitfast suits stiff joints",
        example("implicitfast"),
    ] = None
    solver: Annotated[
        Literal["PGS", "CG", "Newton"] | None, "the solver of constraints", example("Newton")
    ] = None
    cone: Annotated[
        Literal["pyramidal", "elliptic"] | None, "the form of friction cones", example("pyramidal")
    ] = None
    iterations: Annotated[Count | None, "most iterations of the solver", example(50)] = None
    tolerance: Annotated[NonNegative | None, "the solver's tolerance", example(1e-12)] = None
    ls_iterations: Annotated[Count | None, "most iterations of its line search", example(50)] = None
    gravity: Annotated[Vector | None, "gravity, x y z [m/s²]", example((0.0, 0.0, -9.81))] = None


class JointChange(Record, frozen=True, kw_only=True):
    """Changes of joints; units are those of a hinge, and of a slide with m and N instead."""

    lock: Annotated[
        Number | None,
        "removes the joint, with its motor, at this position [rad]; nothing else counts",
        example(0.0),
    ] = None
    damping: Annotated[NonNegative | None, "damping [N·m·s/rad]", example(1.0)] = None
    armature: Annotated[NonNegative | None, "the rotor's inertia [kg·m²]", example(0.02)] = None
    frictionloss: Annotated[NonNegative | None, "dry friction [N·m]", example(0.0)] = None
    range: Annotated[
        tuple[Number, Number] | None, "lowest and highest position [rad]", example((-1.0, 1.0))
    ] = None
    solref_limit: Annotated[
        tuple[Number, Number] | None,
        "MuJoCo's solref of the limit: time [s], damping ratio",
        example((0.04, 1.0)),
    ] = None
    solimp_limit: Annotated[
        tuple[Number, ...] | None,
        "MuJoCo's solimp of the limit, up to 5 numbers",
        example((0.0, 0.95, 0.1, 0.5, 2.0)),
    ] = None
    actfrcrange: Annotated[
        tuple[Number, Number] | None,
        "lowest and highest torque of all its actuators [N·m]",
        example((-24.0, 24.0)),
    ] = None


class GeomChange(Record, frozen=True, kw_only=True):
    """Changes of geoms: how they touch."""

    solref: Annotated[
        tuple[Number, Number] | None,
        "MuJoCo's solref of contacts: time [s], damping ratio",
        example((0.04, 1.0)),
    ] = None
    solimp: Annotated[
        tuple[Number, ...] | None,
        "MuJoCo's solimp of contacts, up to 5 numbers; a first one of 0 lets force start smoothly",
        example((0.0, 0.95, 0.02, 0.5, 2.0)),
    ] = None
    friction: Annotated[
        NonNegative | tuple[NonNegative, ...] | None,
        "friction: sliding, torsional [m], rolling [m]; the last two may be left out",
        example(1.0),
    ] = None
    condim: Annotated[
        Literal[1, 3, 4, 6] | None, "dimensions of a contact's force; 1: no friction", example(3)
    ] = None
    priority: Annotated[Count | None, "of two, the higher one's values count", example(1)] = None


class BodyChange(Record, frozen=True, kw_only=True):
    """Changes of bodies."""

    mass: Annotated[Positive, "its mass, with which its inertia grows [kg]", example(2.0)]


class Motor(Record, frozen=True, kw_only=True):
    """A motor that is added, or with a stiffness a servo, whose control is a position [rad]."""

    joint: Annotated[
        Name | tuple[Name, ...],
        "the joint that it drives; a pattern or a list adds a motor for each of the hinges and "
        "slides, named as its joint",
        example("hip"),
    ]
    limit: Annotated[
        Positive | None,
        "largest control of a motor either way [N·m]; largest force of a servo, whose "
        "targets stay in the joint's range",
        example(24.0),
    ] = None
    stiffness: Annotated[Positive | None, "k_p of a servo [N·m/rad]", example(30.0)] = None
    damping: Annotated[NonNegative | None, "k_d of a servo [N·m·s/rad]", example(0.5)] = None
    armature: Annotated[
        NonNegative, "inertia of its rotor, as its joint feels it [kg·m²]", example(0.02)
    ] = 0.0


class Changes(Record, frozen=True, kw_only=True):
    """Changes of the model, made in memory; a pattern such as *_hip names several things."""

    drop: Annotated[
        tuple[Literal["visual", "meshes", "textures"], ...],
        "what to leave out: geoms that neither touch nor weigh anything, all meshes and what "
        "they are the shape of, or all textures; skins and pictures in files always are",
        example(["visual"]),
    ] = ()
    option: Annotated[Option, "options of the simulation", example({"timestep": 0.005})] = field(
        default_factory=Option
    )
    joints: Annotated[
        dict[str, JointChange],
        "changes by a joint's name or pattern; later ones win",
        example({"*": {"damping": 1.0}}),
    ] = field(default_factory=dict)
    geoms: Annotated[
        dict[str, GeomChange],
        "changes by a geom's name or pattern; later ones win",
        example({"*foot": {"condim": 3}}),
    ] = field(default_factory=dict)
    bodies: Annotated[
        dict[str, BodyChange],
        "changes by a body's name or pattern; later ones win",
        example({"trunk": {"mass": 12.0}}),
    ] = field(default_factory=dict)
    remove_bodies: Annotated[
        tuple[Name, ...],
        "names or patterns of bodies to remove, with all that they carry",
        example(["arm"]),
    ] = ()
    free_bodies: Annotated[
        tuple[Name, ...],
        "names or patterns of bodies that get a free joint in place of their own",
        example(["trunk"]),
    ] = ()
    remove_actuators: Annotated[
        tuple[Name, ...], "names or patterns of actuators to remove first", example(["*"])
    ] = ()
    actuators: Annotated[
        dict[str, Motor],
        "motors to add, by name",
        example({"hip": {"joint": "hip", "limit": 24.0}}),
    ] = field(default_factory=dict)
    floor: Annotated[
        bool, "whether to add a level floor at height 0, named floor", example(True)
    ] = False
    only_contacts: Annotated[
        Annotated[tuple[tuple[Name, Name], ...], Meta(max_length=MOST_CONTACTS)] | None,
        "pairs of names or patterns of geoms; all other contacts are switched off",
        example([["floor", "*foot"]]),
    ] = None


class Frame(Record, frozen=True, kw_only=True):
    """The one object whose frame counts."""

    body: Annotated[
        Name | None, "a body: its centre of mass and principal axes", example("torso")
    ] = None
    xbody: Annotated[Name | None, "a body: its frame as the MJCF has it", example("torso")] = None
    geom: Annotated[Name | None, "a geom", example("left_foot")] = None
    site: Annotated[Name | None, "a site", example("imu")] = None


class Sensor(Frame, frozen=True, kw_only=True):
    """A sensor of MuJoCo that is added to the model. It measures one object."""

    type: Annotated[
        str,
        "MuJoCo's name of the sensor's type",
        example("framepos"),
        Meta(extra_json_schema={"enum": list(SENSOR_TYPES)}),
    ]
    joint: Annotated[Name | None, "a joint", example("hip")] = None
    tendon: Annotated[Name | None, "a tendon", example("hamstring")] = None
    actuator: Annotated[Name | None, "an actuator", example("hip_motor")] = None
    relative_to: Annotated[
        Frame | None, "an object to measure against", example({"xbody": "torso"})
    ] = None
    cutoff: Annotated[
        Positive | None,
        "largest value, in the sensor's unit; for distances the farthest seen [m]",
        example(1.0),
    ] = None


SettingValue = bool | int | float | str | tuple[bool | int | float | str, ...]
Settings = dict[str, SettingValue | dict[str, SettingValue]]


class StateSpread(Record, frozen=True, kw_only=True):
    """Standard deviations of a state; what is left out is exact."""

    position: Annotated[NonNegative, "of each position [m, rad]", example(0.01)] = 0.0
    velocity: Annotated[NonNegative, "of each velocity [m/s, rad/s]", example(0.1)] = 0.0
    overrides: Annotated[
        dict[str, NonNegative],
        "others, by JOINT/position or JOINT/velocity, or a pattern",
        example({"root_x/position": 0.0}),
    ] = field(default_factory=dict)


class Start(Record, frozen=True, kw_only=True):
    """The state from which a task starts: a keyframe, or the model's first state, and changes."""

    keyframe: Annotated[
        Keyframe | None, "a keyframe of the model, by name or number", example("stand")
    ] = None
    positions: Annotated[
        dict[str, Coordinates],
        "positions by joint [m, rad]; 4 numbers w x y z of a ball, 7 numbers x y z w x y z of "
        "a free joint",
        example({"hip": 0.1}),
    ] = field(default_factory=dict)
    velocities: Annotated[
        dict[str, Coordinates],
        "velocities by joint [m/s, rad/s]; 3 numbers of a ball, 6 of a free joint",
        example({"hip": 0.0}),
    ] = field(default_factory=dict)
    std: Annotated[
        StateSpread,
        "standard deviations of the start",
        example({"position": 0.01, "velocity": 0.1}),
    ] = StateSpread(position=0.01, velocity=0.1)
    varied: Annotated[
        StateSpread | None,
        "standard deviations of several starts from which one policy learns; left out: std",
        example({"position": 0.1, "velocity": 0.1}),
    ] = None


class SpreadLimit(Record, frozen=True, kw_only=True):
    """Holds the largest standard deviations of a state; those left out have no limit (.inf)."""

    position: Annotated[float, Meta(gt=0), "[m, rad]", example(0.3)] = inf
    velocity: Annotated[float, Meta(gt=0), "[m/s, rad/s]", example(4.0)] = inf
    overrides: Annotated[
        dict[str, Annotated[float, Meta(gt=0)]],
        "others, by JOINT/position or JOINT/velocity, or a pattern",
        example({"root_x/position": 1.0}),
    ] = field(default_factory=dict)


class Marginals(Record, frozen=True, kw_only=True):
    """Limits of the trajectory distribution's width."""

    std_limit: Annotated[
        SpreadLimit, "largest standard deviations", example({"position": 0.3, "velocity": 4.0})
    ] = SpreadLimit()


class Zero(Record, frozen=True, kw_only=True, tag_field="law", tag="zero"):
    """Controls of zero."""


class Noise(Record, frozen=True, kw_only=True, tag_field="law", tag="noise"):
    """Controls that vary smoothly at random."""

    std: Annotated[
        Positive | tuple[NonNegative, ...],
        "standard deviation of controls, or one for each actuator [N·m]",
        example(30.0),
    ]
    time_constant: Annotated[Positive, "time over which they vary [s]", example(0.5)] = 0.5


class Pd(Record, frozen=True, kw_only=True, tag_field="law", tag="pd"):
    """Torques that hold a pose: stiffness · (pose − position) − damping · velocity."""

    pose: Annotated[
        Pose | None,
        "a keyframe, by name or number, or positions of joints that differ from the start; "
        "left out: the start",
        example("stand"),
    ] = None
    stiffness: Annotated[
        NonNegative | dict[str, NonNegative] | None,
        "[N·m/rad], for all joints or by name or pattern; left out: suited to their inertia",
        example(300.0),
    ] = None
    damping: Annotated[
        NonNegative | dict[str, NonNegative] | None,
        "[N·m·s/rad], for all joints or by name or pattern; left out: suited to the stiffness",
        example(30.0),
    ] = None


class Sampling(Record, frozen=True, kw_only=True, tag_field="law", tag="sampling"):
    """A motion found by sampling: short plans, one after another, each improved by samples."""

    plan: Annotated[Positive, "length of a plan [s]", example(0.8)] = 0.8
    period: Annotated[
        Positive, "time after which the next plan is made [s]; long is fast", example(0.05)
    ] = 0.05
    samples: Annotated[int, Range(2, 100_000), "plans tried in an iteration", example(32)] = 32
    knots: Annotated[
        int,
        Range(2, 1000),
        "points in a plan between which a sample's change is linear",
        example(6),
    ] = 6
    noise: Annotated[
        Positive,
        "largest standard deviation of a sample, as a share of half a control's range",
        example(0.3),
    ] = 0.3
    std: Annotated[
        Positive | tuple[Positive, ...] | None,
        "the same in the control's own unit, or one for each actuator [N·m]",
        example(30.0),
    ] = None


class RecordedMotion(Record, frozen=True, kw_only=True, tag_field="law", tag="demonstration"):
    """A recorded motion."""

    file: Annotated[
        Name,
        "file with columns time, JOINT/position, JOINT/velocity, JOINT/effort",
        example("walk.csv"),
    ]


class PathMotion(Record, frozen=True, kw_only=True, tag_field="law", tag="path"):
    """Positions over time; they need not be feasible.

    Without a file the robot stays in the air, or wherever it starts.
    """

    file: Annotated[
        Name | None,
        "a file with columns time and JOINT/position, also of another robot: joints that it "
        "lacks stay as they start",
        example("walk.csv"),
    ] = None


class BestMotion(Record, frozen=True, kw_only=True, tag_field="law", tag="best"):
    """The best of several motions: a held start, a path that stays there, smooth noise, samples.

    DDP improves each a little, those that cost least a little more, and the last one goes on.
    """

    iterations: Annotated[
        int,
        Range(1, 1000),
        "iterations of DDP on each; on the better half twice as many",
        example(10),
    ] = 10


Begin = Zero | Noise | Pd | Sampling | RecordedMotion | PathMotion | BestMotion


class TaskFile(Record, frozen=True, kw_only=True):
    """A control problem for vgps_ros. Units are SI: m, kg, s, rad, N, N·m."""

    model: Annotated[
        Name,
        "the robot's MJCF or URDF: a path from this file's folder, or package://PACKAGE/PATH",
        example("hopper.xml"),
    ]
    changes: Annotated[
        Changes, "changes of the model, made in memory", example({"option": {"timestep": 0.005}})
    ] = field(default_factory=Changes)
    control_period: Annotated[
        Positive,
        "time between controls, a multiple of the simulator's time step [s]",
        example(0.01),
    ]
    horizon: Annotated[
        Positive,
        "time that is trained on and scored, up to a whole control period [s]",
        example(4.0),
    ]
    lookahead: Annotated[
        NonNegative, "time that is optimised beyond the horizon, likewise [s]", example(0.6)
    ] = 0.0
    start: Annotated[Start, "the start", example({"keyframe": "stand"})] = field(
        default_factory=Start
    )
    sensors: Annotated[
        dict[str, Sensor],
        "sensors to add, by name",
        example({"height": {"type": "framepos", "body": "torso"}}),
    ] = field(default_factory=dict)
    cost: Annotated[
        tuple[CostTerm, ...],
        "terms whose sum is the cost of a step",
        example([{"sensor": "height", "index": "z", "target": 1.2, "weight": 5.0}]),
        Meta(min_length=1),
    ]
    commands: Annotated[
        dict[Name, CommandEntry],
        "what the policy is told, by name",
        example({"forward": {"range": (-0.5, 1.0)}}),
    ] = field(default_factory=dict)
    clock: Annotated[Clock | None, "a clock", example({"frequency": 2.0})] = None
    mirror: Annotated[
        MirrorEntry | None,
        "exchange of left and right, for a robot that is alike on both sides: it learns from "
        "mirror images too",
        example({"swap": [["left", "right"]], "flip": ["*_hip"]}),
    ] = None
    sensor_noise: Annotated[
        dict[str, NonNegative],
        "standard deviation by which a reading is wrong, by name or pattern, which the policy "
        "learns to bear; later ones win",
        example({"*/position": 0.01}),
    ] = field(default_factory=dict)
    observe: Annotated[
        tuple[Name | ObservedEntry, ...],
        "values that the policy reads: joint_positions, joint_velocities, "
        "last_action, commands, clock, scalars by full name, or mappings",
        example(["joint_positions", "joint_velocities", {"sensor": "up"}]),
        Meta(min_length=1),
    ] = ("joint_positions", "joint_velocities")
    history: Annotated[
        int,
        Range(0, 100),
        "number of control steps before the newest one whose readings the policy reads again",
        example(2),
    ] = 0
    fallen: Annotated[
        tuple[Limit, ...],
        "limits beyond which the robot has fallen",
        example([{"sensor": "height/z", "below": 0.7}]),
    ] = ()
    limits: Annotated[
        tuple[Limit, ...],
        "limits beyond which the executor stops the policy",
        example([{"sensor": "pitch", "beyond": 1.0}]),
    ] = ()
    marginals: Annotated[
        Marginals, "limits of the width of q", example({"std_limit": {"position": 0.3}})
    ] = field(default_factory=Marginals)
    begin: Annotated[
        Begin, "motion from which the first solve starts", example({"law": "pd", "pose": "stand"})
    ] = field(default_factory=Zero)
    optimizer: Annotated[
        Settings,
        "settings of the trajectory optimization",
        example({"ddp.regularization_floor": 0.1}),
    ] = field(default_factory=dict)
    search: Annotated[
        Settings, "settings of the policy search", example({"hidden_units": [10]})
    ] = field(default_factory=dict)
