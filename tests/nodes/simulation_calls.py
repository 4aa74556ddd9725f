# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Calls of the ROS standard simulation_interfaces and their answers: the table of the page."""

import math
from typing import Any, NamedTuple

from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3
from simulation_interfaces import srv
from simulation_interfaces.msg import (
    Bounds,
    EntityCategory,
    EntityFilters,
    EntityState,
    Result,
    SimulationState,
    TagsFilter,
)
from std_msgs.msg import Header

STATES = {"stopped": 0, "playing": 1, "paused": 2, "quitting": 3}
OK, NOT_FOUND = Result.RESULT_OK, Result.RESULT_NOT_FOUND
UNSUPPORTED, FAILED = Result.RESULT_FEATURE_UNSUPPORTED, Result.RESULT_OPERATION_FAILED
INVALID_POSE = srv.SetEntityState.Response.INVALID_POSE
SET = srv.SetSimulationState.Response
ALREADY = SET.ALREADY_IN_TARGET_STATE
WORDS = {
    OK: "RESULT_OK",
    NOT_FOUND: "RESULT_NOT_FOUND",
    UNSUPPORTED: "RESULT_FEATURE_UNSUPPORTED",
    FAILED: "RESULT_OPERATION_FAILED",
    ALREADY: "ALREADY_IN_TARGET_STATE",
    SET.STATE_TRANSITION_ERROR: "STATE_TRANSITION_ERROR",
    SET.INCORRECT_TRANSITION: "INCORRECT_TRANSITION",
}
LISTS = ("get_entities", "get_entities_states")
ROBOT, HUMAN = EntityCategory.CATEGORY_ROBOT, EntityCategory.CATEGORY_HUMAN


def at(**fields: Any) -> dict[str, Any]:
    """A state for the quadruped, which is good where no field says otherwise."""
    pose = Pose(position=fields.pop("position", Point(x=1.0, y=2.0, z=0.5)))
    pose.orientation = fields.pop("orientation", Quaternion(z=math.sqrt(0.5), w=math.sqrt(0.5)))
    return {"entity": "quadruped", "state": EntityState(pose=pose, **fields)}


class Row(NamedTuple):
    """A row of the page's table: a call in a state, in words and as a request, and its answer."""

    service: str
    when: str
    call: str
    code: int
    request: dict[str, Any]
    sentence: str = ""

    @property
    def robot(self) -> str:
        return "quadruped" if "quadruped" in self.call else "swimmer"

    @property
    def answer(self) -> str:
        if self.code == INVALID_POSE and self.service == "set_entity_state":
            return "INVALID_POSE"  # whose number is that of ALREADY_IN_TARGET_STATE
        found = (
            f": {self.sentence or 'nobody'}" if self.service in LISTS and self.code == OK else ""
        )
        return WORDS[self.code] + found


def to(state: int) -> dict[str, Any]:
    return {"state": SimulationState(state=state)}


def filtered(**filters: Any) -> dict[str, Any]:
    return {"filters": EntityFilters(**filters)}


