# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Follows the newest plan of model predictive control, made beside the answers or waited for."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from threading import Event

from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.policy import GaussianPolicy
from vgps_ros.core.records import Array
from vgps_ros.search.mpc import Plan, Planner


class PlanFollower:
    """Answers states with feedback along the newest plan, and makes the next one.

    A thread makes the plans. Its compiled loops and MuJoCo run without Python's lock, so an answer
    hardly waits for them. The first plan, begun anew, is the warm start where the newest plan is
    too old to drive.

    Args:
        planner: makes the plans; its task's dynamics must not be used by anybody else meanwhile.
        every: 0: plans are made one after another beside the answers; n: a plan is made from each
            n-th state, whose answer waits for it, so that a run repeats bit for bit.
        seed: seed of the first plan.
        on_plan: called with each new plan and the time that it took [s].

    Attributes:
        trouble: the reason why the latest solve found no plan, or None.

    Raises:
        DivergenceError: there is no first plan.
    """

    def __init__(
        self,
        planner: Planner,
        every: int,
        seed: int = 0,
        on_plan: Callable[[Plan, float], None] = lambda *_: None,
    ):
        self.trouble: str | None = None
        self._planner, self._every, self._on_plan = planner, every, on_plan
        self._worker = ThreadPoolExecutor(1, "plan")
        self._ending = Event()
        self._work: Future[tuple[Plan, float]] | None = None
        self._plan: Plan | None = None
        self._step = 0  # of the last state
        self._first = self._worker.submit(planner.first_plan, seed).result()

    def stop(self) -> None:
        """Ends what is being planned."""
        self._ending.set()
        self._worker.shutdown()

    def control(
        self, state: Array, step: int, policy: GaussianPolicy | None = None
    ) -> tuple[Array, int]:
        """Returns the torques in a state, shape (n_u,), [N·m], and the age of their plan in steps.

        Args:
            state: x, shape (n_x,).
            step: control step of the state; one before that of the last state starts a new time.
            policy: π_θ, which continues plans.

        Raises:
            InvalidInputError: the newest plan is too old to drive.
        """
        is_new_time = self._plan is None or step < self._step
        self._step = step
        if self._plan is None or is_new_time:
            # What is being planned is of the old time, and will not be taken.
            self._plan, self._work = replace(self._first, start=step), None
        if not self._every:
            if self._work is None or self._work.done():
                self._take_plan()
                self._begin(state, step, policy)
        elif is_new_time or step - self._plan.start >= self._every:
            self._begin(state, step, policy)
            self._take_plan()
        age = step - self._plan.start
        if age > self._planner.age_limit:
            raise InvalidInputError(
                f"the newest plan is {age} steps old, but a plan may drive for "
                f"{self._planner.age_limit} steps only; "
                + (self.trouble or "choose a shorter horizon.")
            )
        return self._planner.control(self._plan, state, step), age

    def _begin(self, state: Array, step: int, policy: GaussianPolicy | None) -> None:
        def solve(old: Plan) -> tuple[Plan, float]:
            began = time.perf_counter()
            plan = self._planner.next_plan(old, state, step, policy, self._ending.is_set)
            return plan, time.perf_counter() - began

        assert self._plan is not None
        is_over = step - self._plan.start > self._planner.age_limit
        old = replace(self._first, start=step) if is_over else self._plan
        self._work = self._worker.submit(solve, old)

    def _take_plan(self) -> None:
        """Makes the plan that was begun the newest; one that is under way is waited for."""
        if self._work is None:
            return
        try:
            self._plan, seconds = self._work.result()
        except VgpsError as error:
            self.trouble = f"no plan was found: {error}"
        else:
            self.trouble = None
            self._on_plan(self._plan, seconds)
