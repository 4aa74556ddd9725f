# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a policy as an ONNX file, which other programs and robots execute.

One graph maps what the policy reads to controls within the robot's limits. Its metadata say what
the numbers mean, and of which robot and commit they are.
"""

import argparse
import hashlib
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Setting
from vgps_ros.programs.command_line import Parser, deployment_file, refuse_existing
from vgps_ros.storage.run_folder import RunFolder, load_policy, read_result
from vgps_ros.views.web import PAGE_FILES

if TYPE_CHECKING:
    from vgps_ros.core.policy import GaussianPolicy
    from vgps_ros.tasks import Task

_PRECISION = Setting(
    "precision",
    "float32",
    "of the graph's input and outputs: float32, as most controllers have them, or float64",
    kind=Literal["float32", "float64"],
)


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument("run", type=Path, help="folder of a run, or a policy.json")
    parser.add_output("--output", "ONNX file to write, such as policy.onnx")
    parser.add_argument(
        "--mjcf",
        type=Path,
        metavar="FILE",
        help="also write the robot's MJCF with the task's changes and sensors, such as robot.xml",
    )
    parser.add_argument(
        "--deployment",
        type=deployment_file,
        metavar="FILE",
        help="also write what policy_executor has to know of the task, such as robot.json: named "
        "as its parameter task, it drives without MuJoCo",
    )
    parser.add_argument(
        "--unitree",
        type=Path,
        metavar="FOLDER",
        help="also write params/deploy.yaml and exported/policy.onnx, as unitree_rl_lab has them",
    )
    parser.add_argument(
        "--leapp", type=Path, metavar="FOLDER", help="also write a LEAPP bundle, policy.yaml"
    )
    parser.add_argument(
        "--microduck",
        type=Path,
        metavar="FOLDER",
        help="also write policy.onnx and manifest.json, as the robot Microduck loads them",
    )
    parser.add_argument(
        "--web",
        type=Path,
        metavar="FOLDER",
        help="also write a page, index.html, on which anyone drives the policy in a browser",
    )
    parser.add_argument(
        "--card",
        type=Path,
        metavar="FOLDER",
        help="also write a folder for a model hub: README.md, which says what the policy is and "
        "how it does, policy.onnx and a moving picture",
    )
    parser.add_argument("--task", help="the task; default: the one that the policy's file names")
    parser.add_settings(_PRECISION)


def run(arguments: argparse.Namespace) -> None:
    """Exports the policy that the arguments name."""
    outputs = [p for p in (arguments.output, arguments.mjcf, arguments.deployment) if p]
    if arguments.unitree:
        outputs += [arguments.unitree / "params" / "deploy.yaml"]
    if arguments.leapp:
        outputs += [arguments.leapp / "policy.yaml"]
    if arguments.microduck:
        outputs += [arguments.microduck / name for name in ("policy.onnx", "manifest.json")]
    if arguments.web:
        outputs += [arguments.web / name for name in PAGE_FILES]
    if arguments.card:
        from vgps_ros.programs.policy_card import PICTURE, ExportedFile, card_files, write_card

        outputs += card_files(arguments.card)
    if not outputs:
        raise InvalidInputError(
            "There is nothing to write; name an ONNX file by --output, or a page's folder by --web."
        )
    refuse_existing(outputs, overwrite=arguments.overwrite)
    path = RunFolder(arguments.run).policy if arguments.run.is_dir() else arguments.run
    policy, name = load_policy(path)
    from vgps_ros.policies.deployment_file import write_deployment
    from vgps_ros.policies.exports.leapp import write_leapp
    from vgps_ros.policies.exports.microduck import write_microduck
    from vgps_ros.policies.exports.unitree import write_unitree
    from vgps_ros.policies.onnx_file import ExportedPolicy, to_onnx
    from vgps_ros.storage.files import replacing
    from vgps_ros.tasks import make_task, recorded_task
    from vgps_ros.views.web.page import page_of

    task = make_task(arguments.task) if arguments.task else recorded_task(name)
    policy.check_fits(task.observation.names, task.dynamics.control_dim)
    start = tuple(task.controls.resting(task.initial_state).tolist())
    exported = ExportedPolicy(policy, task.controls.limits, arguments.precision, start)
    says = metadata(task, policy, arguments.run)
    content = to_onnx(exported, says)
    files = {arguments.output: content} if arguments.output else {}
    if arguments.mjcf:
        files[arguments.mjcf] = task.mjcf.encode()
    if arguments.web:
        page = page_of(task, exported, content, _facts(arguments.run, says))
        files |= {arguments.web / name: each for name, each in page.items()}
        arguments.web.mkdir(parents=True, exist_ok=True)
    for file_path, each in files.items():
        with replacing(file_path) as file:
            file.write(each)
    if arguments.deployment:
        write_deployment(task.deployment, arguments.deployment)
    if arguments.unitree:
        write_unitree(task, exported, arguments.unitree)
    if arguments.leapp:
        write_leapp(task, exported, arguments.leapp)
    if arguments.microduck:
        print(write_microduck(task, exported, arguments.microduck))
    if arguments.card:
        print("Measures and draws the policy for its card ...", flush=True)
        command = shlex.join(["vgps", "export", *map(str, arguments.parser.words)])
        made = ExportedFile(content, arguments.precision, command)
        if missing := write_card(task, policy, RunFolder(path.parent), made, arguments.card):
            outputs.remove(arguments.card / PICTURE)
            print(f"No moving picture: {missing}")
    print(
        f"Wrote {' and '.join(map(str, outputs))}: {len(policy.observed)} readings to "
        f"{len(policy.noise_std)} controls, in {arguments.precision}."
    )


def _facts(run: Path, says: dict[str, str]) -> dict[str, str]:
    """Returns what a page says of a policy: the seed of its run, and the commit."""
    facts = {"commit": says["vgps_ros_commit"].partition(":")[0][:9]}
    if (result := RunFolder(run).result).is_file():
        facts = {"seed": str(read_result(result).get("seed", "unknown"))} | facts
    return {"task": says["task"]} | facts


def metadata(task: "Task", policy: "GaussianPolicy", path: Path) -> dict[str, str]:
    """Returns what the file says of itself: first by the keys of mjlab, then by our own."""
    import numpy as np

    from vgps_ros.core.memory import terms_of
    from vgps_ros.policies.onnx_file import with_commas
    from vgps_ros.robot.controls import ControlKind
    from vgps_ros.robot.unrest import RATE, TILT
    from vgps_ros.simulation.model import state_names
    from vgps_ros.storage.software import commit

    controls, states = task.controls, state_names(task.dynamics.model)
    terms = terms_of(policy.observed)
    joints = list(controls.names)
    positions = [f"{joint}/position" for joint in joints]
    start = [float(task.initial_state[states.index(p)]) if p in states else 0.0 for p in positions]
    # What the actions of a servo start from; the positions of other joints are for standing up.
    held = controls.at_joints(controls.resting(task.initial_state))
    start = np.where(controls.are(ControlKind.POSITION), held, start).tolist()
    found = {
        "run_path": str(path),
        "joint_names": with_commas(joints),
        "joint_stiffness": with_commas(controls.stiffness.tolist()),
        "joint_damping": with_commas(controls.damping.tolist()),
        "default_joint_pos": with_commas(start),
        "command_names": with_commas([command.name for command in task.signals.commands]),
        "observation_names": with_commas([name for name, _ in terms]),
        "observation_terms_scale": with_commas([1.0] * len(terms)),
        "observation_terms_clip": with_commas(["-inf;inf"] * len(terms)),
        "observation_terms_history_length": with_commas([0] * len(terms)),
        "observation_terms_flatten_history_dim": with_commas([1] * len(terms)),
        "action_scale": with_commas(controls.scale.tolist()),
        "action_kind": with_commas([str(kind) for kind in controls.kinds]),
        "action_unit": with_commas(list(controls.units)),
        "task": task.name,
        "noise_std": with_commas(np.abs(controls.scale * policy.noise_std).tolist()),
        "control_period": repr(task.dynamics.time_step),
        "mjcf_sha256": hashlib.sha256(task.mjcf.encode()).hexdigest(),
        "vgps_ros_commit": commit(),
    }
    if task.signals.frequency:
        found["gait_period"] = repr(task.signals.period)
    if task.unrest:
        seconds = task.unrest.steps * task.dynamics.time_step
        found["gait_stops"] = with_commas([TILT, RATE, seconds])
    if task.observation.past:
        found["observation_terms_lags"] = with_commas([lag for _, lag in terms])
        found["observed"] = with_commas(policy.observed)
    return found
