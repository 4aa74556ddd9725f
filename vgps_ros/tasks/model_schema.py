# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The part of a task file that is about the model: changes of it, and added sensors.

Each field has a description with its unit, and an example: errors and editors show them.
"""

from typing import Annotated, Literal

from msgspec import Meta, field

from vgps_ros.simulation.sensor_types import SENSOR_TYPES
from vgps_ros.tasks.schema_types import (
    Bits,
    Count,
    Name,
    NonNegative,
    Number,
    Positive,
    Record,
    Vector,
    about,
)

MOST_CONTACTS = 31  # pairs, since MuJoCo marks them by the bits of an integer


class Option(Record, frozen=True, kw_only=True):
    """Options of the simulation, under MuJoCo's names; the model keeps those that are left out."""

    timestep: Annotated[Positive | None, about("the simulator's time step [s]", 0.005)] = None
    integrator: Annotated[
        Literal["Euler", "RK4", "implicit", "implicitfast"] | None,
        about("the method of integration; implicitfast suits stiff joints", "implicitfast"),
    ] = None
    solver: Annotated[
        Literal["PGS", "CG", "Newton"] | None, about("the solver of constraints", "Newton")
    ] = None
    cone: Annotated[
        Literal["pyramidal", "elliptic"] | None, about("the form of friction cones", "pyramidal")
    ] = None
    jacobian: Annotated[
        Literal["dense", "sparse", "auto"] | None, about("the form of Jacobians", "auto")
    ] = None
    iterations: Annotated[Count | None, about("most iterations of the solver", 50)] = None
    tolerance: Annotated[NonNegative | None, about("the solver's tolerance", 1e-12)] = None
    ls_iterations: Annotated[Count | None, about("most iterations of its line search", 50)] = None
    ls_tolerance: Annotated[NonNegative | None, about("its line search's tolerance", 0.01)] = None
    noslip_iterations: Annotated[Count | None, about("most iterations against slip", 0)] = None
    noslip_tolerance: Annotated[NonNegative | None, about("their tolerance", 1e-6)] = None
    ccd_iterations: Annotated[Count | None, about("most iterations of collisions", 35)] = None
    ccd_tolerance: Annotated[NonNegative | None, about("tolerance of collisions", 1e-6)] = None
    impratio: Annotated[
        Positive | None, about("frictional to normal impedance of contacts", 1.0)
    ] = None
    gravity: Annotated[Vector | None, about("gravity, x y z [m/s²]", (0.0, 0.0, -9.81))] = None
    wind: Annotated[Vector | None, about("the medium's velocity [m/s]", (0.0, 0.0, 0.0))] = None
    magnetic: Annotated[Vector | None, about("magnetic flux [T]", (0.0, -0.5, 0.0))] = None
    density: Annotated[NonNegative | None, about("the medium's density [kg/m³]", 1000.0)] = None
    viscosity: Annotated[NonNegative | None, about("its viscosity [Pa·s]", 0.1)] = None
    disable: Annotated[
        tuple[Name, ...], about("MuJoCo's flags to switch off", ["contact", "constraint"])
    ] = ()
    enable: Annotated[tuple[Name, ...], about("MuJoCo's flags to switch on", ["invdiscrete"])] = ()


class JointChange(Record, frozen=True, kw_only=True):
    """Changes of joints; units are those of a hinge, and of a slide with m and N instead."""

    damping: Annotated[NonNegative | None, about("damping [N·m·s/rad]", 1.0)] = None
    stiffness: Annotated[NonNegative | None, about("stiffness of a spring [N·m/rad]", 0.0)] = None
    springref: Annotated[Number | None, about("position at which it rests [rad]", 0.0)] = None
    armature: Annotated[NonNegative | None, about("the rotor's inertia [kg·m²]", 0.02)] = None
    frictionloss: Annotated[NonNegative | None, about("dry friction [N·m]", 0.0)] = None
    limited: Annotated[bool | None, about("whether the range is a limit", True)] = None
    range: Annotated[
        tuple[Number, Number] | None, about("lowest and highest position [rad]", (-1.0, 1.0))
    ] = None
    margin: Annotated[
        NonNegative | None, about("distance at which a limit begins to act [rad]", 0.0)
    ] = None
    solref_limit: Annotated[
        tuple[Number, Number] | None,
        about("MuJoCo's solref of the limit: time [s], damping ratio", (0.04, 1.0)),
    ] = None
    solimp_limit: Annotated[
        tuple[Number, ...] | None,
        about("MuJoCo's solimp of the limit, up to 5 numbers", (0.0, 0.95, 0.1, 0.5, 2.0)),
    ] = None
    actfrcrange: Annotated[
        tuple[Number, Number] | None,
        about("lowest and highest torque of all its actuators [N·m]", (-24.0, 24.0)),
    ] = None


