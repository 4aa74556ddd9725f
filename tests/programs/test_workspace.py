# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A normal colcon workspace, built as docs/how_to/install.md says, and what is in its packages."""

import ast
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import pytest
import yaml
from catkin_pkg.changelog import get_changelog_from_path
from catkin_pkg.package import parse_package

ROOT = Path(__file__).parents[2]
VENV = ROOT / ".venv"
PACKAGES = {"vgps_ros": ROOT, "vgps_msgs": ROOT / "msg_schemas"}
INHERITED = re.compile("AMENT|CMAKE|COLCON|PYTHON|ROS|_ROS")


def underlay(workspace: Path) -> str:
    """Returns commands that source ROS 2, and tells colcon where that of the wheels is special."""
    if (VENV / "ros_setup").is_file():
        return f"source {(VENV / 'ros_setup').read_text()}"
    include = ROOT / "scripts" / "quick_messages.cmake"
    arguments = [f"-DPython3_EXECUTABLE={sys.executable}", f"-DCMAKE_PROJECT_INCLUDE={include}"]
    meta = {"names": {"vgps_msgs": {"cmake-args": arguments}}}
    (workspace / "colcon.meta").write_text(json.dumps(meta))
    # Set-up built the interface packages that the wheels lack and rosdep would install.
    names = [folder.name for folder in (ROOT / "requirements" / "interfaces").iterdir()]
    built = [f"source {ROOT}/install/{name}/share/{name}/package.bash" for name in names]
    return "\n".join([f"export AMENT_PREFIX_PATH={VENV} CMAKE_PREFIX_PATH={VENV}", *built])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_pages_lines_build_a_workspace_whose_node_runs_and_whose_tests_pass(tmp_path):
    page = (ROOT / "docs" / "how_to" / "install.md").read_text()
    found = re.findall(r"^(?:ln -sfn \S+ \S+|colcon build)", page, re.MULTILINE)
    *links, build = dict.fromkeys(found)
    source = tmp_path / "src" / "vgps_ros"
    source.mkdir(parents=True)
    files = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(files, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    present = [name for name in listed.split("\0") if (ROOT / name).is_file()]
    copy = ["cp", "--parents", "--no-dereference", "-t", source, *present]
    subprocess.run(copy, cwd=ROOT, check=True)
    clean = {name: value for name, value in os.environ.items() if not INHERITED.match(name)}
    clean |= {"PATH": f"{VENV / 'bin'}:{os.environ['PATH']}", "ROS_LOG_DIR": str(tmp_path / "log")}

    def ran(commands: str) -> str:
        script = f"{underlay(tmp_path)}\n{commands}"
        told = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        done = subprocess.run(["bash", "-c", script], cwd=tmp_path, env=clean, check=False, **told)
        assert done.returncode == 0, done.stdout
        return done.stdout

    lines = "\n".join([*links, build])
    assert "3 packages finished" in ran(lines)
    ran("colcon test --packages-select vgps_ros --pytest-args tests/core/test_seeding.py")
    assert "0 errors, 0 failures" in ran("colcon test-result --all")

    collected = ran(
        "source install/setup.bash; cd src/vgps_ros; python -m pytest --collect-only -q tests"
    )
    assert "tests/core/test_seeding.py" in collected
    assert "tests/nodes" not in collected  # they start processes of a checkout

    log = tmp_path / "simulation.log"
    script = (
        f"{underlay(tmp_path)}; source install/setup.bash; "
        f"exec install/vgps_ros/lib/vgps_ros/simulation >{shlex.quote(str(log))} 2>&1"
    )
    alone = clean | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}
    with subprocess.Popen(["bash", "-c", script], cwd=tmp_path, env=alone) as node:
        end = time.monotonic() + 90
        while "Simulating the swimmer" not in (log.read_text() if log.exists() else ""):
            assert node.poll() is None, log.read_text()
            assert time.monotonic() < end, log.read_text()
            time.sleep(0.1)
        node.send_signal(signal.SIGINT)
        assert node.wait(30) == 0, log.read_text()


