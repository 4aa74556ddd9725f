# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The launch files, compared with what the package has; launched where ROS has `launch`."""

import ast
import importlib
import pkgutil
import re
from dataclasses import fields, is_dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
import yaml

from vgps_ros import NODES
from vgps_ros.core.settings import Setting, values_of
from vgps_ros.ros_runtime import controller
from vgps_ros.search.settings import search_settings
from vgps_ros.tasks import make_task

FOLDER = Path(__file__).parents[1] / "launch"
_ROBOT = {"namespace", "use_sim_time", "task", "params_file", "simulation", "autostart"}
ARGUMENTS = {
    "robot": _ROBOT | {"one_process"},
    "training": _ROBOT | {"one_process"},
    "replay": {"namespace", "use_sim_time", "params_file", "bag", "output"},
}
STARTED = {
    "robot": {"simulation", "watchdog", "policy_executor"},
    "training": {
        *("simulation", "watchdog", "policy_executor"),
        *("trajectory_optimizer", "policy_learner"),
    },
    "replay": {"player", "visualizer"},
}


def calls(name: str, *functions: str) -> list[ast.Call]:
    """Returns the calls of some functions in a launch file, and in those that it includes."""
    text = (FOLDER / f"{name}.launch.py").read_text()
    found = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    own = [call for call in found if getattr(call.func, "id", "") in functions]
    included = set(re.findall(r'"(\w+)\.launch\.py"', text))
    return [call for other in included for call in calls(other, *functions)] + own


def keyword(call: ast.Call, name: str) -> ast.expr | None:
    return next((each.value for each in call.keywords if each.arg == name), None)


def first(call: ast.Call) -> str:
    return ast.literal_eval(call.args[0])


def started_by(call: ast.Call) -> list[str]:
    """Returns the nodes that an action starts, of which several may share a process."""
    executable = ast.literal_eval(keyword(call, "executable"))
    return ast.literal_eval(keyword(call, "arguments")) if executable == "node" else [executable]


def parameters_of(node: str) -> set[str]:
    """Returns the names of the settings that a node's modules and its controller's know."""
    module = importlib.import_module(f"vgps_ros.nodes.{node}")
    parts = pkgutil.iter_modules(getattr(module, "__path__", []))
    modules = [
        module,
        *(importlib.import_module(f"{module.__name__}.{part.name}") for part in parts),
        *([controller] if node in ("policy_executor", "mpc") else []),
    ]
    found = [value for module in modules for value in vars(module).values()]
    records = [
        v for v in found if is_dataclass(v) and str(getattr(v, "__name__", "")).endswith("Settings")
    ]
    return {
        "use_sim_time",
        *(s.name for s in found if isinstance(s, Setting)),
        *(field.name for record in records for field in fields(record)),
    }


def flat(block: dict, prefix: str = "") -> dict:
    """Returns a nested block by dotted names."""
    found = {}
    for name, value in block.items():
        is_block = isinstance(value, dict)
        found |= flat(value, f"{prefix}{name}.") if is_block else {f"{prefix}{name}": value}
    return found


@pytest.mark.parametrize("name", ["swimmer", "walker"])
def test_a_tasks_parameter_file_repeats_what_the_task_names(name):
    blocks = yaml.safe_load((FOLDER.parent / "config" / f"{name}.yaml").read_text())
    task = make_task(name)
    for node, record in (
        ("policy_learner", search_settings(task)),
        ("trajectory_optimizer", task.optimizer),
    ):
        given, own = flat(blocks[f"/**/{node}"]["ros__parameters"]), values_of(record)
        repeated = {key: value for key, value in given.items() if key in own}
        assert len(repeated) >= 3
        assert repeated == {key: own[key] for key in repeated}


def test_there_is_a_description_of_each_launch_file_and_no_other():
    assert {file.name.partition(".")[0] for file in FOLDER.iterdir() if file.is_file()} == {
        *ARGUMENTS
    }


@pytest.mark.parametrize("name", ARGUMENTS)
def test_it_declares_the_arguments_that_it_uses_each_with_a_description(name):
    declared = calls(name, "DeclareLaunchArgument")
    assert {first(call) for call in declared} == ARGUMENTS[name]
    assert all(keyword(call, "description") for call in declared)
    assert {
        first(call)
        for call in calls(name, "LaunchConfiguration", "given")
        if isinstance(call.args[0], ast.Constant)
    } == ARGUMENTS[name]


@pytest.mark.parametrize("name", ARGUMENTS)
def test_it_starts_nodes_of_the_package_with_parameters_that_they_have(name):
    nodes = calls(name, "Node")
    started = {node for call in nodes for node in started_by(call)}
    assert started == STARTED[name] <= {*NODES}
    assert {ast.literal_eval(keyword(call, "package")) for call in nodes} == {"vgps_ros"}
    of_later_ones = set()
    for call in calls(name, "SetParameter", "Node"):
        if call.func.id == "SetParameter":
            of_later_ones.add(first(call))
            continue
        given = keyword(call, "parameters")
        own = {ast.literal_eval(key) for key in given.elts[0].keys} if given else set()
        known = set.union(*map(parameters_of, started_by(call)))
        assert own | of_later_ones <= known


@pytest.mark.parametrize("name", ARGUMENTS)
def test_launch_finds_the_same_arguments_and_nodes(name):
    """Where ROS has `launch`; the wheels lack it."""
    pytest.importorskip("launch_ros.actions")
    from launch.actions import IncludeLaunchDescription
    from launch_ros.actions import Node

    def executables(launched):
        for entity in launched.entities:
            if isinstance(entity, Node):
                yield entity.node_executable
            elif isinstance(entity, IncludeLaunchDescription):
                source = entity.launch_description_source
                yield from executables(source.try_get_launch_description_without_context())

    path = FOLDER / f"{name}.launch.py"
    spec = spec_from_file_location(name, path)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    launched = module.generate_launch_description()
    assert {argument.name for argument in launched.get_launch_arguments()} == ARGUMENTS[name]
    assert set(executables(launched)) - {"node"} == STARTED[name]
