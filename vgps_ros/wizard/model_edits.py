# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Changes a robot's model, in memory, as its first task file needs it."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.robot.controls import ControlKind
from vgps_ros.simulation.controls import controls_of
from vgps_ros.simulation.model import compile_model, try_model
from vgps_ros.simulation.model_changes import changed_spec, self_contained
from vgps_ros.wizard.recognition import recognise_robot
from vgps_ros.wizard.robot import HINGE, SLIDE, bottoms_of, is_wheel, loops_of, lowest_points

_SHAKEN = 25.0  # acceleration of a joint by its motor that no policy can steer, of g/l
_DROPPED = {"visual": "what only shows", "meshes": "meshes"}  # the first one that is enough


@dataclass
class EditedModel:
    """A robot's model with the changes that its first task file shall make."""

    model: mujoco.MjModel  # compiled with all changes
    driven: mujoco.MjModel  # the model before servos took the place of its actuators
    changes: dict[str, Any]  # as `changes` of a task file has them
    notes: list[str]  # sentences for the user, each on a change that was not asked for


def edit_model(path: Path, locks: dict[str, Any], *, servos: bool) -> EditedModel:
    """Returns the model in a file as a task can begin with it.

    Locks are of joints, as `changes: {joints: ...}` has them. Servos take the place of all
    actuators where that is asked for, or where motors are too strong for legs.

    Raises:
        InvalidInputError: the model does not compile, or has nothing that could be driven.
    """
    changes, notes = dict[str, Any](), list[str]()

    def compiled(**more: Any) -> mujoco.MjModel:
        changes.update(more)
        text = try_model(lambda: [self_contained(changed_spec(path, changes, {}))])
        return compile_model(text, is_tried=True)

    try:
        model = compiled()
    except InvalidInputError as error:  # files of meshes may be elsewhere
        for what in _DROPPED:
            with suppress(InvalidInputError):
                model = compiled(drop=[what])
                break
        else:
            raise
        cause = str(error).removeprefix("model: ").partition(";")[0].rstrip(".")
        notes.append(f"Without {_DROPPED[what]}, since {cause}.")
    if locks:
        model = compiled(joints=locks)
    if (root := _root_to_free(model)) is not None:
        model = compiled(free_bodies=[root])
    if _lacks_ground(model):
        model = compiled(floor=True)
    if wheels := _leg_wheels(model):
        model = compiled(joints=locks | {wheel: {"lock": 0.0} for wheel in wheels})
        notes.append(f"Locked the wheels {', '.join(wheels)}: legs stand on them as on feet.")
    if foreign := _foreign_bodies(model):
        model = compiled(remove_bodies=foreign)
    driven = model
    if model.nu and (servos or has_motors_too_strong(model)):
        model = compiled(remove_actuators=["*"])
    return EditedModel(model, driven, changes, notes)


def _foreign_bodies(model: mujoco.MjModel) -> list[str]:
    """Returns the bodies that are no part of the robot's task.

    Those move beside a robot with legs, and are not called a target; or nothing moves them but a
    user's mouse (mocap), and they are welded to the robot, which they would hold.
    """
    robot = recognise_robot(model)
    trees = {int(i) for i in model.dof_treeid if robot.feet} - {*robot.trees}
    names = [model.body(np.flatnonzero(model.body_treeid == i)[0]).name for i in sorted(trees)]
    tied = {end for ends in loops_of(model) for end in ends if model.body_mocapid[end] >= 0}
    return [n for n in names if "target" not in n] + [model.body(i).name for i in sorted(tied)]


def _root_to_free(model: mujoco.MjModel) -> str | None:
    """Returns the robot's root if it shall get a free joint.

    It goes and turns anywhere by joints of its own, three slides and three hinges that no actuator
    drives; or its legs would carry it, but it has no joint, as in a URDF.
    """
    if (root := _root_with_hanging_legs(model)) is not None:
        return root
    robot = recognise_robot(model)
    kinds = sorted(model.jnt_type[robot.base].tolist())
    return robot.name if kinds == 3 * [SLIDE] + 3 * [HINGE] else None


def _leg_wheels(model: mujoco.MjModel) -> list[str]:
    """Returns the joints of wheels at the ends of legs, where a robot would have no feet else."""
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


def _lacks_ground(model: mujoco.MjModel) -> bool:
    """Returns whether nothing would stop the robot's fall."""
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
