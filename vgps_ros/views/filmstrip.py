# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Filmstrips and moving pictures of a robot, which MuJoCo renders without a screen.

The pictures show the robot's own MJCF model. A sky and a chequered ground are added where the
model has none.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.figure import Figure
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray
from PIL import Image

from vgps_ros import DRAWS_BY
from vgps_ros.core.checks import quote
from vgps_ros.core.errors import VgpsError
from vgps_ros.search.run_record import RunRecord
from vgps_ros.views.robot_shape import RobotShape

_FRAMES = 5  # number of frames in a filmstrip
_RATE = 25  # frames per second of a moving picture
_SIZE = (360, 480)  # height and width of a frame of a filmstrip [pixels]
_GIF_SIZE = (200, 360)  # height and width of a frame of a moving picture [pixels]
_COLOURS = 48  # number of colours in a moving picture
_LIBRARIES = ("egl", "osmesa", "cgl")
_MARGIN = 1.25  # width of the view, as a multiple of the robot's
_DEPTH = 0.3  # depth of the ground below a robot that moves in a horizontal plane [m]


class RenderingError(VgpsError):
    """Raised when MuJoCo cannot draw on this machine."""


def frames(mjcf: str, states: NDArray, height: int, width: int) -> Iterator[NDArray[np.uint8]]:
    """Yields a picture of the robot in each state, shape (height, width, 3).

    The camera follows the centre of mass, at a distance that shows the whole robot in all states.

    Raises:
        RenderingError: MuJoCo cannot draw without a screen here.
    """
    # MuJoCo's own default, glfw, would need a screen.
    own = "cgl" if sys.platform == "darwin" else "egl"
    chosen = os.environ.get(DRAWS_BY) or os.environ.get("MUJOCO_GL", "")
    chosen = {"disable": "", "glfw": ""}.get(chosen, chosen).lower().strip()
    if chosen not in ("", *_LIBRARIES):
        raise RenderingError(
            f"MUJOCO_GL is {quote(chosen)}, but must be one of {', '.join(_LIBRARIES)}; set one "
            "that is installed, or leave it out."
        )
    try:
        gl_context.GLContext = import_module(f"mujoco.{chosen or own}").GLContext
        model = _with_surroundings(mjcf)
        renderer = mujoco.Renderer(model, height, width)
    except (AttributeError, ImportError, RuntimeError, ValueError, mujoco.FatalError) as error:
        raise RenderingError(
            f"MuJoCo cannot draw here with MUJOCO_GL={chosen or own}; install libegl1, "
            f"or libosmesa6 and set MUJOCO_GL=osmesa: {error}"
        ) from error
    with renderer:
        _show_all(model)
        shape, camera, option = RobotShape(model), mujoco.MjvCamera(), mujoco.MjvOption()
        frames = model.body_mass < 1e-4 * model.body_mass.sum()  # links that are only frames
        model.body_inertia[frames] = 0.0  # whose box would hide all others
        bare = model.body_geomnum[~frames] == 0  # as of a robot without its meshes
        option.flags[mujoco.mjtVisFlag.mjVIS_INERTIA] = 2 * bare.sum() > bare.size
        camera.azimuth, camera.elevation = 90, -89 if shape.plane == (0, 1) else -8
        half_view = np.tan(np.deg2rad(model.vis.global_.fovy) / 2)
        half_height, depth = (
            _extent(shape, states, width / height) if shape.names else (model.stat.extent, 0.0)
        )
        camera.distance = _MARGIN * half_height / half_view + depth
        for state in states:
            camera.lookat[:] = shape.centre_of_mass(state)
            mujoco.mj_forward(model, shape.data)
            renderer.update_scene(shape.data, camera, option)
            # Shadows take long to compute without a graphics card.
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
            yield renderer.render()


