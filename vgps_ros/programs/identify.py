# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Finds what differs of a task's robot in a bag of the real one, and writes a task that has it.

It fits damping, the rotors' inertia, dry friction, gain and strength of the actuators, a mass, the
latency and how the IMU is mounted to the recorded joint_states, imu and commands, each with its
uncertainty, and says which of them the bag cannot tell. The new task has the robot as it was found,
and draws its training situations from what stays uncertain:

    vgps identify BAG --task quadruped --output found.yaml
    vgps train --task found.yaml --output RUN
"""

import argparse
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from vgps_ros.programs.command_line import Parser, refuse_existing
from vgps_ros.tasks.registry import TASK, copy_of

if TYPE_CHECKING:
    from vgps_ros.search.identification import IdentifiedRobot

_SITE = "identified_imu"  # is turned as the IMU was found to be


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("bag", type=Path, help="folder of a bag of 10 s or more of a moving robot")
    parser.add_settings(TASK)
    parser.add_argument("--body", default="", help="body whose mass is found; empty: the heaviest")
    parser.add_argument("--imu-frame", default="", help="the site or body at which the IMU sits")
    parser.add_argument("--base-frame", default="", help="name of the base's frame in messages")
    parser.add_namespace("of the robot that is meant, for a bag of several")
    text = "task file to write, with a .xml and a .png beside it; default BAG-identified.yaml"
    parser.add_output("--output", text)


def run(arguments: argparse.Namespace) -> None:
    """Identifies the robot; prints, draws and writes what was found."""
    import yaml
    from rich.console import Console

    from vgps_ros.bags import BagReader
    from vgps_ros.bags.episode import measured_motions
    from vgps_ros.search.identification import identify
    from vgps_ros.tasks import make_task
    from vgps_ros.views.plots import predictions, save

    source = arguments.bag.resolve()
    output = arguments.output or source.with_name(f"{source.name}-identified.yaml")
    content, copies = copy_of(arguments.task, output.parent)
    files = [output.with_suffix(ending) for ending in (".yaml", ".xml", ".png")]
    refuse_existing([*files, *copies.values()], overwrite=arguments.overwrite)
    task = make_task(arguments.task)
    with BagReader(arguments.bag, arguments.namespace) as bag:
        motions = measured_motions(bag, task, arguments.imu_frame, arguments.base_frame)
        imu = next(bag.decoded(bag.filled_topics["imu"]))[1] if motions[0].is_blind else None
        frame = arguments.imu_frame or (imu.header.frame_id if imu else "")
    with Console(stderr=True).status(
        "Simulating the motion with other numbers; it takes minutes ..."
    ):
        found = identify(task, motions, arguments.body)
    _show(found)
    output.parent.mkdir(parents=True, exist_ok=True)
    files[1].write_text(_robot(task.mjcf, found, frame))
    content |= {"model": files[1].name, "search": {**task.search, **found.ranges}}
    content = {k: v for k, v in content.items() if k not in ("changes", "sensors")}  # it has them
    head = f"# What `vgps identify` found of the task {arguments.task} in {source.name}.\n"
    files[0].write_text(head + yaml.safe_dump(content, sort_keys=False, width=120))
    for table, copied in copies.items():
        shutil.copy(table, copied)
    save(predictions(found), files[2])
    print(f"Wrote {', '.join(map(str, files))}; train with `vgps train --task {files[0]} …`.")


def _show(found: "IdentifiedRobot") -> None:
    """Prints what was found, what cannot be told, and how well motions are predicted now."""
    from rich.table import Column, Table

    from vgps_ros.views.console import table_console

    console, numbers = table_console(), ("model", "found", "± (1 sd)")
    table = Table("", *(Column(name, justify="right") for name in numbers), "unit")
    for p in found.parameters.values():
        if p.is_told:
            table.add_row(p.name, f"{p.nominal:.4g}", f"{p.value:.4g}", f"{p.std:.2g}", p.unit)
    console.print(table)
    if unknown := [p.name for p in found.parameters.values() if not p.is_told]:
        print(
            f"The bag cannot tell {', '.join(unknown)}: the predicted motion hardly depends on it, "
            "or another one explains it as well; the new task keeps the model's."
        )
    telling, judging, strange = found.windows
    if strange:
        print(f"Windows left out, since something else seems to move the robot there: {strange}.")
    (angle, speed), (better, slower) = found.errors
    print(
        f"Over {judging} windows that did not take part, beside {telling} that did, the model errs "
        f"by {angle:.3g} rad and {speed:.3g} rad/s (rms), and what was found by {better:.3g} and "
        f"{slower:.3g}."
    )
    if any(turn.is_told for turn in found.turns):
        print(f"Executors correct how the IMU is turned with the parameter imu_frame: {_SITE}.")


def _robot(mjcf: str, found: "IdentifiedRobot", frame: str) -> str:
    """Returns the MJCF with the numbers that were found of an IMU in a frame, and of the rest."""
    import mujoco
    import numpy as np
    from scipy.spatial.transform import Rotation

    from vgps_ros.simulation.frames import state_layout

    spec, model = mujoco.MjSpec.from_string(mjcf), found.model
    for joint in spec.joints:
        dof = model.jnt_dofadr[model.joint(joint.name).id]
        joint.damping[0] = model.dof_damping[dof]
        joint.armature, joint.frictionloss = model.dof_armature[dof], model.dof_frictionloss[dof]
    for i, actuator in enumerate(spec.actuators):
        actuator.gainprm[0] = model.actuator_gainprm[i, 0]
        actuator.biasprm[:3] = model.actuator_biasprm[i, :3]
        actuator.forcelimited = int(model.actuator_forcelimited[i])
        actuator.forcerange = model.actuator_forcerange[i]
    if found.parameters["mass"].is_told:
        body = spec.bodies[found.body]
        body.explicitinertial, body.fullinertia = True, np.full(6, np.nan)
        body.mass, body.inertia = model.body_mass[found.body], model.body_inertia[found.body]
        body.ipos, body.iquat = model.body_ipos[found.body], model.body_iquat[found.body]
    if any(turn.is_told for turn in found.turns):
        turn, layout = (
            Rotation.from_rotvec([each.value for each in found.turns]),
            state_layout(model),
        )
        if frame in layout.mounts:  # to which it was found to be turned
            known = layout.turns[layout.mounts.index(frame)]
            turn = turn * Rotation.from_quat(known, scalar_first=True)
        body = spec.bodies[np.flatnonzero(model.body_dofnum == 6)[0]]
        body.add_site(name=_SITE, quat=turn.as_quat(scalar_first=True), group=5)
    return str(spec.to_xml())
