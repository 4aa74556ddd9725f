# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""`pip install ".[standalone]"` without ROS: what then works, and what says that it needs more."""

import os
import re
import shutil
import subprocess
import sys
import venv
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
# What ROS, colcon and the virtual environment of this checkout pass on to child processes.
INHERITED = re.compile("AMENT|CMAKE|COLCON|FAST|LD_LIBRARY|PYTHON|RMW|ROS|VIRTUAL_ENV|_ROS")
CLEAN = {name: value for name, value in os.environ.items() if not INHERITED.match(name)}
QUICK = ["--iterations", "2", "--initial-ddp-iterations", "2", "--evaluation-rollouts", "2"]


@pytest.fixture
def source(tmp_path):
    """A copy of what is installed, since pip leaves its build folder beside it."""
    for name in ("vgps_ros", "config", "resource", "scripts", "requirements"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, tmp_path / "source" / name, symlinks=True, ignore=ignored)
    for name in ("setup.py", "package.xml"):
        shutil.copy(ROOT / name, tmp_path / "source")
    return tmp_path / "source"


def ran(*command, code=0):
    run = subprocess.run([*map(str, command)], env=CLEAN, capture_output=True, text=True)  # noqa: PLW1510
    assert run.returncode == code, run.stdout + run.stderr
    return run.stdout + run.stderr


def works_without_ros(vgps, folder):
    ran(vgps, "train", "--task", "swimmer", *QUICK, "--output", folder)
    assert "speed [m/s]" in ran(vgps, "evaluate", folder, "--seconds", "1")
    ran(vgps, "plot", folder)
    assert (folder / "plots" / "trajectory.png").read_bytes().startswith(b"\x89PNG")
    bag = ROOT / "recordings" / "sample"
    for words in (["node", "simulation"], ["bag", "info", bag], ["execute-policy"]):
        assert f"vgps {words[0]}: this command needs ROS 2" in ran(vgps, *words, code=1)


@pytest.mark.slow
def test_a_real_installation_with_its_dependencies(source, tmp_path):
    venv.create(tmp_path / "venv", with_pip=True)
    executables = tmp_path / "venv" / "bin"
    ran(executables / "python", "-m", "pip", "install", "--no-input", f"{source}[standalone]")
    works_without_ros(executables / "vgps", tmp_path / "run")


def needed(names, extra=""):
    """All distributions that some need, as `pip install` finds them."""
    found: dict[str, Distribution] = {}
    waiting = [(Requirement(name), extra) for name in names]
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
            continue
        if requirement.name not in found:
            found[requirement.name] = distribution(requirement.name)
            for name in found[requirement.name].requires or ():
                waiting += [(Requirement(name), each) for each in requirement.extras or [""]]
    return found.values()


@pytest.mark.slow
def test_an_installation_that_sees_no_ros(source, tmp_path):
    """As above, but the dependencies are links to those of this checkout: nothing is downloaded."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    build = ["wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path]
    ran(*pip, *build, source)
    [wheel] = tmp_path.glob("vgps_ros-*.whl")
    venv.create(tmp_path / "venv", with_pip=False, symlinks=True)
    executables = tmp_path / "venv" / "bin"
    before = set(executables.iterdir())
    ran(*pip, "--python", executables / "python", "install", "--no-deps", wheel)
    assert {file.name for file in set(executables.iterdir()) - before} == {"vgps"}
    vgps = executables / "vgps"
    assert "run `pip install '.[standalone]'` (there is no package" in ran(vgps, "train", code=1)

    [site] = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    [metadata] = site.glob("vgps_ros-*.dist-info")
    requires = Distribution.at(metadata).requires or []
    assert all("extra ==" in line for line in requires)  # of itself it brings nothing along
    for each in needed(requires, "standalone"):
        for name in {file.parts[0] for file in each.files or ()} - {".."}:
            if not (site / name).exists() and each.locate_file(name).exists():
                (site / name).symlink_to(each.locate_file(name))
    works_without_ros(vgps, tmp_path / "run")
