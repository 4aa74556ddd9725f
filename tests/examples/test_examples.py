# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The numbered examples run as they are, and do what they say."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def run(name: str, *arguments: object, iterations: int = 2) -> str:
    """Runs an example as a user does and returns its output."""
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / name, *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | {"ITERATIONS": str(iterations)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers(pattern: str, text: str) -> list[float]:
    return [float(number) for number in re.findall(pattern, text)]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short(example):
    assert len(example.read_text().splitlines()) <= 60


def test_on_a_linear_system_neither_step_lowers_the_bound_and_the_noise_falls():
    text = run("01_linear_system.py")
    bounds, noise = numbers(r"bound +(-?[\d.]+)", text), numbers(r"noise +([\d.]+)", text)
    assert len(bounds) == 20
    assert bounds == sorted(bounds)
    assert noise == sorted(noise, reverse=True)


@pytest.mark.slow
def test_a_swimmer_learns_and_its_policy_drives_it_without_ros(tmp_path):
    text = run("02_swimmer.py", tmp_path)
    assert len(re.findall(r"^\d+: policy", text, re.MULTILINE)) == 2
    [learned] = numbers(r"It swims ([\d.]+) m", text)
    [driven] = numbers(r"It went ([\d.]+) m", run("07_policy_without_ros.py", tmp_path))
    assert driven == pytest.approx(learned, abs=0.02)
    assert driven > 2.0


def test_the_own_cost_straightens_the_elbow():
    built_in, own = numbers(r": +([\d.]+) rad", run("04_own_cost.py"))
    assert own < 0.2 * built_in


def test_the_own_method_learns():
    text = run("05_own_method.py", iterations=5)
    *learned, ddp = [float(line.split(": ")[1]) for line in text.splitlines()]
    assert len(learned) == 5
    assert ddp < learned[-1] < learned[0]


def test_a_bag_is_read():
    text = run("06_read_a_bag.py", ROOT / "recordings" / "sample")
    assert "[sensor_msgs/msg/JointState]" in text
    assert "501 states of root_x" in text
    assert "  0.00 s: 0.000 away from q's mean" in text