@pytest.mark.parametrize("name", PACKAGES)
def test_a_package_tells_release_tools_what_they_ask_for(name):
    package = parse_package(PACKAGES[name])
    assert package.name == name
    assert not [m for m in package.maintainers if m.email.endswith(".invalid")]
    assert package.urls
    changelog = get_changelog_from_path(PACKAGES[name], name).rst
    assert changelog.splitlines()[1] == f"Changelog for package {name}"
    assert f"\n{package.version} (" in changelog
    assert "\n* CHANGELOG.md" in changelog


# What rosdistro installs by apt on Ubuntu 24.04, by the module that vgps_ros imports.
APT = {
    "argcomplete": "python3-argcomplete",
    "numpy": "python3-numpy",
    "rich": "python3-rich",
    "scipy": "python3-scipy",  # of distances from the training
    "yaml": "python3-yaml",
}
TRAINING = ROOT / "requirements" / "training"
ON_A_ROBOT = ("nodes.policy_executor", "nodes.watchdog", "programs.drive", "programs.node")


def imported(path: Path, *, at_once: bool) -> set[str]:
    """Returns the packages that a file imports: those of its top level, or all."""
    if at_once:  # an import below a condition is for types
        nodes: Iterable[ast.AST] = ast.parse(path.read_text()).body
    else:
        nodes = ast.walk(ast.parse(path.read_text()))
    found = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(str(node.module))
    return {name.partition(".")[0] for name in found} - {"vgps_ros", *sys.stdlib_module_names}


def keys(folder: Path) -> set[str]:
    return {depend.name for depend in parse_package(folder).exec_depends}


def of_ros(names: set[str]) -> set[str]:
    return {name for name in names if not re.match("python3-|mcap", name)}


def test_a_robots_computer_needs_no_package_that_apt_lacks():
    assert keys(ROOT) - of_ros(keys(ROOT)) == set(APT.values())
    script = f"""
import importlib, sys
for name in {ON_A_ROBOT}:
    importlib.import_module("vgps_ros." + name)
print(*(m.__file__ for name, m in sys.modules.items() if name.partition(".")[0] == "vgps_ros"))
"""
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    files = run.stdout.split()
    assert len(files) > 40
    needed = set().union(*(imported(Path(file), at_once=True) for file in files))
    assert {"rclpy", "numpy", "yaml"} <= needed
    assert {APT.get(name, name) for name in needed} <= keys(ROOT)


def test_the_package_names_every_package_of_ros_that_it_imports():
    files = [*(ROOT / "vgps_ros").rglob("*.py"), *(ROOT / "launch").glob("*.py")]
    needed = set().union(*(imported(file, at_once=False) for file in files))
    ros = {
        n for n in needed if re.fullmatch(r"\w+_(msgs|srvs|interfaces|python)|rclpy|launch\w*", n)
    }
    assert len(ros) > 10
    assert ros == of_ros(keys(ROOT))


def test_every_requirement_has_a_key_of_rosdistro_or_a_rule_of_ours():
    rosdistro = {
        **{name: f"python3-{name}" for name in ("argcomplete", "matplotlib", "numba")},
        **{name: f"python3-{name}" for name in ("numpy", "rich", "scipy", "torch")},
        **{name: f"python3-{name}-pip" for name in ("mujoco", "onnxruntime", "rosbags")},
        "pillow": "python3-pil",
        "pyyaml": "python3-yaml",
        "ruamel-yaml": "python3-ruamel.yaml",
        "llvmlite": "python3-numba",  # which brings it
        **dict.fromkeys(("mcap", "mcap-ros2-support"), "mcap-ros2-support"),
    }
    rules = yaml.safe_load((ROOT / "requirements" / "rosdep.yaml").read_text())
    ours = {rule["ubuntu"]["pip"]["packages"][0]: key for key, rule in rules.items()}
    assert all(rule["debian"] == rule["ubuntu"] for rule in rules.values())
    files = [ROOT / "requirements" / f"{name}.txt" for name in ("base", "bags", "onnx")]
    text = "".join(file.read_text() for file in files)
    needed = {line.partition("==")[0] for line in text.splitlines() if line[:1].isalpha()}
    assert needed - {"rerun-sdk"} == rosdistro.keys() | ours.keys()  # it needs NumPy 2
    known = {*rosdistro.values(), *ours.values()}
    assert keys(ROOT) | keys(TRAINING) == known | of_ros(keys(ROOT)) | {"vgps_ros"}
    assert not keys(ROOT) & keys(TRAINING)
