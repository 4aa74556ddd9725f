# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The numbers of a task for a robot with legs, in the robot's own units.

Robots that are alike but for their size move alike, once lengths are counted in the height of
their hips l, times in √(l/g), speeds in √(g l), impulses in m √(g l) and torques in m g l (R. McN.
Alexander, Principles of Animal Locomotion, 2003, on Froude's number). So each number here is one
without a unit, times a unit of the robot, and what holds for one size holds for all.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vgps_ros.wizard.robot import FREE, SLIDE, Robot

_STEPS_A_PERIOD = 4  # of the simulator
_HORIZON, _LOOKAHEAD = 50, 25  # [control periods]
_MOTION, _SELECTION = 400, 500  # of the policy: for new situations, and to be chosen [periods]
_SINKING = 0.015  # depth to which the weight sinks into the ground, of l
_CONTACT_WIDTH = 0.03  # depth at which contact is fully hard, of l
_LIMIT = 0.23  # time constant of a joint's limit, of √(l/g)
_SERVO_DAMPING, _SERVO_ARMATURE = 0.29, 0.034  # of its limit and √(l/g), l/g
_TURN = 0.14  # fastest turning, of √(g/l)
_TURNING = 200.0  # weight of the turning rate, of l/g
_FLOOR = 3.4  # of the optimizer's regularization, by the velocities of joints, of l/g
_SLIP = 13.0  # weight of a foot's speed on the ground, of 1/(g l)
_SWING = 0.12  # height of a swing, of l
_START = (0.035, 0.06, 0.017)  # spread of starts: places by l, speeds by √(g l), rates by √(g/l)
_LIMITS = (1.0, 1.2, 0.64)  # of marginals, alike
_START_ANGLE, _LIMIT_ANGLE = 0.01, 0.3  # [rad]
_STRONGEST = 3.0  # torque of a joint that a robot of legs can use, of m g l
_STRIDE = 0.53  # angle by which a joint moves in a step [rad]
_TIME = 0.172  # √(l/g) of a quadruped of 30 cm, for what has no legs [s]
_NOISE = {"position": 0.005, "velocity": 0.034, "turning": 0.0085, "up": 0.01, "speed": 0.02}


@dataclass(frozen=True)
class _Stance:
    """What differs by how many feet stand, and where."""

    period: float  # of control, of √(l/g)
    speed: float  # fastest speed ahead, of √(g l)
    rate: float  # of each foot's steps, of √(g/l)
    push: float  # largest push, of m √(g l)
    tracking: float  # weight of the speed's error, of 1/√(g l)
    width: float  # error of the speed up to which its cost is quadratic, of √(g l)
    height: float  # weight of the trunk's height, of 1/l²
    tilt: float  # weight of the trunk's tilt
    step: float  # weight of a foot's height, of 1/l²
    iterations: int  # of the training
    solves: int  # DDP iterations in one of them
    new_solves: int  # those of a new situation
    carried: float = 1.0  # load of a leg in a step, by that of standing on four legs


_MANY = _Stance(0.1125, 0.4, 0.6, 1.8, 13.5, 0.12, 40.0, 20.0, 120.0, 22, 2, 16)
# Side by side: it may fall over its feet.
_TWO = _Stance(0.1125, 0.22, 0.36, 0.1, 20.0, 0.08, 105.0, 50.0, 240.0, 26, 3, 24, carried=2.0)
_ONE = replace(_TWO, period=0.063, rate=0.6, iterations=30, solves=2, new_solves=16)  # it hops
# One behind the other, as a cheetah's:
_IN_LINE = _Stance(0.1125, 0.22, 0.36, 0.4, 20.0, 0.08, 40.0, 20.0, 120.0, 22, 2, 16)


def _legs_period(robot: Robot) -> float:
    """Returns the control period of a robot with legs, 50 Hz for a quadruped of 30 cm [s]."""
    wanted = _stance(robot).period * robot.time
    grid = 1e-3 if wanted > 0.01 else 1e-4
    return round(max(1, round(wanted / grid)) * grid, 4)


def _stance(robot: Robot) -> _Stance:
    if len(robot.feet) > 2:
        return _MANY
    return _ONE if robot.hops else _TWO if robot.is_biped else _IN_LINE


def legged_numbers(robot: Robot) -> dict[str, Any]:
    """Returns the numbers of a robot with legs of which the template of task files speaks."""
    stance, length, time = _stance(robot), robot.leg, robot.time
    speed, period = length / time, _legs_period(robot)
    fast = stance.speed * speed
    noise = {
        "*/position": _NOISE["position"],
        "*/velocity": _NOISE["velocity"] / time,
        f"{robot.new_sensor('turning')}/*": _NOISE["turning"] / time,
        f"{robot.new_sensor('up')}/*": _NOISE["up"],
    }
    if robot.is_biped:  # its feet are placed by an estimate of the velocity
        noise[f"{robot.new_sensor('velocity')}/*"] = _NOISE["speed"] * speed
    return {
        "step": period / _STEPS_A_PERIOD,
        "period": period,
        "horizon": _HORIZON * period,
        "lookahead": _LOOKAHEAD * period,
        "motion": _MOTION * period,
        "selection": _SELECTION * period,
        "soft": (_SINKING**0.5) * time,
        "contact_width": _CONTACT_WIDTH * length,
        "soft_limit": _LIMIT * time,
        "std": _spread(robot, _START, _START_ANGLE, 0.0),
        "std_limit": _spread(robot, _LIMITS, _LIMIT_ANGLE, np.inf),
        "sensor_noise": noise,
        "ahead": [0.0 if robot.hops else -fast / 2, fast],
        "aside": [-0.4 * fast, 0.4 * fast],
        "about": [-_TURN / time, _TURN / time],
        "rate": stance.rate / time,
        "push": stance.push * robot.mass * speed,
        "fall_lead": 1.7 * (robot.height / robot.gravity) ** 0.5,  # of a pendulum
        "tracking": stance.tracking / speed,
        "width": stance.width * speed,
        "turning": _TURNING * time**2,
        "lifts": stance.height / length**2,
        "steadies": stance.tilt,
        "stepping": stance.step / length**2,
        "swing": _SWING * length,
        "slip": _SLIP / speed**2,
        "regularization": _FLOOR * time**2,
        "iterations": stance.iterations,
        "solves": stance.solves,
        "new_solves": stance.new_solves,
    }


def _spread(
    robot: Robot, scale: tuple[float, float, float], angle: float, cyclic: float
) -> dict[str, Any]:
    """Returns the spread of a state, as a task file has it: of angles, lengths and their rates."""
    units = robot.leg, robot.leg / robot.time, 1.0 / robot.time
    place, speed, rate = (number * unit for number, unit in zip(scale, units, strict=True))
    overrides = dict[str, float]()
    for j, kind in enumerate(robot.model.jnt_type):
        name = robot.model.joint(j).name
        if kind == FREE:
            overrides |= {f"{name}/[xyz]": place, f"{name}/v[xyz]": speed}
        elif kind == SLIDE:
            overrides |= {f"{name}/position": place, f"{name}/velocity": speed}
    overrides |= dict.fromkeys(robot.cyclic_places(), cyclic)
    return {"position": angle, "velocity": rate, "overrides": overrides}


def servo_numbers(robot: Robot, limit: float) -> dict[str, float]:
    """Returns the servo of a joint whose motor is as strong as a limit, damped as a gear damps.

    Its whole force is at 2/3 rad: of stiffness [N·m/rad], damping [N·m·s/rad], armature [kg·m²].
    """
    time = robot.time if robot.feet else _TIME
    damping, armature = _SERVO_DAMPING * time, _SERVO_ARMATURE * time**2
    return {"stiffness": 1.5 * limit, "damping": damping * limit, "armature": armature * limit}


def servo_reach(robot: Robot, stiffness: float, damping: float, load: float) -> float:
    """Returns how far a servo's target goes from its pose in a step [rad], at most half a turn.

    A stiff servo moves its joint by what it is told; one that is damped needs a target further
    away, the faster the robot steps, and so does a soft one that carries a load.

    Args:
        robot: a robot with legs.
        stiffness: of the servo [N·m/rad].
        damping: of the servo and its joint [N·m·s/rad].
        load: torque that the joint needs [N·m].
    """
    stance = _stance(robot)
    rate = 2.0 * np.pi * stance.rate / robot.time
    stride = _STRIDE * np.hypot(1.0, rate * damping / stiffness)
    return float(min(max(stride, stance.carried * load / stiffness), np.pi))


def strongest(robot: Robot) -> float:
    """Returns the largest torque that a servo of a robot with legs gets [N·m].

    A model may allow any torque; a servo as strong as that would be one of gears as heavy.
    """
    return float(f"{_STRONGEST * robot.mass * robot.gravity * robot.leg:.3g}")
