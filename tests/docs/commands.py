# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The commands of README, CONTRIBUTING and docs, and what the tests make of them.

This is the one place that says which commands of the pages are shortened, which take long, and
which cannot be run, with the reason. All others are run as they stand.
"""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
EVIDENCE = ROOT / "docs" / "evidence"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if EVIDENCE not in page.parents]

# Words that are put behind a command, where the last of several values counts. The sample is a bag
# of a swimmer with noise.
SHORTER = {
    r"vgps train ": "--iterations 2 --initial-ddp-iterations 2 --evaluation-rollouts 2",
    # Fewer iterations do not close the gaps that a push opens in the first motion.
    r"vgps train .*--disturb-push": "--situations 2 --initial-ddp-iterations 12",
    r"vgps train --task walker --demonstration": "--task swimmer --demonstration-tolerance 9",
    r"vgps train-through-graph ": "--iterations 1",
    r"vgps evaluate ": "--rollouts 2 --seconds 1",
    r"figure1 run ": "--panels swimmer-5 --methods vgps --seeds 1 --iterations 1 --jobs 1",
    r"vgps find-gait ": "--evaluations 8 --seconds 1",
    r"vgps execute-policy": "--steps 20",
    r"make demo": "ITERATIONS=1",
    r"make damages": "COUNT=2",
}

# They take long even so: `pytest -m slow tests/docs` runs these, and what stands before them.
SLOW = (
    r"make (demo|damages)",
    r"recordings/cheetah-(run|demo)|cheetah\.onnx",
    r"vgps (train-through-graph|execute-policy)\b|benchmarks.figure1 (run|plot)\b",
    r"--disturb-push|--pushes",
    r"config/walker/five_units",
)

# They run until somebody ends them.
LASTING = r"vgps (node|live|view)\b"

NOT_RUN = {
    r"make (test|coverage|lint|site)|\.ci/run": "this test is a part of it",
    r"make faults": "takes ten minutes; tests/nodes/test_faults.py runs a short one",
    r"make bench|python -m benchmarks --help": "installs the peers; tests/benchmarks tries it",
    r"pip install": "downloads; make setup has installed it, and make test-all installs anew",
    r"ln -sfn|colcon build|cd WORKSPACE|source install/|ros2 run vgps_ros simulation": "needs a "
    "workspace, which make test-all builds",
    r"rosdep": "needs a ROS installation, which the wheels are not",
    r"ros2 (launch|service|action|topic|param|security)|.*--enclave": "the wheels have no ros2cli; "
    "tests/nodes calls the same services, topics and parameters",
    r"eval |autoload": "completes words in a shell with a person before it",
    r"export (FASTRTPS|ROS_)": "is about other machines",
    r"ssh-keygen -Y|sha256sum": "needs an own SSH key; tests/bags/test_bag_check.py makes one",
    r".*--pictures": "needs EGL; tests/bags/test_data_sets.py renders where there is one",
}


def blocks(page: Path) -> Iterator[list[str]]:
    """Yields the commands of each fenced block of bash, without comments."""
    for text in re.findall(r"^```bash\n(.*?)^```", page.read_text(), re.M | re.S):
        joined = re.sub(r"\\\n\s*", "", text)
        lines = [re.sub(r"\s+# .*|^#.*", "", line).strip() for line in joined.splitlines()]
        yield [command for line in lines if line for command in line.split(" && ")]


def matching(patterns: object, command: str) -> list[str]:
    """Returns the patterns that a command begins with; of SLOW those that are in it."""
    return [p for p in patterns if re.match(p, command)]  # type: ignore[attr-defined]


def is_slow(command: str) -> bool:
    """Returns whether a command is left to the slow tests."""
    return any(re.search(pattern, command) for pattern in SLOW)


def shortened(command: str) -> str:
    """Returns a command with what makes it short."""
    return " ".join([command, *(SHORTER[p] for p in SHORTER if re.match(p, f"{command} "))])