class GeomChange(Record, frozen=True, kw_only=True):
    """Changes of geoms: how they touch."""

    solref: Annotated[
        tuple[Number, Number] | None,
        about("MuJoCo's solref of contacts: time [s], damping ratio", (0.04, 1.0)),
    ] = None
    solimp: Annotated[
        tuple[Number, ...] | None,
        about(
            "MuJoCo's solimp of contacts, up to 5 numbers; a first one of 0 lets force start "
            "smoothly",
            (0.0, 0.95, 0.02, 0.5, 2.0),
        ),
    ] = None
    friction: Annotated[
        NonNegative | tuple[NonNegative, ...] | None,
        about("friction: sliding, torsional [m], rolling [m]; the last two may be left out", 1.0),
    ] = None
    condim: Annotated[
        Literal[1, 3, 4, 6] | None, about("dimensions of a contact's force; 1: no friction", 3)
    ] = None
    contype: Annotated[Bits | None, about("bits of what it touches others as", 1)] = None
    conaffinity: Annotated[Bits | None, about("bits of what others it touches", 1)] = None
    priority: Annotated[Count | None, about("of two, the higher one's values count", 1)] = None
    solmix: Annotated[NonNegative | None, about("weight of its values in the mean", 1.0)] = None
    margin: Annotated[NonNegative | None, about("distance at which contact begins [m]", 0.0)] = None
    gap: Annotated[NonNegative | None, about("part of it that bears no force [m]", 0.0)] = None


class Motor(Record, frozen=True, kw_only=True):
    """A motor that is added."""

    joint: Annotated[
        Name,
        about(
            "the joint that it drives; a pattern adds a motor for each hinge and slide that it "
            "matches, named as its joint",
            "hip",
        ),
    ]
    gear: Annotated[Number, about("torque for a control of 1 [N·m]", 1.0)] = 1.0
    limit: Annotated[
        Positive | None, about("largest control either way; with a gear of 1 in [N·m]", 24.0)
    ] = None


class Changes(Record, frozen=True, kw_only=True):
    """Changes of the model, made in memory; a pattern such as *_hip names several things."""

    option: Annotated[Option, about("options of the simulation", {"timestep": 0.005})] = field(
        default_factory=Option
    )
    joints: Annotated[
        dict[str, JointChange],
        about("changes by a joint's name or pattern; later ones win", {"*": {"damping": 1.0}}),
    ] = field(default_factory=dict)
    geoms: Annotated[
        dict[str, GeomChange],
        about("changes by a geom's name or pattern; later ones win", {"*foot": {"condim": 3}}),
    ] = field(default_factory=dict)
    remove_actuators: Annotated[
        tuple[Name, ...], about("names or patterns of actuators to remove first", ["*"])
    ] = ()
    actuators: Annotated[
        dict[str, Motor], about("motors to add, by name", {"hip": {"joint": "hip", "limit": 24.0}})
    ] = field(default_factory=dict)
    floor: Annotated[bool, about("whether to add a level floor at height 0, named floor", True)] = (
        False
    )
    only_contacts: Annotated[
        Annotated[tuple[tuple[Name, Name], ...], Meta(max_length=MOST_CONTACTS)] | None,
        about(
            "pairs of names or patterns of geoms; all other contacts are switched off",
            [["floor", "*foot"]],
        ),
    ] = None


class Frame(Record, frozen=True, kw_only=True):
    """The one object whose frame counts."""

    body: Annotated[
        Name | None, about("a body: its centre of mass and principal axes", "torso")
    ] = None
    xbody: Annotated[Name | None, about("a body: its frame as the MJCF has it", "torso")] = None
    geom: Annotated[Name | None, about("a geom", "left_foot")] = None
    site: Annotated[Name | None, about("a site", "imu")] = None
    camera: Annotated[Name | None, about("a camera", "track")] = None


class Sensor(Frame, frozen=True, kw_only=True):
    """A sensor of MuJoCo that is added to the model. It measures one object."""

    type: Annotated[
        str,
        Meta(
            description="MuJoCo's name of the sensor's type",
            examples=["framepos"],
            extra_json_schema={"enum": list(SENSOR_TYPES)},
        ),
    ]
    joint: Annotated[Name | None, about("a joint", "hip")] = None
    tendon: Annotated[Name | None, about("a tendon", "hamstring")] = None
    actuator: Annotated[Name | None, about("an actuator", "hip_motor")] = None
    relative_to: Annotated[
        Frame | None, about("an object to measure against", {"xbody": "torso"})
    ] = None
    cutoff: Annotated[
        Positive | None,
        about("largest value, in the sensor's unit; for distances the farthest seen [m]", 1.0),
    ] = None
