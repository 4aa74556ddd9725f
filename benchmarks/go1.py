# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Our Go1 beside MuJoCo Playground's: `python -m benchmarks.go1 PEER RUN`.

PEER is a folder with Playground's `scene.xml`, what it includes, and `go1_policy.onnx`; RUN is the
folder of a training of `benchmarks/go1.yaml`. Both policies drive the same model, Playground's own
and unchanged, by plain MuJoCo: the same commands, the same starts and the same pushes.

The peer reads the base's velocity, which no sensor of the robot measures; ours is blind.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import onnxruntime

from vgps_ros.core.records import Array
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.search.judgement import SETTLING, command_grid, interval
from vgps_ros.storage.run_folder import RunFolder
from vgps_ros.tasks import recorded_task

PERIOD = 0.02  # of both policies [s]
LONG = 20.0  # of a rollout in which commands are obeyed [s]
PUSHED_AT, PUSH, AFTER = 3.0, 0.1, 10.0  # when, for how long, and how long it must stay up [s]
IMPULSES = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)  # [N·s]
LOWEST = 0.15  # height of the trunk below which a robot has fallen [m]
READ = ("local_linvel", "gyro")  # the speeds that the peer was trained to track

Law = Callable[[int, list[mujoco.MjData]], Array]


class Peer:
    """Playground's policy with what it reads; targets are those of its keyframe, plus half of it.

    Args:
        folder: the peer's files.
        model: its model.
        commands: of each robot, shape (N, 3).
    """

    def __init__(self, folder: Path, model: mujoco.MjModel, commands: Array):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(folder / "go1_policy.onnx", options)
        self._commands, self._site = commands, model.site("imu").id
        self._pose = model.keyframe("home").qpos[7:]
        self._last = np.zeros((len(commands), model.nu))

    def __call__(self, _: int, robots: list[mujoco.MjData]) -> Array:
        """Returns the servos' targets, shape (N, 12)."""
        for i, data in enumerate(robots):
            read = [
                *(data.sensor(name).data for name in READ),
                -data.site_xmat[self._site].reshape(3, 3)[2],  # gravity's direction
                data.qpos[7:] - self._pose,
                data.qvel[6:],
                self._last[i],
                self._commands[i],
            ]
            given = {"obs": np.concatenate(read, dtype=np.float32)[None]}
            self._last[i] = self._session.run(["continuous_actions"], given)[0][0]
        return np.asarray(self._pose + 0.5 * self._last)


class Ours:
    """Our policy with what it reads.

    Args:
        run: the folder of its training.
        commands: of each robot, shape (N, 3).
        steps: length of the rollouts.
    """

    def __init__(self, run: Path, commands: Array, steps: int):
        file = open_policy(RunFolder(run).policy)
        task = recorded_task(file.task)
        self._driver, signals = driver_of(task.deployment, file), task.signals
        self._contexts = np.array([signals.constant_context(each, steps) for each in commands])

    def __call__(self, t: int, robots: list[mujoco.MjData]) -> Array:
        """Returns the servos' targets, shape (N, 12)."""
        states = np.array([np.concatenate([data.qpos, data.qvel]) for data in robots])
        observation = self._driver.observation
        read = [observation.readings(states), self._contexts[:, t][:, observation.columns]]
        return self._driver.policy.mean(np.concatenate(read, axis=1))