def _extent(shape: RobotShape, states: NDArray, aspect: float) -> tuple[float, float]:
    """Returns half the height of a view of the robot in all states, and half the depth [m]."""
    (depth_axis,) = {0, 1, 2} - set(shape.plane)
    wide, high, deep = np.max(
        [
            np.abs(shape.axes(x) - shape.centre_of_mass(x))[:, :, [*shape.plane, depth_axis]].max(
                (0, 1)
            )
            for x in states[:: max(1, len(states) // 50)]
        ],
        axis=0,
    )
    return float(max(high, wide / aspect)), float(deep)


def filmstrip(run: RunRecord) -> Figure | None:
    """Draws the robot at evenly spaced times, side by side.

    Returns:
        The figure, or None if the run has no motion under the policy.

    Raises:
        RenderingError: MuJoCo cannot draw without a screen here.
    """
    if run.executed_states is None:
        return None
    steps = np.linspace(0, len(run.executed_states) - 1, _FRAMES).astype(int)
    pictures = frames(run.mjcf, run.executed_states[steps], *_SIZE)
    figure = Figure(figsize=(2.4 * _FRAMES, 2.1), layout="constrained")
    for axes, picture, step in zip(figure.subplots(1, _FRAMES), pictures, steps, strict=True):
        axes.imshow(picture)
        axes.set_title(f"{step * run.time_step:.1f} s", fontsize=10)
        axes.set_axis_off()
    return figure


def write_moving_picture(run: RunRecord, path: Path) -> bool:
    """Writes the motion under the policy as a GIF that runs in real time.

    Returns:
        False if the run has no such motion, so that nothing was written.

    Raises:
        RenderingError: MuJoCo cannot draw without a screen here.
    """
    if run.executed_states is None:
        return False
    write_motions(run.mjcf, [run.executed_states], run.time_step, path)
    return True


def write_motions(mjcf: str, motions: Sequence[NDArray], time_step: float, path: Path) -> None:
    """Writes motions side by side as a GIF that runs in real time, until one of them diverges.

    Raises:
        RenderingError: MuJoCo cannot draw without a screen here.
    """
    stride = max(1, round(1.0 / (_RATE * time_step)))
    sound = (motion[np.isfinite(motion).all(axis=1)][::stride] for motion in motions)
    drawn = [list(frames(mjcf, states, *_GIF_SIZE)) for states in sound]
    pictures = [Image.fromarray(np.hstack(each)) for each in zip(*drawn, strict=False)]
    # All frames share one palette, since colours that change between frames would flicker.
    palette = pictures[len(pictures) // 2].quantize(_COLOURS)
    first, *rest = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]
    duration = round(1000 * stride * time_step)
    first.save(path, save_all=True, append_images=rest, duration=duration, loop=0, optimize=True)


def _show_all(model: mujoco.MjModel) -> None:
    """Shows all geoms of a body of which nothing is to be seen, as if they were drawn."""
    is_seen = (model.geom_group < 3) & (model.geom_rgba[:, 3] > 0)
    hidden = ~np.isin(model.geom_bodyid, model.geom_bodyid[is_seen])
    model.geom_group[hidden] = 0
    model.geom_rgba[hidden & (model.geom_rgba[:, 3] == 0), 3] = 1.0


def _with_surroundings(mjcf: str) -> mujoco.MjModel:
    """Compiles an MJCF with soft light, a sky and a chequered ground."""
    spec = mujoco.MjSpec.from_string(mjcf)
    light = 0.3 if spec.lights else 0.5  # of each kind; the model's own lights add to it
    spec.visual.headlight.ambient = spec.visual.headlight.diffuse = [light] * 3
    spec.visual.headlight.specular = [0.0, 0.0, 0.0]
    if not any(texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for texture in spec.textures):
        spec.add_texture(
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            rgb1=[0.93, 0.95, 0.97],
            width=64,
            height=384,
        )
    planes = [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
    if not planes:
        ground = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [0, 0, 1], "pos": [0, 0, -_DEPTH]}
        planes = [spec.worldbody.add_geom(**ground)]
    spec.add_texture(
        name="chequers",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.62, 0.66, 0.69],
        rgb2=[0.50, 0.54, 0.58],
        width=256,
        height=256,
    )
    material = spec.add_material(name="chequers", texrepeat=[1, 1], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "chequers"
    for plane in planes:
        plane.material, plane.rgba = "chequers", [1, 1, 1, 1]
    return spec.compile()
