"""Names of a model's joints, in the orders that states and controls have."""

import mujoco

from vgps_ros.core.errors import InvalidInputError


def compile_model(mjcf: str) -> mujoco.MjModel:
    """Returns the model of an MJCF text.

    Raises:
        InvalidInputError: it does not compile, or has joints other than hinges and slides.
    """
    try:
        model = mujoco.MjModel.from_xml_string(mjcf)
    except ValueError as error:
        raise InvalidInputError(f"The robot's MJCF does not compile: {error}.") from error
    if not model.njnt == model.nq == model.nv:
        raise InvalidInputError(
            f"The robot has {model.nq} positions and {model.nv} velocities of {model.njnt} joints, "
            "but each joint must be a hinge or a slide."
        )
    return model


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
