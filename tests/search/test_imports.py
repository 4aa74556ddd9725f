"""core, tasks and search need no ROS, and import in one direction."""

import subprocess
import sys
from pathlib import Path

SCRIPT = """
import importlib, pkgutil, sys

for name in ("rclpy", "vgps_msgs", "rosidl_runtime_py", "std_msgs", "sensor_msgs"):
    sys.modules[name] = None  # an import of it raises ImportError

for package in ("vgps_ros.core", "vgps_ros.tasks", "vgps_ros.search"):
    path = importlib.import_module(package).__path__
    for module in pkgutil.walk_packages(path, package + "."):
        importlib.import_module(module.name)
    print(*sorted({name.split(".")[1] for name in sys.modules if name.startswith("vgps_ros.")}))
"""


def test_every_module_imports_without_ros_and_only_what_is_below_it():
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[2],
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines() == ["core", "core tasks", "core search tasks"]
