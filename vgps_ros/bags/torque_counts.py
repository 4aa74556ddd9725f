# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Holds what a check of a bag's torques found, as numbers."""

from dataclasses import dataclass, field

from vgps_ros.bags.executor_log import Counted


@dataclass
class TorqueCheck:
    """The outcome of a check, as numbers of torques and states.

    Attributes:
        deterministic: torques that equal the policy's mean.
        stochastic: torques that equal the policy's mean plus the noise of the recorded seed.
        close: torques of an ONNX network that equal its output within `onnx_policy.TOLERANCE`.
        rounded: torques of an old version that equal one of these within `TOLERANCE`.
        clipped: torques among these kinds that are at a limit of their size.
        rate_limited: torques among these kinds that are at a limit of their change.
        safe: other torques, of the safe action where the diagnostics say that it drove.
        last: zero torques with which the executor ended its activity.
        unexplained: zero or safe torques where nothing says that the safe action drove.
        unchecked: torques whose change is limited, but whose predecessor is not in the bag.
        unusable: states that no torque may answer, such as one that is not finite.
        unanswered: states without a torque while a policy drove in lock-step.
        skipped: states without a torque while a policy drove in real time.
        unknown: states without a torque, at whose time the executor said nothing.
        absent: states that the stamps of the others say are missing, in lock-step.
        early: torques that came before the first state of the bag.
        stateless: torques whose state is not in the bag, although earlier states are.
        surplus: torques of a policy beyond the states that they answer.
        disordered: torques of a policy that came after that of a later state.
        different: torques that neither the policy nor the safe action gives.
        counted: the executor's own count; None of a version that did not count.
        first_difference: a sentence on the first torque that is wrong.
        parameters: a sentence on each parameter that is recorded in two ways.
        refused: a sentence on each command that cannot be read.
    """

    deterministic: int = 0
    stochastic: int = 0
    close: int = 0
    rounded: int = 0
    clipped: int = 0
    rate_limited: int = 0
    safe: int = 0
    last: int = 0
    unexplained: int = 0
    unchecked: int = 0
    unusable: int = 0
    unanswered: int = 0
    skipped: int = 0
    unknown: int = 0
    absent: int = 0
    early: int = 0
    stateless: int = 0
    surplus: int = 0
    disordered: int = 0
    different: int = 0
    counted: Counted | None = None
    first_difference: str = ""
    parameters: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
