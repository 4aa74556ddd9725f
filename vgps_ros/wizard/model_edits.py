# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Says what has to be changed of a model before its first task file is written."""

import mujoco
import numpy as np

from vgps_ros.robot.controls import ControlKind
from vgps_ros.simulation.controls import controls_of
from vgps_ros.wizard.robot import (
    HINGE,
    SLIDE,
    bottoms_of,
    is_wheel,
    loops_of,
    lowest_points,
    recognise_robot,
)

_SHAKEN = 25.0  # acceleration of a joint by its motor that no policy can steer, of g/l


def foreign_bodies(model: mujoco.MjModel) -> list[str]:
    """Returns the bodies that are no part of the robot's task.

    Those move beside a robot with legs, and are not called a target; or nothing moves them but a
    user's mouse (mocap), and they are welded to the robot, which they would hold.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    robot = recognise_robot(model)
    trees = {int(i) for i in model.dof_treeid if robot.feet} - {*robot.trees}
    names = [model.body(np.flatnonzero(model.body_treeid == i)[0]).name for i in sorted(trees)]
    tied = {end for ends in loops_of(model) for end in ends if model.body_mocapid[end] >= 0}
    return [n for n in names if "target" not in n] + [model.body(i).name for i in sorted(tied)]


def root_to_free(model: mujoco.MjModel) -> str | None:
    """Returns the robot's root if it shall get a free joint.

    It goes and turns anywhere by joints of its own, three slides and three hinges that no actuator
    drives; or its legs would carry it, but it has no joint, as in a URDF.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    if (root := _root_with_hanging_legs(model)) is not None:
        return root
    robot = recognise_robot(model)
    kinds = sorted(model.jnt_type[robot.base].tolist())
    return robot.name if kinds == 3 * [SLIDE] + 3 * [HINGE] else None


def leg_wheels(model: mujoco.MjModel) -> list[str]:
    """Returns the joints of wheels at the ends of legs, where a robot would have no feet else.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    robot = recognise_robot(model)
    if robot.feet or not robot.base:
        return []
    bottoms, found = bottoms_of(robot), list[str]()
    for j in robot.hinges:
        body = int(model.jnt_bodyid[j])
        shapes = np.flatnonzero((model.geom_bodyid == body) & np.isfinite(bottoms))
        hinges = np.isin(model.jnt_bodyid[robot.hinges], robot.chain(body)).sum()
        if hinges > 2 and shapes.size and is_wheel(robot, body, shapes):
            found.append(model.joint(j).name)
    return found


def lacks_ground(model: mujoco.MjModel) -> bool:
    """Returns whether nothing would stop the robot's fall.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    robot = recognise_robot(model)
    is_held = not robot.base or not robot.gravity or robot.kind == "swimmer"
    return not is_held and not (model.body_weldid[model.geom_bodyid] == 0).any()


def _root_with_hanging_legs(model: mujoco.MjModel) -> str | None:
    """Returns a body without a joint from which two limbs or more hang lower than all else of it.

    Such a limb has two hinges or more, goes down rather than aside, and ends as low as another.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    bodies, own = np.arange(model.nbody), model.body_treeid
    lows = data.xpos[:, 2].copy()  # of each body, or of its lowest shape
    bottoms = lowest_points(model, data)
    np.minimum.at(lows, model.geom_bodyid[np.isfinite(bottoms)], bottoms[np.isfinite(bottoms)])
    for root in np.flatnonzero((model.body_parentid == 0) & (own < 0) & (bodies > 0)):
        is_part = model.body_rootid == root
        limbs = list[tuple[float, float]]()  # the heights of hip and end
        for tree in np.unique(own[is_part & (own >= 0)]):
            limb = np.flatnonzero(is_part & (own == tree))
            hinges = np.flatnonzero(np.isin(model.jnt_bodyid, limb) & (model.jnt_type == HINGE))
            hip, end = data.xpos[limb[0]], limb[lows[limb].argmin()]
            aside = np.linalg.norm(data.xpos[end][:2] - hip[:2])
            if len(hinges) > 1 and hip[2] - lows[end] > aside:
                limbs.append((float(hip[2]), float(lows[end])))
        lowest = min((end for _, end in limbs), default=0.0)
        legs = [hip - end for hip, end in limbs if end < lowest + 0.1 * (hip - end)]
        if len(legs) > 1 and lows[is_part & (own < 0)].min() > lowest + 0.3 * max(legs):
            return str(model.body(root).name)
    return None


def has_motors_too_strong(model: mujoco.MjModel) -> bool:
    """Returns whether a robot with legs has motors of torques that would shake them.

    Such a motor at its limit turns its joint so fast within one control period that no policy can
    steer it. A servo can, whose loop closes at each step of the simulator.

    Raises:
        InvalidInputError: no actuator drives a joint, and no joint could have one.
    """
    robot = recognise_robot(model)
    if not robot.feet or not robot.motors:
        return False
    controls, motors = controls_of(model), robot.motors
    if {*controls.kinds} != {ControlKind.TORQUE}:
        return False
    dofs = model.jnt_dofadr[[*motors.values()]]
    accelerations, torques = np.zeros((2, len(dofs), model.nv))
    torques[range(len(dofs)), dofs] = controls.largest[[*motors]]
    mujoco.mj_solveM(model, robot.data, accelerations, torques)
    largest = accelerations[range(len(dofs)), dofs].max()
    return bool(largest * robot.time**2 > _SHAKEN)
