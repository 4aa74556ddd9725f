# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Every command on every page runs, from the top of the page to its end, in a folder of its own.

`SHORTER` says which commands are shortened, and `NOT_RUN` which cannot be run, with the reason.
"""

import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.nodes.conftest import domain_id  # noqa: F401
from vgps_ros.programs.__main__ import main as vgps

ROOT = Path(__file__).parents[2]
EVIDENCE = ROOT / "docs" / "evidence"
AT_THE_TOP = [ROOT / f"{name}.md" for name in ("README", "AGENTS", "CONTRIBUTING")]
PAGES = [*AT_THE_TOP, *sorted((ROOT / "docs").rglob("*.md"))]
PATIENCE = 1500.0  # for one command, which pytest may end earlier [s]

# Words that are put behind a command, where the last of several values counts. The sample is a bag
# of a swimmer with noise.
SHORTER = {
    r"vgps train ": "--iterations 2 --initial-ddp-iterations 2 --evaluation-rollouts 2",
    # Fewer iterations do not close the gaps that a push opens in the first motion.
    r"vgps train .*--disturb-push": "--situations 2 --initial-ddp-iterations 12",
    r"vgps train --task walker --demonstration": "--task swimmer --demonstration-tolerance 9",
    r"vgps train-through-graph ": "--iterations 1",
    r"vgps evaluate ": "--rollouts 2 --seconds 1",
    # The errors of commands count after 1 s.
    r"vgps evaluate recordings/c": "--seconds 3",
    r"vgps node .*rollout_robots": "-p mirror.first_steps:=1",
    r"vgps node .*task:=quadruped": "-p task:=swimmer",  # whose policy stands for DIR's
    r"python -m benchmarks.figure1 run ": "--panels swimmer-5 --methods vgps --seeds 1 "
    "--iterations 1 --jobs 1",
    r"python -m benchmarks.find_gait ": "--evaluations 8 --seconds 1",
    r"vgps execute-policy": "--steps 20",
    r"make demo": "ITERATIONS=1",
}

# They run until somebody ends them.
LASTING = r"vgps (node|live|view)\b"

NOT_RUN = {
    r"make (setup|development|test|lint|site)|\.ci/run|python -m pytest": "this test is a part "
    "of it, or it would change the environment that runs it",
    r"make w|(UV_\S+ )?uv|python -m venv": "downloads; the tests of the wheels install them",
    r"ln -sfn|colcon build|cd WORKSPACE|source install/|ros2 run vgps_ros simulation": "needs a "
    "workspace, which make test-all builds",
    r"rosdep|echo .*rosdep|export PIP_": "needs a ROS installation, which the wheels are not",
    r"ros2 (launch|lifecycle|service|action|topic|param|security)|.*--enclave": "the wheels have "
    "no ros2cli; tests/nodes calls the same services, topics and parameters",
    r"eval |autoload": "completes words in a shell with a person before it",
    r"export (FASTRTPS|ROS_)": "is about other machines",
    r"ssh-keygen -Y|sha256sum": "needs an own SSH key; tests/bags/test_bag_check.py makes one",
    r"vgps drive": "steers a task with commands, for which the swimmer stands here; "
    "tests/nodes/test_drive.py steers one",
    r"vgps export .*--unitree": "is for robots of servos, for which the swimmer stands here; "
    "tests/programs/test_field_export.py exports one",
    r"vgps .*duck|robotctl": "needs the model of the robot, or the robot; "
    "tests/programs/test_microduck.py exports a policy for one",
    r"vgps export .*--web": "needs what make web fetches; tests/views/test_web_page.py writes one",
    r"vgps import .*(--contract|policy\.yaml)": "needs files of other projects; "
    "tests/policies and tests/programs read such",
    r".*--pictures": "needs EGL; tests/bags/test_data_sets.py renders where there is one",
}


def blocks(page):
    """Returns the commands of each fenced block of bash, without comments."""
    found = []
    for text in re.findall(r"^```bash\n(.*?)^```", page.read_text(), re.M | re.S):
        joined = re.sub(r"\\\n\s*", "", text)
        lines = [re.sub(r"\s+# .*|^#.*", "", line).strip() for line in joined.splitlines()]
        found.append([command for line in lines if line for command in line.split(" && ")])
    return found


WITH_COMMANDS = [page for page in PAGES if EVIDENCE not in page.parents and blocks(page)]
COMMANDS = [command for page in WITH_COMMANDS for block in blocks(page) for command in block]


class Reader:
    """A reader of a page who types its commands into one shell after another.

    DIR stands for the folder that the command before wrote, at first that of a short training, BAG
    for a copy of the sample, and TASK for the swimmer.
    """

    def __init__(self, folder, run, domain):
        self.folder, self.written, self.count = folder, "run", 0
        (folder / "recordings").mkdir()
        (folder / "recordings" / "sample").symlink_to(ROOT / "recordings" / "sample")
        for name in ("config", "scripts", "requirements", "examples", "env.bash", "benchmarks"):
            (folder / name).symlink_to(ROOT / name)
        shutil.copytree(run, folder / "run")
        shutil.copytree(ROOT / "recordings" / "sample", folder / "bag")
        (folder / "policy.onnx").symlink_to(run / "policy.onnx")
        environment = {
            **{k: v for k, v in os.environ.items() if "DISPLAY" not in k},
            "ROS_DOMAIN_ID": str(domain),
            "ROS_LOG_DIR": str(folder / "log"),
        }
        # Each command runs here, in a session of its own, and without a person before it.
        self.place = {
            "cwd": folder,
            "env": environment,
            "stdin": subprocess.DEVNULL,
            "start_new_session": True,
            "text": True,
        }
        self.shells = []

    def type(self, block):
        """Runs the commands of one block; what lasts is ended with INT, and must end well."""
        lasting, said_before = [], ""
        try:
            for command in map(self.real, block):
                if re.match(r"\w+\+?=|source ", command):
                    said_before += f"{command}\n"
                elif re.match(LASTING, command):
                    lasting.append(self.start(f"{said_before}exec {command}"))
                else:
                    self.run(f"{said_before}{command}")
        finally:
            for process, _ in lasting:
                process.send_signal(signal.SIGINT)
            codes = [process.wait(PATIENCE) for process, _ in lasting]
        for code, (process, log) in zip(codes, lasting, strict=True):
            assert code == 0, f"{process.args}\n{log.read_text()}"

    def real(self, command):
        """Returns a command of a page with what its placeholders stand for."""
        command = re.sub(r"\bBAG\b(\.\.\.)?", "bag", command)
        command = re.sub(r"\bTASK\b(?!=)", "swimmer", command)
        command = command.replace("make ", f"make -C {ROOT} ").replace(
            "OUTPUT=", f"OUTPUT={self.folder}/"
        )
        if re.match(r"make .* demo", command) and "OUTPUT=" not in command:
            self.count += 1
            self.written = f"demo-{self.count}"
            command += f" OUTPUT={self.folder}/{self.written}"
        command = re.sub(r"TASK=\$PWD", f"TASK={self.folder}", command)
        if "--output DIR" in command:
            self.count += 1
            self.written = f"written-{self.count}"
        elif "--output policy.onnx" in command:
            (self.folder / "policy.onnx").unlink()
        return re.sub(r"\bDIR\b", self.written, command)

    def run(self, command):
        shell = self.open(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        output, errors = shell.communicate(timeout=PATIENCE)
        assert shell.returncode == 0, f"{command}\n{output[-3000:]}\n{errors[-3000:]}"

    def start(self, command):
        """Starts a command in the background, and returns it once it has said something."""
        self.count += 1
        log = self.folder / f"lasting-{self.count}.log"
        with log.open("w") as file:
            process = self.open(command, stdout=file, stderr=subprocess.STDOUT)
        end = time.monotonic() + PATIENCE
        while process.poll() is None and not log.read_text() and time.monotonic() < end:
            time.sleep(0.1)
        assert process.poll() in (None, 0), f"{command}\n{log.read_text()}"
        return process, log

    def open(self, command, **streams):
        shell = subprocess.Popen(["bash", "-c", command], **self.place, **streams)
        self.shells.append(shell)
        return shell

    def close(self):
        """Kills the shells that have not ended in time, with all that they started."""
        for shell in self.shells:
            if shell.poll() is None:
                os.killpg(shell.pid, signal.SIGKILL)
                shell.wait()


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    run = tmp_path_factory.mktemp("trained") / "run"
    quick = ["--iterations", "1", "--initial-ddp-iterations", "2", "--evaluation-rollouts", "2"]
    vgps(["train", "--task", "swimmer", "--hidden-units", "5", *quick, "--output", str(run)])
    vgps(["export", str(run), "--output", str(run / "policy.onnx")])
    return run


@pytest.fixture
def reader(tmp_path, trained, domain_id):  # noqa: F811
    reader = Reader(tmp_path, trained, domain_id)
    yield reader
    reader.close()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_commands_of_a_page_run(reader, page):
    for block in blocks(page):
        run = [c for c in block if not any(re.match(p, c) for p in NOT_RUN)]
        words = {c: [SHORTER[p] for p in SHORTER if re.match(p, f"{c} ")] for c in run}
        reader.type([" ".join([command, *words[command]]) for command in run])


@pytest.mark.parametrize("pattern", [*NOT_RUN, *SHORTER])
def test_what_is_said_of_commands_is_about_commands_that_are_there(pattern):
    assert any(re.match(pattern, f"{command} ") for command in COMMANDS)