def driven(
    model: mujoco.MjModel, law: Law, starts: Array, steps: int, impulses: Array
) -> tuple[Array, Array]:
    """Lets a law drive robots, which are pushed at their trunk.

    Args:
        model: the robot.
        law: targets of step t, shape (N, n_u), from the simulations.
        starts: qpos of each, shape (N, n_q).
        steps: length of the rollouts.
        impulses: of each, shape (N, 2) [N·s].

    Returns:
        Whether each is up, shape (N, steps), and its speeds: ahead, to the left and turning, shape
        (N, steps, 3) [m/s, rad/s].
    """
    robots = [mujoco.MjData(model) for _ in starts]
    for data, start in zip(robots, starts, strict=True):
        mujoco.mj_resetDataKeyframe(model, data, model.keyframe("home").id)
        data.qpos[:] = start
        mujoco.mj_forward(model, data)
    substeps, trunk = round(PERIOD / model.opt.timestep), model.body("trunk").id
    up, speeds = np.ones((len(starts), steps), dtype=bool), np.zeros((len(starts), steps, 3))
    first, last = (round(seconds / PERIOD) for seconds in (PUSHED_AT, PUSHED_AT + PUSH))
    for t in range(steps):
        targets = law(t, robots)
        for i, data in enumerate(robots):
            data.ctrl[:] = targets[i]
            data.xfrc_applied[trunk, :2] = impulses[i] / PUSH if first <= t < last else 0.0
            mujoco.mj_step(model, data, substeps)
            mujoco.mj_forward(model, data)
            up[i, t] = data.sensor("position").data[2] > LOWEST
            speeds[i, t] = [*data.sensor(READ[0]).data[:2], data.sensor(READ[1]).data[2]]
    return np.logical_and.accumulate(up, axis=1), speeds


def perturbed(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> Array:
    """Returns starts near the keyframe, shape (count, n_q): joints differ by 0.01 rad."""
    starts = np.tile(model.keyframe("home").qpos, (count, 1))
    starts[:, 7:] += 0.01 * rng.standard_normal((count, model.nq - 7))
    return starts


def share(of: Array) -> str:
    """Returns a share with Wilson's interval of 95 %."""
    low, high = interval(float(of.mean()), len(of))
    return f"{100 * of.mean():.0f} % ({100 * low:.0f}-{100 * high:.0f})"


def main() -> None:
    """Runs the comparison, and prints its tables as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("peer", type=Path, help="folder of the peer's files")
    parser.add_argument("run", type=Path, help="folder of our training")
    parser.add_argument("--rollouts", type=int, default=8, help="at each command")
    parser.add_argument("--pushes", type=int, default=40, help="of each impulse")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    model = mujoco.MjModel.from_xml_path(str(given.peer / "scene.xml"))
    signals = recorded_task(open_policy(RunFolder(given.run).policy).task).signals
    rng = np.random.default_rng(given.seed)

    def both(commands: Array, steps: int, impulses: Array) -> list[tuple[Array, Array]]:
        starts = perturbed(model, len(commands), rng)
        laws = (Peer(given.peer, model, commands), Ours(given.run, commands, steps))
        return [driven(model, law, starts, steps, impulses) for law in laws]

    grid = command_grid(signals)
    commands = np.repeat(grid, given.rollouts, axis=0)
    found = both(commands, round(LONG / PERIOD), np.zeros((len(commands), 2)))
    settled = slice(round(SETTLING / PERIOD), None)
    print("| command | peer: up | ours: up | peer: rms errors | ours: rms errors |")
    print("| --- | --- | --- | --- | --- |")
    rows = [(str(row.tolist()), (commands == row).all(axis=1)) for row in grid]
    for name, own in [*rows, ("all", np.ones(len(commands), dtype=bool))]:
        ups = [share(up[own, -1]) for up, _ in found]
        errors = []
        for up, speeds in found:
            e = (speeds[own] - commands[own, None])[:, settled][up[own][:, settled]]
            rms = np.sqrt((e**2).sum(axis=0) / max(1, len(e)))
            errors.append(" ".join(f"{value:.3f}" for value in rms))
        print("|", " | ".join([name, *ups, *errors]), "|")
    steps = round((PUSHED_AT + PUSH + AFTER) / PERIOD)
    commands = grid[rng.integers(len(grid), size=given.pushes)]
    angles = rng.uniform(0.0, 2 * np.pi, size=given.pushes)
    print("\n| impulse [N·s] | peer: up | ours: up |\n| --- | --- | --- |")
    for size in IMPULSES:
        pushes = size * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        shares = [share(up[:, -1]) for up, _ in both(commands, steps, pushes)]
        print("|", " | ".join([f"{size:g}", *shares]), "|")


if __name__ == "__main__":
    main()
