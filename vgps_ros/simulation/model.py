"""Compiles a robot's MJCF, and tells its joints, in the order of the state, and torque limits."""

from contextlib import suppress
from xml.etree import ElementTree

import mujoco
import numpy as np

from vgps_ros.core.checks import quoted
from vgps_ros.core.dynamics import CONTROL_BOUND
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.records import Array


def compile_model(mjcf: str) -> mujoco.MjModel:
    """Returns the model of an MJCF text.

    Raises:
        InvalidInputError: the text does not compile, refers to files, lacks a joint's name, or has
            joints other than hinges and slides.
    """
    _check_self_contained(mjcf)
    try:
        model = mujoco.MjModel.from_xml_string(mjcf)
        mujoco.MjData(model)
    except (ValueError, mujoco.FatalError) as error:
        raise InvalidInputError(f"The robot's MJCF does not compile: {error}.") from error
    if not model.njnt == model.nq == model.nv:
        raise InvalidInputError(
            f"The robot has {model.nq} positions and {model.nv} velocities of {model.njnt} joints, "
            "but each joint must be a hinge or a slide."
        )
    if not (model.njnt and all(joint_names(model))):
        raise InvalidInputError(
            f"The robot has the joints {joint_names(model)}, but it must have one, and each a name."
        )
    return model


def _check_self_contained(mjcf: str) -> None:
    """Refuses references to files: the text may come from anywhere, and files are private."""
    with suppress(ElementTree.ParseError):  # MuJoCo has the better message for it
        for element in ElementTree.fromstring(mjcf).iter():
            files = [value for name, value in element.items() if name.startswith("file")]
            if files:
                raise InvalidInputError(
                    f"The robot's MJCF refers to the file {quoted(files[0])}, but its text must "
                    "hold all of the robot; leave out meshes, textures and includes."
                )


def joint_names(model: mujoco.MjModel) -> list[str]:
    """Returns all joints, in the order of positions and velocities in the state."""
    return [model.joint(i).name for i in range(model.njnt)]


def hinge_names(model: mujoco.MjModel) -> list[str]:
    """Returns the joints that turn, in the order of the state."""
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == hinge]


def actuated_joint_names(model: mujoco.MjModel) -> list[str]:
    """Returns the joints that the controls drive, in the order of the controls."""
    return [model.joint(model.actuator(i).trnid[0]).name for i in range(model.nu)]


def model_torque_limits(model: mujoco.MjModel) -> Array:
    """Returns the largest control of each actuator that the model allows, shape (n_u,), [N·m].

    MuJoCo limits an actuator's control, its force, and the forces on its joint; of a range, the
    smaller side counts. A joint without any has CONTROL_BOUND.
    """
    gain, gear = np.abs(model.actuator_gainprm[:, 0]), np.abs(model.actuator_gear[:, 0])
    joints = model.actuator_trnid[:, 0]
    limits = np.full(model.nu, CONTROL_BOUND)
    for limited, ranges, force_per_control in (
        (model.actuator_ctrllimited, model.actuator_ctrlrange, np.ones(model.nu)),
        (model.actuator_forcelimited, model.actuator_forcerange, gain),
        (model.jnt_actfrclimited[joints], model.jnt_actfrcrange[joints], gain * gear),
    ):
        largest = np.minimum(-ranges[:, 0], ranges[:, 1]).clip(min=0.0)
        limits = np.where(limited, np.minimum(limits, largest / force_per_control), limits)
    return limits
