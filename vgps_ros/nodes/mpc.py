# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Lifecycle node `mpc`: plans from the newest state over a receding horizon, and follows the plan.

Each state is answered with the feedback of the newest plan. A plan that is late leaves the one
before it in use; where that one becomes too old, the safe action drives until a plan comes.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from vgps_msgs.msg import Plan as PlanMsg

from vgps_ros.core.cost import FeatureCost
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.core.seeding import SEED
from vgps_ros.core.settings import Range, Setting, settings_of
from vgps_ros.messages.conversions import plan_to_msg, stamp_of
from vgps_ros.messages.names import PLAN_AGE, PLAN_COST, PLAN_DURATION
from vgps_ros.ros_runtime.controller import Controller
from vgps_ros.ros_runtime.parameters import declare, declare_fact, declare_settings, value
from vgps_ros.ros_runtime.qos import STREAM
from vgps_ros.ros_runtime.runner import Runnable, streaming_executor
from vgps_ros.ros_runtime.training_results import TrainingResults
from vgps_ros.search.mpc import (
    LARGEST_ADJUSTMENT,
    MpcSettings,
    Plan,
    PlanFollower,
    Planner,
    adjustable,
)
from vgps_ros.search.trajectory_optimization import prepare
from vgps_ros.tasks import make_task
from vgps_ros.tasks.registry import TASK

PLAN_EVERY = Setting(
    "plan_every",
    1,
    Range(0, 1000),
    "states between two plans, where each plan's state waits for it, as a simulation in lock-step "
    "does; 0: plans are made one after another beside the answers, which real time needs",
)
_PERIOD = 1.0  # over which the rate of the plans is counted [s]


@dataclass(frozen=True)
class _CostSettings:
    """What can be changed of the cost."""

    readings: Annotated[
        tuple[str, ...],
        "the readings of the cost to which cost.targets and cost.weights belong, given by the task",
    ]
    targets: Annotated[
        tuple[float, ...],
        Range(-LARGEST_ADJUSTMENT, LARGEST_ADJUSTMENT),
        "their targets, from the next plan on [units of the readings]",
    ]
    weights: Annotated[
        tuple[float, ...], Range(0.0, LARGEST_ADJUSTMENT), "their weights, from the next plan on"
    ]


class Mpc(Controller):
    """Answers each state with feedback along the newest plan."""

    def __init__(self) -> None:
        super().__init__("mpc", needs_policy=False)

    def prepare_law(self) -> None:
        """Declares the parameters of the plans, and makes the first one before any peer waits."""
        self._task = task = make_task(value(self, TASK))
        settings = declare_settings(self, MpcSettings(ddp=task.optimizer.ddp))
        every, seed = declare(self, PLAN_EVERY), declare(self, SEED)
        prepare(task)
        planner = Planner(task, settings)
        self._steps = planner.steps
        _declare_cost(self, task.cost, partial(setattr, planner, "cost"))
        self._since, self._count = time.monotonic(), 0  # of plans
        self._plans = self.create_publisher(PlanMsg, "plan", STREAM)
        self._horizon = PlanFollower(planner, every, seed, self._take_plan)

    def law(self, training: TrainingResults, state: Array, stamp: int) -> Array:
        """Returns the newest plan's controls; a plan holds the commands.

        Raises:
            InvalidInputError: the newest plan is too old.
        """
        step = round(stamp * 1e-9 / self.robot.time_step)
        executed = training.policy
        policy = executed.policy if executed else None
        assert policy is None or isinstance(policy, GaussianPolicy)  # others are refused
        ahead = self.instructions.ahead(self._steps)
        try:
            control, age = self._horizon.control(state, step, policy, ahead)
        finally:
            trouble = self._horizon.trouble
            self.health.report("plan", warning=f"At step {step} {trouble}" if trouble else "")
        self.health.set_value(PLAN_AGE, f"{age * self.robot.time_step:.3f} s")
        return control

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forgets the trouble with plans."""
        self.health.clear("plan")
        return super().on_deactivate(state)

    def end(self) -> None:
        """Stops the commands and what is being planned."""
        self.stop()
        self._horizon.stop()

    def _take_plan(self, plan: Plan, seconds: float) -> None:
        self._count += 1
        passed = time.monotonic() - self._since
        if passed > _PERIOD:
            self.health.set_value("plan rate", f"{self._count / passed:.1f} Hz")
            self._since, self._count = time.monotonic(), 0
        self.health.set_value(PLAN_COST, f"{plan.cost:.4g}")
        self.health.set_value(PLAN_DURATION, f"{1e3 * seconds:.1f} ms")
        stamp = stamp_of(round(plan.start * self.robot.time_step * 1e9))
        self._plans.publish(plan_to_msg(plan, self._task, seconds, stamp))


def _declare_cost(node: Node, cost: FeatureCost, take: Callable[[FeatureCost], object]) -> None:
    """Declares the cost's targets and weights as parameters, where it has any that can be changed.

    `take` is called with the cost, now and after each change.
    """
    changed = adjustable(cost)
    if not changed.names:
        return
    values = (tuple(array.tolist()) for array in (changed.targets, changed.weights))
    readings, targets, weights = settings_of(_CostSettings(changed.names, *values), "cost.")
    declare_fact(node, readings)
    for setting in (targets, weights):
        declare(node, setting, may_change=True, also_check=changed.check_count)

    def adjust(parameters: list[Parameter]) -> None:
        if {p.name for p in parameters} & {targets.name, weights.name}:
            take(changed(value(node, targets), value(node, weights)))

    node.add_post_set_parameters_callback(adjust)
    take(changed(value(node, targets), value(node, weights)))


NODE = Runnable(Mpc, streaming_executor, close=lambda node: node.end())