ROWS = [
    Row("reset_simulation", "paused", "scope 0 (default)", OK, {"scope": 0}),
    Row("reset_simulation", "playing", "scope 255 (all)", OK, {"scope": 255}),
    Row("reset_simulation", "stopped", "scope 1 (time)", OK, {"scope": 1}),
    Row("reset_simulation", "paused", "scope 2 (state)", OK, {"scope": 2}),
    Row("reset_simulation", "paused", "scope 3 (time and state)", OK, {"scope": 3}),
    Row("reset_simulation", "paused", "scope 4 (spawned)", UNSUPPORTED, {"scope": 4}, "The scope"),
    Row("reset_simulation", "paused", "scope 8", UNSUPPORTED, {"scope": 8}, "The scope is 8"),
    Row("step_simulation", "playing", "1 step, the default", FAILED, {}, "is playing; it must be"),
    Row("step_simulation", "stopped", "1 step", FAILED, {"steps": 1}, "is stopped; it must be"),
    Row("step_simulation", "paused", "0 steps", FAILED, {"steps": 0}, "steps is 0"),
    Row("set_simulation_state", "stopped", "playing", OK, to(1)),
    Row("set_simulation_state", "stopped", "paused", SET.INCORRECT_TRANSITION, to(2), "play it"),
    Row("set_simulation_state", "stopped", "stopped", ALREADY, to(0), "already"),
    Row("set_simulation_state", "playing", "paused", OK, to(2)),
    Row("set_simulation_state", "playing", "stopped", OK, to(0)),
    Row("set_simulation_state", "playing", "playing", ALREADY, to(1), "already"),
    Row("set_simulation_state", "paused", "playing", OK, to(1)),
    Row("set_simulation_state", "paused", "stopped", OK, to(0)),
    Row("set_simulation_state", "paused", "paused", ALREADY, to(2), "already"),
    Row("set_simulation_state", "paused", "no world", UNSUPPORTED, to(4), "must be one of"),
    Row("get_entities", "paused", "no filter", OK, {}, "swimmer"),
    Row("get_entities", "paused", "name `^sw[[:alpha:]]+$`", OK,
        filtered(filter="^sw[[:alpha:]]+$"), "swimmer"),
    Row("get_entities", "paused", "name `walker`", OK, filtered(filter="walker")),
    Row("get_entities", "paused", "name `(`", FAILED, filtered(filter="("), "no regular expr"),
    Row("get_entities", "paused", "category human or robot", OK,
        filtered(categories=[EntityCategory(category=c) for c in (HUMAN, ROBOT)]), "swimmer"),
    Row("get_entities", "paused", "category human", OK,
        filtered(categories=[EntityCategory(category=HUMAN)])),
    Row("get_entities", "paused", "bounds", UNSUPPORTED,
        filtered(bounds=Bounds(type=Bounds.TYPE_SPHERE)), "not filtered by bounds"),
    Row("get_entities", "paused", "tags", UNSUPPORTED,
        filtered(tags=TagsFilter(tags=["a"])), "not filtered by tags"),
    Row("get_entities_states", "playing", "no filter", OK, {}, "swimmer"),
    Row("get_entities_states", "playing", "name `walker`", OK, filtered(filter="walker")),
    Row("get_entity_info", "stopped", "the robot", OK, {"entity": "swimmer"}),
    Row("get_entity_info", "stopped", "another name", NOT_FOUND, {"entity": "fly"}, "entity 'fly'"),
    Row("get_entity_state", "playing", "the robot", OK, {"entity": "swimmer"}),
    Row("get_entity_state", "playing", "another name", NOT_FOUND, {"entity": ""}, "no entity ''"),
    Row("set_entity_state", "paused", "a robot without a free base", UNSUPPORTED,
        {"entity": "swimmer"}, "no free base"),
    Row("set_entity_state", "paused", "the quadruped", OK, at()),
    Row("set_entity_state", "playing", "the quadruped, in the frame `odom`", OK,
        at(header=Header(frame_id="odom"))),
    Row("set_entity_state", "paused", "the quadruped, in another frame", FAILED,
        at(header=Header(frame_id="map")), "header.frame_id is 'map'"),
    Row("set_entity_state", "paused", "the quadruped, no rotation", INVALID_POSE,
        at(orientation=Quaternion(w=0.0)), "has the length 0"),
    Row("set_entity_state", "paused", "the quadruped, 100 km away", INVALID_POSE,
        at(position=Point(x=1e5)), "beyond the world"),
    Row("set_entity_state", "paused", "the quadruped, velocity NaN", FAILED,
        at(twist=Twist(linear=Vector3(x=math.nan))), "velocity is nan"),
    Row("set_entity_state", "paused", "not the quadruped", NOT_FOUND, {"entity": "fly"}, "fly"),
]  # fmt: skip
