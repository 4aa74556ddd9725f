# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The learner needs no ROS, and folders import in one direction."""

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
        [sys.executable, "-c", SCRIPT, *WITHOUT_ROS],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[1],
    )
    assert run.returncode == 0, run.stderr
    assert set(run.stdout.split()) == WITHOUT_ROS


# The three wings. A folder imports from those before it, so a wing from no later one.
LEARNER = ["core", "storage", "robot", "simulation", "tasks", "search"]
ROBOTS_SIDE = ["policies", "safety", "messages", "ros_runtime", "nodes"]
TOOLS = ["views", "bags", "wizard", "programs"]
FOLDERS = [*LEARNER, *ROBOTS_SIDE, *TOOLS]
WITHOUT_ROS = {*LEARNER, "policies", "safety", "wizard"}
NEVER = {  # folders before it that a folder does without
    "robot": {"storage"},
    "simulation": {"storage"},
    "policies": {"search"},
    "safety": {*LEARNER, "policies"} - {"core", "robot"},
    "messages": {"policies", "safety"},
    "views": {"safety", "ros_runtime", "nodes"},
    "bags": {"ros_runtime", "nodes"},
    "wizard": {*ROBOTS_SIDE, "views", "bags"},
    "programs": {"nodes"},
}
EXCEPTIONS = {
    # A task may begin with what a policy's file does.
    "tasks/first_motion.py": {"policies"},
    # These nodes are tools of the graph: they hand messages to a bag's writer, and to what draws.
    "nodes/recorder.py": {"bags"},
    "nodes/player.py": {"bags"},
    "nodes/visualizer.py": {"views"},
    "nodes/live/robot.py": {"views"},
}


def test_each_folder_imports_only_from_those_before_it():
    source, needed = Path(vgps_ros.__file__).parent, {}
    folders = {path.parent.name for path in source.glob("*/__init__.py")}
    assert folders == set(FOLDERS)
    for place, folder in enumerate(FOLDERS):
        allowed = {folder, *FOLDERS[:place]} - NEVER.get(folder, set())
        for file in (source / folder).rglob("*.py"):
            found = set(re.findall(r"^\s*(?:from|import) vgps_ros\.(\w+)", file.read_text(), re.M))
            if found - allowed:
                needed[str(file.relative_to(source))] = found - allowed
    assert needed == EXCEPTIONS


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


def test_no_node_waits_for_torch_or_onnx():
    script = """
import importlib, pkgutil, sys
from vgps_ros import nodes
names = [f"vgps_ros.nodes.{module.name}" for module in pkgutil.iter_modules(nodes.__path__)]
names += ["vgps_ros.bags.bag_check", "vgps_ros.views.plots"]
names += ["vgps_ros.programs.training_client", "vgps_ros.programs.policy_run"]
for name in names:
    importlib.import_module(name)
    assert not {"torch", "onnx", "onnxruntime"} & set(sys.modules), name
"""
    subprocess.run([sys.executable, "-c", script], check=True)
