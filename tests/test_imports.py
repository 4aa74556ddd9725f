# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The method needs no ROS, and packages import in one direction."""

import re
import subprocess
import sys
from pathlib import Path

import vgps_ros

SCRIPT = """
import importlib, pkgutil, sys

for name in ("rclpy", "vgps_msgs", "rosidl_runtime_py", "std_msgs", "sensor_msgs"):
    sys.modules[name] = None  # an import of it raises ImportError

for package in sys.argv[1:]:
    package = "vgps_ros." + package
    path = importlib.import_module(package).__path__
    for module in pkgutil.walk_packages(path, package + "."):
        if module.name != "vgps_ros.tasks.environment":  # it needs Gymnasium
            importlib.import_module(module.name)
print(*sorted({name.split(".")[1] for name in sys.modules if name.startswith("vgps_ros.")}))
"""


def test_every_module_imports_without_ros_and_only_what_is_below_it():
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, *METHOD, "wizard"],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[1],
    )
    assert run.returncode == 0, run.stderr
    assert set(run.stdout.split()) == METHOD | {"wizard"}


# These import no ROS.
METHOD = {"core", "robot", "simulation", "safety", "storage", "policies", "tasks", "search"}
LIBRARIES = {"bags", "messages", "ros_runtime", "views"}
ALLOWED = {  # packages of ours that each may import, beside itself
    "core": set(),
    "robot": {"core"},
    "simulation": {"core", "robot"},
    "safety": {"core", "robot"},
    "storage": {"core"},
    "policies": {"core", "robot", "storage"},
    "tasks": {"core", "robot", "simulation", "storage", "policies"},
    "search": METHOD - {"safety"},
    "wizard": METHOD - {"safety"},
    "messages": METHOD - {"safety"},
    "views": METHOD | {"messages"},
    "bags": METHOD | {"messages", "views"},
    "ros_runtime": METHOD | {"bags", "messages", "views"},
    "nodes": METHOD | LIBRARIES,
    "programs": METHOD | LIBRARIES | {"wizard"},
}


def test_each_package_imports_only_what_it_may():
    source = Path(vgps_ros.__file__).parent
    for package, allowed in ALLOWED.items():
        for file in (source / package).rglob("*.py"):
            found = set(re.findall(r"^\s*(?:from|import) vgps_ros\.(\w+)", file.read_text(), re.M))
            assert found <= allowed | {package}, file


def test_no_node_imports_another():
    source = Path(vgps_ros.__file__).parent
    nodes = set(vgps_ros.NODES)
    assert "policy_executor" in nodes
    for file in (source / "nodes").rglob("*.py"):
        own = file.relative_to(source / "nodes").parts[0].removesuffix(".py")
        found = set(
            re.findall(r"^\s*(?:from|import) vgps_ros\.nodes\.(\w+)", file.read_text(), re.M)
        )
        assert not found & nodes - {own}, file


def test_only_what_learns_waits_for_torch_and_nothing_for_onnx():
    script = """
import importlib, pkgutil, sys
from vgps_ros import nodes
names = [f"vgps_ros.nodes.{module.name}" for module in pkgutil.iter_modules(nodes.__path__)]
names += ["vgps_ros.bags.bag_check", "vgps_ros.views.plots"]
names += ["vgps_ros.programs.training_client", "vgps_ros.programs.policy_run"]
for name in names:
    if name != "vgps_ros.nodes.policy_learner":
        importlib.import_module(name)
        assert "torch" not in sys.modules, name
    assert not {"onnx", "onnxruntime"} & set(sys.modules), name
"""
    subprocess.run([sys.executable, "-c", script], check=True)
