# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Records as JSON values and arrays, and back again."""

import json
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pytest

from vgps_ros.core.checks import Array
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.files import from_entries, from_tree, to_tree


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True)
class Point:
    x: float
    name: str = "p"


@dataclass(frozen=True)
class Circle:
    centre: Point
    radius: float


@dataclass(frozen=True)
class Scene:
    shapes: tuple[Circle, ...]
    widest: Circle | Point | None
    colour: Colour
    heights: Array
    is_lit: bool
    count: int


SCENE = Scene(
    (Circle(Point(1.5), 2.0), Circle(Point(-0.0, "q"), 1e300)),
    Point(3.0),
    Colour.RED,
    np.array([[1.0, np.nan], [np.inf, -0.0]]),
    True,
    7,
)
POINT = {"record": "Point", "x": 1.0, "name": "p"}


def test_a_record_comes_back_from_json_bit_for_bit():
    arrays = {}
    text = json.dumps(to_tree(SCENE, arrays), allow_nan=False)
    back = from_tree(Scene, json.loads(text), arrays)
    assert (back.shapes, back.widest, back.colour) == (SCENE.shapes, SCENE.widest, SCENE.colour)
    assert np.signbit(back.shapes[1].centre.x)
    assert back.heights.tobytes() == SCENE.heights.tobytes()
    assert (back.is_lit, back.count) == (True, 7)


def test_each_array_has_a_name_of_its_own_and_equal_ones_are_not_merged():
    arrays, ones = {}, np.ones(2)
    assert to_tree((ones, 2 * ones, ones), arrays) == ["array_0", "array_1", "array_2"]
    assert [a.tolist() for a in arrays.values()] == [[1.0, 1.0], [2.0, 2.0], [1.0, 1.0]]
    assert len(from_tree(tuple[Array, ...], ["array_1"], arrays)) == 1


@pytest.mark.parametrize("value", [{"a": 1}, [1.0], np.float32(1.0), b"bytes", object()])
def test_what_could_not_be_read_back_is_not_written(value):
    with pytest.raises(TypeError, match="cannot be written to a tree of records"):
        to_tree((1.0, value), {})


def test_none_is_read_only_where_the_type_allows_it():
    assert from_tree(Point | None, None, {}) is None
    with pytest.raises(InvalidInputError, match="None stands where a dict must be"):
        from_tree(Point, None, {})


def test_a_whole_number_is_a_setting_of_a_float_but_no_float_is_a_count():
    assert from_tree(float, 3, {}) == 3
    with pytest.raises(InvalidInputError, match=r"3\.0 stands where a int must be"):
        from_tree(int, 3.0, {})
    with pytest.raises(InvalidInputError, match="True stands where a float must be"):
        from_tree(float, True, {})


@pytest.mark.parametrize(
    ("tree", "sentence"),
    [
        ({**POINT, "record": "Circle"}, "A record 'Circle' stands where a whole Point must be"),
        ({**POINT, "record": "os.system"}, "'os.system' stands where a whole Point must be"),
        ({"x": 1.0, "name": "p"}, "A record None stands"),
        ({**POINT, "y": 1.0}, "A record 'Point' stands"),
        ({"record": "Point", "x": 1.0}, "A record 'Point' stands"),
        ({**POINT, "x": "1.0"}, "'1.0' stands where a float must be"),
        ([1.0, "p"], "stands where a dict must be"),
    ],
)
def test_a_tree_of_another_shape_is_refused(tree, sentence):
    with pytest.raises(InvalidInputError, match=sentence):
        from_tree(Point, tree, {})


@pytest.mark.parametrize("array", [None, np.ones(2, np.float32), np.array(["x"])])
def test_an_array_that_is_missing_or_of_another_type_is_refused(array):
    arrays = {} if array is None else {"array_0": array}
    with pytest.raises(InvalidInputError, match="'array_0' must name an array"):
        from_tree(Array, "array_0", arrays)


def test_a_narrower_type_of_a_field_holds_and_a_missing_field_is_named():
    entries = {"centre": POINT, "radius": 2.0}
    assert from_entries(Circle, entries, {}) == Circle(Point(1.0), 2.0)
    with pytest.raises(InvalidInputError, match="stands where a str must be"):
        from_entries(Circle, entries, {}, radius=str)
    with pytest.raises(KeyError, match="radius"):
        from_entries(Circle, {"centre": POINT}, {})
