# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The wheels in clean environments: what a plain install does, and a graph without a compiler."""

import os
import random
import re
import signal
import subprocess
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OF_WHEELS = not (ROOT / ".venv" / "ros_setup").exists()
# What ROS, colcon and the virtual environment of this checkout pass on to child processes.
INHERITED = re.compile(
    "AMENT|CMAKE|COLCON|FAST|LD_LIBRARY|OMP|OPENBLAS|PYTHON|RMW|ROS|VIRTUAL|_ROS"
)
CLEAN = {name: value for name, value in os.environ.items() if not INHERITED.match(name)}
QUICK = ["--iterations", "2", "--initial-ddp-iterations", "2", "--evaluation-rollouts", "2"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(2400),
    pytest.mark.skipif(not OF_WHEELS, reason="wheels are built where ROS comes from wheels"),
]


def ran(*command, code=0, **variables):
    run = subprocess.run(  # noqa: PLW1510
        [*map(str, command)], env=CLEAN | variables, capture_output=True, text=True
    )
    assert run.returncode == code, run.stdout + run.stderr
    return run.stdout + run.stderr


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dist")
    ran(ROOT / "scripts" / "build_web_parts.bash")
    ran(ROOT / "scripts" / "build_wheels.bash", folder)
    return folder


def install(wheels, folder, extra=""):
    """Installs the wheel into a new environment, and returns its `vgps`."""
    venv.create(folder, with_pip=True)
    pip = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-input"]
    pins = ("-c", ROOT / "requirements" / "base.txt")  # and so the build of torch without CUDA
    ran(*pip, "--no-compile", "--find-links", wheels, *pins, f"vgps-ros{extra}")
    return folder / "bin" / "vgps"


def test_a_plain_install_trains_evaluates_plots_and_exports_a_page_without_ros(wheels, tmp_path):
    vgps, run = install(wheels, tmp_path / "an environment"), tmp_path / "a run"
    alone = {"PATH": str(vgps.parent), "HOME": str(tmp_path)}  # no compiler, no npm
    ran(vgps, "train", "--task", "swimmer", *QUICK, "--output", run, **alone)
    assert "speed [m/s]" in ran(vgps, "evaluate", run, "--seconds", "1", **alone)
    ran(vgps, "plot", run, **alone)
    assert (run / "plots" / "trajectory.png").read_bytes().startswith(b"\x89PNG")
    page = tmp_path / "page"
    ran(vgps, "export", run, "--output", tmp_path / "policy.onnx", "--web", page, **alone)
    assert "<html" in (page / "index.html").read_text()[:1000].lower()
    bag = ROOT / "recordings" / "sample"
    for words, needed in (
        (["node", "simulation"], r"needs ROS 2 Jazzy.*the extra \[ros\]"),
        (["execute-policy"], r"needs ROS 2 Jazzy.*the extra \[ros\]"),
        (["bag", "info", bag], r"needs the package 'rosbags'.*the extra \[bags\]"),
    ):
        assert re.search(needed, ran(vgps, *words, code=1, **alone))


def test_with_the_extra_ros_a_graph_learns_without_a_compiler_or_an_environment(wheels, tmp_path):
    vgps = install(wheels, tmp_path / "venv", "[ros]")
    alone = {"PATH": str(vgps.parent), "ROS_DOMAIN_ID": str(random.randint(101, 232))}
    alone |= {"HOME": str(tmp_path), "ROS_LOG_DIR": str(tmp_path / "log")}
    bag = tmp_path / "bag"
    nodes = ["simulation", "trajectory_optimizer", "policy_learner", "policy_executor", "recorder"]
    parameters = ["-p", "task:=rotor", "-p", f"recorder:output:={bag}"]
    graph = subprocess.Popen([vgps, "node", *nodes, "--ros-args", *parameters], env=CLEAN | alone)
    try:
        run = tmp_path / "run"
        ran(vgps, "train-through-graph", *QUICK[:2], "--output", run, "--timeout", "120", **alone)
        assert (run / "policy.json").is_file()
    finally:
        graph.send_signal(signal.SIGINT)
        assert graph.wait(60) == 0
    assert "vgps_msgs/msg/GaussianPolicy" in ran(vgps, "bag", "info", bag, **alone)


def test_the_demo_trains_a_quadruped_that_obeys_and_writes_both_pages(wheels, tmp_path):
    vgps, folder = install(wheels, tmp_path / "venv"), tmp_path / "a demo"
    alone = {"PATH": str(vgps.parent), "HOME": str(tmp_path)}
    shown = ran(vgps, "demo", "--output", folder, **alone)
    obeys = re.search(r"all of these\D+(\d+) % .*?(\d+) %", shown)
    assert obeys is not None
    assert min(map(int, obeys.groups())) > 80
    for name in ("shipped", "trained"):
        assert (folder / name / "index.html").stat().st_size > 5e6
    assert "exists already" in ran(vgps, "demo", "--output", folder, code=1, **alone)
