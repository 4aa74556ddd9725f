# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a policy reads, by the terms that controllers of others know, and a network for those.

Others know terms where our policies read numbers: the positions of all joints, the velocity of the
base in its axes. A number of ours is one of a term where both agree in several states. A network
for others begins by picking its numbers out of the terms.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from vgps_ros.core.checks import quote
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.memory import LAST_ACTION, terms_of
from vgps_ros.core.records import Array
from vgps_ros.policies.contract import VELOCITY_COMMANDS, Contract
from vgps_ros.policies.driver import observation_of
from vgps_ros.policies.onnx_file import Builder, ExportedPolicy, with_commas
from vgps_ros.robot.controls import ControlKind
from vgps_ros.robot.unrest import RATE, TILT
from vgps_ros.simulation.model import state_names
from vgps_ros.simulation.readings import Readings
from vgps_ros.storage.files import replacing
from vgps_ros.tasks.task import Task

_BASE = ("base_lin_vel", "base_ang_vel", "projected_gravity")
_TERMS = (*_BASE[1:], "velocity_commands", "joint_pos", "joint_vel", "last_action", "gait_phase")
# What Unitree's controller calls the terms that it knows, in the order in which it has them.
UNITREE_NAMES = {each: f"{each}_rel" if each in _TERMS[3:5] else each for each in _TERMS}
COMMAND_NAMES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")  # others' names of VELOCITY_COMMANDS
_STATES = 4  # in which numbers are compared
_SAME = 1e-9


@dataclass(frozen=True)
class Number:
    """A number that a policy reads: ± a number of a term."""

    name: str  # its own name
    term: str = ""  # the term, of `policies.contract`; empty: there is none
    index: int = 0  # its place in the term
    sign: float = 1.0  # 1 or -1
    lag: int = 0  # how many steps ago it was read


def find_numbers(task: Task, observed: tuple[str, ...]) -> list[Number]:
    """Returns what a policy of the task reads, each number by its term where it is of one."""
    terms = terms_of(observed)
    read = {name for name, _ in terms} - {LAST_ACTION, *task.signals.names}
    known = _find_terms(task, sorted(read))
    acting = [Number(f"{LAST_ACTION}/{i}", LAST_ACTION, i) for i in range(len(task.controls.names))]
    found = list[Number]()
    for name, lag in terms:
        term, index, sign = known.get(name, ("", 0, 1.0))
        found += acting if name == LAST_ACTION else [Number(name, term, index, sign, lag)]
    return found


