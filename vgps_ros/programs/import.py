# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Writes a third-party policy with its contract, and shows it before anything moves.

The contract says what its numbers mean: the order of the joints, and the terms of what it reads. It
comes from the metadata of the ONNX file, as mjlab writes them, or from a file beside it: Unitree's
deploy.yaml, rl_sar's config.yaml, or a YAML file of the metadata; or from the YAML file of a LEAPP
bundle. What does not fit the robot is refused, but of times: a policy with another control period
or turn of the clock gets a task file that has them. The file that it writes drives by
`policy_file`, and `vgps evaluate` takes it.
"""

import argparse
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Range, Setting, settings_of
from vgps_ros.programs.command_line import Parser, deployment_file, refuse_existing, settings_from
from vgps_ros.safety.poses import PoseSettings
from vgps_ros.tasks.registry import TASK, copy_of

if TYPE_CHECKING:
    from vgps_ros.core.records import Array
    from vgps_ros.policies.policy_file import PolicyFile
    from vgps_ros.robot.executed_control import Driver
    from vgps_ros.tasks import Task

HOLDING = ("pose_stiffness", "pose_damping")  # of motors that the policy does not drive
STANDING = Setting(
    "standing",
    2.0,
    Range(0.02, 100.0),
    "time for which the simulated robot stands, at the pose of the action 0, for the ranges [s]",
)


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    parser.add_argument(
        "policy", type=Path, help="ONNX file of the policy, or YAML file of a LEAPP bundle"
    )
    parser.add_settings(TASK)
    parser.add_argument(
        "--contract",
        type=Path,
        help="deploy.yaml of Unitree, config.yaml of rl_sar, or a YAML file of metadata; default: "
        "the file's own metadata",
    )
    parser.add_output("--output", "ONNX file to write, such as policy.onnx", required=True)
    parser.add_argument(
        "--deployment",
        type=deployment_file,
        metavar="FILE",
        help="also write what policy_executor has to know of the task; see `vgps export`",
    )
    gains = [s for s in settings_of(PoseSettings()) if s.name in HOLDING]
    parser.add_settings(STANDING, *gains)


def run(arguments: argparse.Namespace) -> None:
    """Imports the policy that the arguments name."""
    outputs = [arguments.output, *([arguments.deployment] if arguments.deployment else [])]
    refuse_existing(outputs, overwrite=arguments.overwrite)
    import yaml

    from vgps_ros.policies.driver import SAME_PERIOD, driver_of
    from vgps_ros.policies.foreign import holding_metadata, read_contract, read_leapp
    from vgps_ros.policies.onnx_file import LARGEST, metadata_of, parse_model, with_metadata
    from vgps_ros.policies.onnx_policy import OnnxPolicy
    from vgps_ros.policies.policy_file import policy_of
    from vgps_ros.storage.files import read_file
    from vgps_ros.tasks import make_task

    task, name = make_task(arguments.task), f"'{arguments.policy}'"
    joints = task.controls.names
    if arguments.policy.suffix in (".yaml", ".yml"):
        if arguments.contract:
            raise InvalidInputError(f"{name} says what its numbers mean; leave out --contract.")
        content = read_leapp(arguments.policy, joints, _home(task, joints))
    else:
        content = read_file(arguments.policy, LARGEST)
    if arguments.contract:
        said = metadata_of(parse_model(content, name)) | read_contract(arguments.contract, joints)
        if "joint_names" not in said:
            home = ",".join(map(str, _home(task, joints)))
            said = {"joint_names": ",".join(joints), "default_joint_pos": home, **said}
        content = with_metadata(content, said, name)
    known, gains = metadata_of(parse_model(content, name)), settings_from(arguments, PoseSettings())
    pulling = gains.pose_stiffness, gains.pose_damping
    held = holding_metadata(known, task.controls, task.initial_state, *pulling)
    content = with_metadata(content, held, name) if held else content
    file = policy_of(content, name)
    policy = file.policy(task.controls)
    if not isinstance(policy, OnnxPolicy):
        driver_of(task.deployment, file)
        print("vgps_ros wrote this file; nothing is converted.")
        return
    own = task.dynamics.time_step, task.signals.period
    times = policy.contract.period or own[0], policy.contract.gait_period or own[1]
    if all(math.isclose(*pair, rel_tol=SAME_PERIOD) for pair in zip(own, times, strict=True)):
        _write(arguments, task, file, outputs)
        return
    path = arguments.output.with_suffix(".task.yaml")
    said, tables = copy_of(arguments.task, path.parent)
    written = [path, *tables.values()]
    refuse_existing(written, overwrite=arguments.overwrite)
    earlier = {each: each.read_bytes() for each in written if each.exists()}
    try:
        path.write_text(
            f"# {arguments.task} with the times of {name}, written by `vgps import`.\n"
            + yaml.safe_dump(_retime(said, task, *times), sort_keys=False, default_flow_style=None)
        )
        for table, copied in tables.items():
            shutil.copy(table, copied)
        _write(arguments, make_task(str(path)), file, [*outputs, path])
    except BaseException:
        for each in written:
            each.unlink(missing_ok=True)
            if each in earlier:
                each.write_bytes(earlier[each])
        raise
    print(f"Give {path} as the task from here on: it is {arguments.task} with the policy's times.")


def _retime(said: dict[str, Any], task: "Task", period: float, turn: float) -> dict[str, Any]:
    """Returns what a task file says, with another control period and turn of the clock [s].

    The time step stays as near as six digits can write it.
    """
    ratio = min(period / task.dynamics.model.opt.timestep, 1000.0)

    def rank(steps: int) -> tuple[bool, float]:
        return abs(float(f"{period / steps:g}") * steps / period - 1.0) > 1e-9, abs(steps - ratio)

    steps = min(range(max(1, round(0.75 * ratio)), 2 + round(1.5 * ratio)), key=rank)
    option = said.get("changes", {}).get("option", {}) | {"timestep": period / steps}
    said |= {"control_period": period, "changes": said.get("changes", {}) | {"option": option}}
    return said | ({"clock": said.get("clock", {}) | {"frequency": 1.0 / turn}} if turn else {})


def _write(
    arguments: argparse.Namespace, task: "Task", file: "PolicyFile", outputs: list[Path]
) -> None:
    """Shows what a policy means to the robot of a task, and writes the files."""
    from itertools import groupby

    from rich.table import Table

    from vgps_ros.policies.contract import BASE
    from vgps_ros.policies.deployment_file import write_deployment
    from vgps_ros.policies.driver import driver_of, for_policy
    from vgps_ros.policies.onnx_policy import OnnxPolicy
    from vgps_ros.storage.files import replacing
    from vgps_ros.views.console import table_console

    robot, console = task.deployment, table_console()
    task = for_policy(task, file)
    driver = driver_of(task.deployment, file)
    assert isinstance(driver.policy, OnnxPolicy)
    contract = driver.policy.contract
    read, actions = _standing(task, driver, arguments.standing)
    table = Table("action", "joint", "from", "times", "stiffness", "damping", "standing")
    columns = contract.origin, contract.scale, contract.stiffness, contract.damping
    each = zip(contract.all_joints, *columns, strict=True)
    for i, (joint, *numbers) in enumerate(each):
        driven = (str(i), _range(actions[:, i])) if i < actions.shape[1] else ("held", "")
        table.add_row(driven[0], joint, *(f"{number:.4g}" for number in numbers), driven[1])
    console.print(table)
    table = Table("inputs", "term", "steps before", "computed from", "times", "standing")
    terms, first = {term.name: term for term in contract.terms}, 0
    for name, group in groupby(contract.places, key=lambda place: place[0]):
        places = list(group)
        lags = list(dict.fromkeys(lag for _, lag, _ in places))
        last, term = first + len(places), terms[name]
        named = [BASE if each.startswith(BASE) else each for each in term.read]
        named = list(dict.fromkeys(named)) or ["the network's output"]
        source = ", ".join([*named[:2], *["…"] * (len(named) > 2)])
        scales = ", ".join(f"{scale:.4g}" for scale in dict.fromkeys(term.scale.tolist()))
        steps = f"{lags[0]} to {lags[-1]}" if len(lags) > 1 else str(lags[0])
        table.add_row(
            f"{first}-{last - 1}", name, steps, source, scales, _range(read[:, first:last])
        )
        first = last
    console.print(table)
    if arguments.deployment:
        write_deployment(robot, arguments.deployment)
    with replacing(arguments.output) as output:
        output.write(file.content)
    console.print(
        f"Wrote {' and '.join(map(str, outputs))}: {first} numbers to {len(contract.joints)} "
        f"actions, {task.controls.label()}, each {task.dynamics.time_step:g} s."
    )


def _home(task: "Task", joints: tuple[str, ...]) -> list[float]:
    """Returns the joints' positions in the keyframe home, or in the task's start."""
    from vgps_ros.simulation.model import state_names

    model = task.dynamics.model
    keys = [model.key(i) for i in range(model.nkey) if model.key(i).name == "home"]
    home, names = keys[0].qpos if keys else task.initial_state, state_names(model)
    places = dict(zip(names, home, strict=False))  # home may have positions alone
    return [float(places.get(f"{joint}/position", 0.0)) for joint in joints]


def _standing(task: "Task", driver: "Driver", seconds: float) -> tuple["Array", "Array"]:
    """Returns what the network reads, (T, n), and its actions, (T, n_a), which drive nothing.

    They are those until the robot falls, as some do without their policy.
    """
    import numpy as np

    from vgps_ros.policies.onnx_policy import OnnxPolicy

    policy, steps = driver.policy, max(1, round(seconds / task.dynamics.time_step))
    assert isinstance(policy, OnnxPolicy)
    resting = task.signals.constant_context(task.signals.rest, steps)
    observation, memory, read, actions = driver.observation, None, [], []

    def law(t: int, x: "Array") -> "Array":
        nonlocal memory
        inputs = observation.within(resting[t])(x)
        memory = policy.contract.remembered(inputs, memory)
        read.append(policy.contract.read(memory)[0])
        given = policy.actions(read[-1][None])
        actions.append(given[0, : len(policy.contract.joints)].copy())
        given[:, : len(policy.contract.joints)] = 0.0
        memory = memory._replace(
            action=np.append(given, memory.action[:, given.shape[1] :], axis=1)
        )
        return policy.controls(given, inputs)

    states = task.dynamics.rollout(task.initial_state, law, steps).states[:-1]
    up = np.logical_and.accumulate(~task.fallen(states))[: len(read)]  # fewer where it diverges
    return np.array(read)[up], np.array(actions)[up]


def _range(values: "Array") -> str:
    return f"{values.min():.3g} to {values.max():.3g}"
