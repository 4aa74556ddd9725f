# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The parts of a task file that read sensors: cost, observations and limits."""

from typing import Annotated, Literal

from msgspec import Meta, field

from vgps_ros.tasks.schema_types import (
    Coordinates,
    Name,
    NonNegative,
    Number,
    Positive,
    Record,
    about,
)

Index = str | Annotated[int, Meta(ge=0, le=10_000)]
Indices = Index | tuple[Index, ...]


class CostTerm(Record, frozen=True, kw_only=True):
    """A term of the cost: weight · norm(sensor[index] − target) at each step, or of controls."""

    sensor: Annotated[
        Name | None,
        about("a sensor, or a scalar's full name such as height/z or hip/position", "velocity"),
    ] = None
    index: Annotated[
        Indices | None, about("parts of the sensor, by name or number; left out: all", "x")
    ] = None
    target: Annotated[
        Coordinates, about("wanted value, or one for each part, in the sensor's unit", 1.0)
    ] = 0.0
    reference: Annotated[
        Name | None,
        about(
            "file of a target that varies with time: columns with the header time,SCALAR,...",
            "reference.csv",
        ),
    ] = None
    weight: Annotated[
        NonNegative | tuple[NonNegative, ...],
        about("weight, or one for each part [1 / square of the unit]", 1.0),
    ] = 1.0
    norm: Annotated[
        Literal["quadratic", "smooth_abs"],
        about("d², or smooth_abs, √(d² + width²) − width, which is milder far away", "smooth_abs"),
    ] = "quadratic"
    width: Annotated[
        Positive, about("deviation below which smooth_abs is round, in the sensor's unit", 0.1)
    ] = 0.1
    terminal: Annotated[bool, about("whether only the last state counts", True)] = False
    control: Annotated[
        Name | tuple[Name, ...] | None,
        about("instead of a sensor, actuators whose u² counts [N²·m²]: all, or names", "all"),
    ] = None


class Except(Record, frozen=True, kw_only=True):
    """Joints that are left out."""

    excluded: Annotated[
        tuple[Name, ...], about("names or patterns of joints to leave out", ["root_x"])
    ] = field(name="except")


class Observation(Record, frozen=True, kw_only=True):
    """Values that the policy reads: of one joint, one sensor, or all joints but some."""

    joint: Annotated[Name | None, about("a hinge or slide, or a pattern", "hip")] = None
    form: Annotated[
        Literal["position", "velocity", "sin_cos"],
        about("with joint, how it is read; sin_cos gives sine and cosine of an angle", "sin_cos"),
    ] = field(name="as", default="position")
    sensor: Annotated[Name | None, about("a sensor", "up")] = None
    index: Annotated[
        Indices | None, about("parts of the sensor, by name or number; left out: all", "z")
    ] = None
    joint_positions: Annotated[
        Except | None,
        about("positions of all hinges and slides but these", {"except": ["root_x"]}),
    ] = None
    joint_velocities: Annotated[
        Except | None,
        about("velocities of all hinges and slides but these", {"except": ["root_x"]}),
    ] = None


class Limit(Record, frozen=True, kw_only=True):
    """A bound of one scalar, which is crossed below, above, or on either side of zero."""

    sensor: Annotated[
        Name, about("a sensor, or a scalar's full name such as height/z or hip/position", "height")
    ]
    index: Annotated[Index | None, about("the part of the sensor", "z")] = None
    below: Annotated[Number | None, about("crossed below this value", 0.7)] = None
    above: Annotated[Number | None, about("crossed above this value", 2.0)] = None
    beyond: Annotated[NonNegative | None, about("crossed where |value| is above this", 1.0)] = None
