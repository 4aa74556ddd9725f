# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Drives a robot by a sampler of judo: run by the Python of an environment that has judo.

It reads a problem as JSON from standard input, and writes the drive as JSON; see
`benchmarks.sampling_peers`.
"""

import json
import sys
from typing import Any

import mujoco
import numpy as np
from judo.controller import Controller, ControllerConfig
from judo.optimizers import get_registered_optimizers
from judo.tasks.base import Task, TaskConfig

from benchmarks.closed_loop import drive

# Standard deviation of samples, as a share of half a control's range: on the cart-pole, .1 served
# predictive sampling best of .1 and .3, each with judo's ramp of the noise and without.
SIGMA = 0.1


class SharedTask(Task[TaskConfig]):
    """A problem as a task of judo.

    Judo's own constructor would download meshes, which no model here has.
    """

    config_t = TaskConfig

    def __init__(self, problem: dict[str, Any]):
        self.config = TaskConfig()
        self.model = self.sim_model = mujoco.MjModel.from_xml_string(problem["mjcf"])
        self.data = mujoco.MjData(self.model)
        self.start = np.array(problem["start"])
        self._readings = problem["readings"]  # ["sensor" or "state", place] of each
        self._terms = [np.array(problem[key]) for key in ("targets", "weights", "controls")]
        self._bounds = [np.array(problem[key], float) for key in ("lowest", "highest")]
        self._fallen = problem["fallen"]  # readings, as above
        self._penalty = problem["penalty"]
        self._begun = self.start

    def reset(self) -> None:
        """Puts the robot where it starts."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos, self.data.qvel = np.split(self.start, [self.model.nq])
        mujoco.mj_forward(self.model, self.data)

    def pre_rollout(self, curr_state: Any) -> None:
        """Keeps the state from which the rollouts begin."""
        self._begun = curr_state

    def reward(self, states: Any, sensors: Any, controls: Any, system_metadata: Any = None) -> Any:
        """Returns the negative cost of each rollout.

        MuJoCo's sensors are of the state before each step, so the states are taken there too.
        """
        first = np.broadcast_to(self._begun, states[:, :1].shape)
        before = np.concatenate([first, states[:, :-1]], axis=1)
        targets, weights, control_weights = self._terms
        errors = self._read(self._readings, before, sensors) - targets
        costs = (errors**2 @ weights + controls**2 @ control_weights).sum(axis=1)
        values, (low, high) = self._read(self._fallen, before, sensors), self._bounds
        fallen = ((values < low) | (values > high)).any(axis=2).sum(axis=1)
        return -np.nan_to_num(costs + self._penalty * fallen, nan=np.inf)

    def _read(self, readings: Any, states: Any, sensors: Any) -> Any:
        columns = [(sensors if kind == "sensor" else states)[..., at] for kind, at in readings]
        return np.stack(columns, axis=-1) if columns else np.zeros((*states.shape[:2], 0))


class SharedRobot:
    """The robot, simulated by the same model."""

    def __init__(self, task: SharedTask, substeps: int):
        self._task, self._substeps = task, substeps
        task.reset()

    @property
    def state(self) -> Any:
        """The state, shape (n_x,)."""
        return np.concatenate([self._task.data.qpos, self._task.data.qvel])

    def advance(self, control: Any) -> None:
        """Holds a control for one control step."""
        self._task.data.ctrl[:] = control
        for _ in range(self._substeps):
            mujoco.mj_step(self._task.model, self._task.data)


class JudoPlanner:
    """One of judo's optimizers, with as many samples, knots and seconds a plan as our sampler."""

    def __init__(self, problem: dict[str, Any], name: str):
        self._time_step = problem["time_step"]
        kind, config = get_registered_optimizers()[name]
        settings = config(num_rollouts=problem["samples"], num_nodes=problem["nodes"])
        if name == "cem":
            settings.sigma_min, settings.sigma_max = 0.1 * SIGMA, 3.0 * SIGMA
        else:
            settings.sigma = SIGMA
        control = ControllerConfig(
            horizon=problem["plan"], spline_order="linear", action_normalizer="min_max"
        )
        task = SharedTask(problem)
        self._controller = Controller(control, task, kind(settings, task.nu))

    def plan(self, state: Any, step: int) -> Any:
        """Does one update of the plan; returns its law, a spline over time."""
        controller = self._controller
        controller.current_state, controller.time = state, step * self._time_step
        controller.update_action()
        spline = controller.spline
        return lambda _, at: np.atleast_1d(spline(at * self._time_step))


def main() -> None:
    """Drives the robot of a problem."""
    problem = json.load(sys.stdin)
    np.random.seed(problem["seed"])  # noqa: NPY002 (judo draws from it)
    planner = JudoPlanner(problem, problem["optimizer"])
    robot = SharedRobot(SharedTask(problem), problem["substeps"])
    period, preparation = problem["period"], problem["preparation"]
    planner.plan(robot.state, 0)  # what a first call costs does not count
    driven = drive(robot, planner, problem["steps"], period, preparation)
    json.dump(
        {
            "states": driven.states.tolist(),
            "controls": driven.controls.tolist(),
            "plans": driven.plans,
        },
        sys.stdout,
    )


if __name__ == "__main__":
    main()
