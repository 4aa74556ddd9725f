# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The example that starts the graph from Python trains a policy and ends its nodes."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_graph_is_started_from_python_and_learns(graph):
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / "03_graph.py"],
        env=os.environ | {"ITERATIONS": "2", "ROS_DOMAIN_ID": str(graph.domain_id)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "2: policy" in done.stdout
    assert "Trained for 2 iterations. The policy has 21 parameters." in done.stdout
    assert "The nodes ended with [0, 0]." in done.stdout
