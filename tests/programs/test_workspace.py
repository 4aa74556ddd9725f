# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A normal colcon workspace, built as docs/how_to/install.md says, and what is in its packages."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
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
    include = ROOT / "scripts" / "drop_foreign_python_includes.cmake"
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
    link, build = re.findall("^(?:ln -sfn|colcon build).*$", page, re.MULTILINE)
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

    assert "2 packages finished" in ran(f"{link}\n{build}")
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


def test_what_rosdep_knows_of_the_requirements_stands_in_the_package():
    """The keys of packages that have one: of rosdep's python.yaml, or the one that brings them."""
    keys = {
        **{name: f"python3-{name}" for name in ("argcomplete", "matplotlib", "numba")},
        **{name: f"python3-{name}" for name in ("numpy", "rich", "scipy", "torch")},
        **{name: f"python3-{name}-pip" for name in ("mujoco", "rosbags")},
        "pillow": "python3-pil",
        "pyyaml": "python3-yaml",
        "ruamel-yaml": "python3-ruamel.yaml",
        "llvmlite": "python3-numba",
        **dict.fromkeys(("mcap", "mcap-ros2-support"), "mcap-ros2-support"),
    }
    without = {"msgspec", "pyarrow", "rerun-sdk"}
    lines = (ROOT / "requirements" / "runtime.txt").read_text().splitlines()
    needed = {line.partition("==")[0] for line in lines if line[:1].isalpha()}
    assert needed == keys.keys() | without
    depends = {d.name for d in parse_package(ROOT).exec_depends}
    assert {d for d in depends if d.startswith("python3-") or d == "mcap-ros2-support"} == set(
        keys.values()
    )
