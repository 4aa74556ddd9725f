# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Control at 100 Hz in real time under pushes: policies, plans, and plans that a policy continues.

    python -m benchmarks.hundred_hertz --output recordings/hundred_hertz

It trains the policies that are missing, and writes a line of figures to runs.jsonl as each run ends
and the table of all to table.md. Runs that have a line are not run again. All of it takes a quarter
of an hour on two cores, and needs them for itself: on a busy machine deadlines are missed.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from vgps_ros.tasks import task_file_of

PERIOD = "0.01"  # of control [s]
ROBOTS = ("swimmer", "walker", "quadruped")
CONTROLLERS = ("policy", "mpc", "mpc with policy")
_COLUMNS = (
    *("plans a second", "median plan [ms]", "missed deadlines", "answer p50, p99 [ms]"),
    *("pushes", "falls", "median cost a step", "mean cost a step", "load average"),
)


def at_hundred_hertz(robot: str, folder: Path) -> str:
    """Returns what the robot's task at 100 Hz is called by; writes its file where that is new."""
    file = task_file_of(robot)
    assert file is not None
    text = file.read_text()
    if f"control_period: {PERIOD} " in text:
        return robot
    model = f"package://vgps_ros/tasks/{robot}/{robot}.xml"
    text = text.replace(f"model: {robot}.xml", f"model: {model}")
    text = text.replace("control_period: 0.02 ", f"control_period: {PERIOD} ")
    if robot == "swimmer":  # its own time step is that of its control
        text += f"changes: {{option: {{timestep: {PERIOD}}}}}\n"
    path = folder / f"{robot}.yaml"
    path.write_text(text)
    return str(path.resolve())


def trained(robot: str, task: str, folder: Path, iterations: int | None) -> Path:
    """Returns the folder of the robot's policy, which is trained if it is missing."""
    run = folder / robot
    words = [*("vgps", "train", "--task", task, "--output", str(run))]
    if iterations:
        words += ["--iterations", str(iterations)]
    if not (run / "distribution.npz").exists():  # the last file that a training writes
        print(f"{robot}: training its policy ...", flush=True)
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    return run / "policy.json"


def measure(task: str, controller: str, policy: Path, given: argparse.Namespace) -> dict[str, Any]:
    """Drives the robot by one controller; returns the figures of `benchmarks.pushes`."""
    node = "policy_executor" if controller == "policy" else "mpc"
    words = [sys.executable, "-m", "benchmarks.pushes", task, node]
    if controller != "mpc":
        words += ["--policy", str(policy)]
    for name in ("seconds", "push", "every", "horizon"):
        words += [f"--{name}", str(getattr(given, name))]
    done = subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True)
    figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return figures


def table(lines: list[dict[str, Any]]) -> str:
    """Returns the figures as a table of Markdown."""
    head = ("robot", "controller", *_COLUMNS)
    rows = [head, ("---",) * len(head)]
    rows += [
        (line["robot"], line["controller"], *(_cell(line[name]) for name in _COLUMNS))
        for line in lines
    ]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def main() -> None:
    """Runs what is missing, and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("recordings/hundred_hertz"))
    parser.add_argument("--robots", nargs="+", default=ROBOTS, choices=ROBOTS)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each run")
    parser.add_argument("--push", type=float, default=0.3, help="change of velocity [m/s]")
    parser.add_argument("--every", type=float, default=2.0, help="between two pushes [s]")
    parser.add_argument("--horizon", type=float, default=0.5, help="of plans [s]")
    parser.add_argument("--iterations", type=int, help="of trainings; the task's own if left out")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    runs = given.output / "runs.jsonl"
    lines = [json.loads(line) for line in runs.read_text().splitlines()] if runs.exists() else []
    for robot in given.robots:
        task = at_hundred_hertz(robot, given.output)
        policy = trained(robot, task, given.output, given.iterations)
        for controller in CONTROLLERS:
            if any((one["robot"], one["controller"]) == (robot, controller) for one in lines):
                continue
            print(f"{robot}, {controller}: {given.seconds:g} s ...", flush=True)
            figures = measure(task, controller, policy, given)
            lines.append({**figures, "robot": robot, "controller": controller})
            with runs.open("a") as file:
                file.write(json.dumps(lines[-1]) + "\n")
            (given.output / "table.md").write_text(table(lines))
    print(table(lines))


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(f"{each:.3g}" for each in value)
    return "–" if value is None else f"{value:.3g}"


if __name__ == "__main__":
    main()
