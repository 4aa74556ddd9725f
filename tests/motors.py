# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Robots of hinges in a row, each with an actuator that a test chooses."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco

from vgps_ros.robot.controls import Controls
from vgps_ros.simulation.controls import controls_of


def robot(*actuators: str, joint: str = "") -> mujoco.MjModel:
    """A model of hinges j0, j1, ... with these actuators, in which {} is the name of the joint."""
    bodies = "".join(
        f'<body pos="{i} 0 0"><joint name="j{i}" axis="0 1 0" {joint}/>'
        '<geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="1"/></body>'
        for i in range(len(actuators))
    )
    driven = "".join(each.format(f"j{i}") for i, each in enumerate(actuators))
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><compiler angle='radian' autolimits='true'/><worldbody>{bodies}</worldbody>"
        f"<actuator>{driven}</actuator></mujoco>"
    )


def named(controls: Controls, names: Sequence[str]) -> Controls:
    """The same controls of joints with other names."""
    return replace(controls, names=tuple(names))


def motors(*limits: float) -> Controls:
    """The controls of a robot of motors with these limits to both sides; its state is (q, q')."""
    return controls_of(
        robot(*(f'<motor joint="{{}}" ctrlrange="{-limit} {limit}"/>' for limit in limits))
    )