def _find_terms(task: Task, names: list[str]) -> dict[str, tuple[str, int, float]]:
    """Returns term, index and sign of readings, commands and clock, where there are any."""
    signals, joints = task.signals, task.controls.names
    found = {f"clock/{each}": ("gait_phase", i, 1.0) for i, each in enumerate(("sin", "cos"))}
    for command in signals.commands:
        if command.source in VELOCITY_COMMANDS:
            place = VELOCITY_COMMANDS.index(command.source)
            found[f"command/{command.name}"] = ("velocity_commands", place, 1.0)
    space, simulations = task.observation.space, task.dynamics.simulations
    waves = np.outer(1 + np.arange(_STATES), 1 + np.arange(space.tangent_dim))
    states = space.add(np.tile(task.initial_state, (_STATES, 1)), 0.3 * np.sin(waves))
    values, candidates = Readings(simulations, names)(states), dict[tuple[str, int], Array]()
    coordinates = state_names(simulations.model)
    for term, kind in (("joint_pos", "position"), ("joint_vel", "velocity")):
        for i, joint in enumerate(joints):
            if (coordinate := f"{joint}/{kind}") in coordinates:
                candidates[term, i] = states[:, coordinates.index(coordinate)]
    if (simulations.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any():
        said = {"joint_names": with_commas(joints), "observation_names": with_commas(_BASE)}
        contract = Contract(said, "The robot")
        robot = task.deployment
        read = observation_of(contract, robot.layout, robot.read, signals, "The robot")(states)
        frames = contract.remembered(read, None).frames[:, -1]
        candidates |= {(_BASE[i // 3], i % 3): frames[:, i] for i in range(frames.shape[1])}
    for name, value in zip(names, values.T, strict=True):
        for (term, i), candidate in candidates.items():
            for sign in (1.0, -1.0):
                if np.allclose(value, sign * candidate, rtol=0.0, atol=_SAME):
                    found.setdefault(name, (term, i, sign))
    return found


def servo_policy_numbers(
    task: Task, exported: ExportedPolicy, taker: str, terms: tuple[str, ...]
) -> list[Number]:
    """Returns what a policy of servos reads, all of which is of terms of `UNITREE_NAMES`.

    Raises:
        InvalidInputError: a control is no servo's target, or a number is of no such term; the
            sentence says what takes the policy, and which terms that has by its own names.
    """
    for name, kind in zip(task.controls.names, task.controls.kinds, strict=True):
        if kind is not ControlKind.POSITION:
            raise InvalidInputError(
                f"The control of {name} is a {kind}, but {taker} has targets of positions alone; "
                "use a robot of servos, or a LEAPP bundle."
            )
    numbers = find_numbers(task, exported.policy.observed)
    for number in numbers:
        if number.term not in UNITREE_NAMES:
            raise InvalidInputError(
                f"The policy reads {quote(number.name)}, which is none of {taker}'s terms "
                f"{', '.join(terms)}; observe these alone, or use a LEAPP bundle."
            )
    return numbers


class TermNetwork(Builder):
    """Collects the nodes of a network in float32 that reads terms, and computes in float64."""

    def __init__(self) -> None:
        super().__init__("float32")

    def to_double(self, value: str) -> str:
        """Adds the cast of a value to float64."""
        return self.node("Cast", value, to=self.element(np.dtype(np.float64)))

    def pick(self, read: str, places: list[int], offsets: list[float], factors: list[float]) -> str:
        """Adds what picks a policy's inputs out of a vector, adds offsets and multiplies."""
        picked = self.node("Gather", read, self.indices(places), axis=1)
        moved = self.node("Add", picked, self.constant("offsets", offsets))
        return self.node("Mul", moved, self.constant("factors", factors))

    def clock(self, phase: str, turn: float) -> str:
        """Adds sine and cosine of a phase [turns], and the phase of the next step."""
        following = self.node("Add", phase, self.constant("turn", turn))
        whole = self.node("Floor", following)
        self.node("Sub", following, whole, output="gait_phase_out")
        angle = self.node("Mul", phase, self.constant("two_pi", 2.0 * np.pi))
        return self.node("Concat", self.node("Sin", angle), self.node("Cos", angle), axis=1)

    def stop_clock(
        self, picked: str, numbers: list[Number], task: Task, values: Mapping[str, str]
    ) -> str:
        """Adds what stops the clock among a policy's inputs, as `robot.unrest` has it.

        Values are of base_ang_vel, projected_gravity, and awake: the steps for which it still goes.
        """
        unrest, rest = task.unrest, dict(zip(task.signals.names, task.signals.rest, strict=False))
        assert unrest
        axis, rate = self.indices([1]), values["base_ang_vel"]

        def summed(value: str) -> str:
            return self.node("ReduceSum", value, axis)

        up = self.node("Neg", values["projected_gravity"])
        upright = summed(self.node("Mul", up, self.constant("upright", unrest.up[None])))
        level = self.node("Sub", rate, self.node("Mul", summed(self.node("Mul", rate, up)), up))
        speed = summed(self.node("Mul", level, level))
        tilted = self.node("Less", upright, self.constant("cosine_of_tilt", np.cos(TILT)))
        fast = self.node("Greater", speed, self.constant("squared_rate", RATE**2))
        steps = self.constant("steps", float(unrest.steps))
        left = self.node("Where", self.node("Or", tilted, fast), steps, values["awake"])
        zero = self.constant("zero", 0.0)
        following = self.node("Sub", left, self.constant("one_step", 1.0))
        self.give(self.node("Max", following, zero), "awake_out")
        commanded = [i for i, number in enumerate(numbers) if number.name in rest]
        at_rest = np.array([[rest[numbers[i].name] for i in commanded]], dtype=np.float32)
        commands = self.node("Gather", picked, self.indices(commanded), axis=1)
        moved = self.node("Sub", commands, self.constant("at_rest", at_rest))
        moves = self.node("Greater", summed(self.node("Abs", moved)), zero)
        turns = self.node("Or", moves, self.node("Greater", left, zero))
        others = [float(number.term != "gait_phase") for number in numbers]
        stays = self.node("Greater", self.constant("no_clock", [others]), zero)
        return self.node("Where", self.node("Or", turns, stays), picked, zero)


def write_file(path: Path, content: bytes | dict[str, Any]) -> None:
    """Writes a file in one piece, a record as YAML, and makes its folder."""
    if isinstance(content, dict):
        text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
        content = str(text).encode()
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write(content)
