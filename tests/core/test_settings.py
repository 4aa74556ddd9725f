# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings know their range, their help and their names."""

from typing import Literal

import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import (
    Range,
    Setting,
    check_settings,
    settings_of,
    with_values,
    wrong_value,
)
from vgps_ros.search.settings import SearchSettings


def test_nested_settings_are_found_by_dotted_name_and_replaced():
    names = {s.name for s in settings_of(SearchSettings())}
    assert {"iterations", "hidden_units", "fit.optimizer", "fit.retries"} <= names
    changed = with_values(SearchSettings(), {"fit.optimizer": "lbfgs", "iterations": 7})
    assert (changed.fit.optimizer, changed.iterations) == ("lbfgs", 7)
    assert changed.alphas == SearchSettings().alphas


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("iterations", 0, "iterations is 0, but it must be from 1 to 100000"),
        ("iterations", 2.5, "iterations is 2.5, but it must be a whole number from 1 to 100000."),
        ("iterations", True, "iterations is true, but it must be a whole number"),
        ("gps.redraw", 1, "gps.redraw is 1, but it must be true or false."),
        ("hidden_units", (), "hidden_units is empty, but it must have at least one value"),
        ("hidden_units", (5, 0), "hidden_units is 0"),
        ("hidden_units", (2.5,), "hidden_units is 2.5"),
        ("hidden_units", ("five",), "hidden_units is 'five', but it must be a whole number from 1"),
        ("alphas", (1.0, float("nan")), "alphas is nan"),
        ("alphas", (float("inf"), 1.0), "alphas is inf"),
        (
            "fit.optimizer",
            "sgd",
            "fit.optimizer is 'sgd', but it must be one of gauss_newton, lbfgs",
        ),
        ("fit.size", 3, "setting is 'fit.size', but it must be one of alpha_iterations"),
    ],
)
def test_wrong_values_are_refused_with_a_sentence(name, value, sentence):
    with pytest.raises(InvalidInputError) as error:
        with_values(SearchSettings(), {name: value})
    assert sentence in str(error.value)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        (Range(), ""),
        (Range(0.5), "at least 0.5"),
        (Range(high=2.0), "at most 2"),
        (Range(0.0, 2.0), "from 0 to 2"),
    ],
)
def test_a_range_is_told_in_words(limits, words):
    assert Setting("name", 1.0, limits, "what it does").range() == words


def test_choices_are_told_in_words():
    assert Setting("name", "a", "what", kind=Literal["a", "b"]).range() == "one of a, b"


FLOAT = {"type": "number", "minimum": 0.0, "maximum": 0.5}
LENGTH = {"type": "array", "minItems": 3, "maxItems": 3}


@pytest.mark.parametrize(
    ("value", "schemas", "wanted"),
    [
        (-1.0, [FLOAT, LENGTH], "it is -1.0, but it must be from 0 to 0.5."),
        ([1, 2], [FLOAT, LENGTH], "it is a list of 2, but it must be a list of length 3."),
        ("x", [FLOAT, LENGTH], "it is 'x', but it must be a number or a list."),
        ({}, [FLOAT, {"type": "null"}], "it is a mapping, but it must be a number from 0 to 0.5."),
        ("", [{"type": "string", "minLength": 1}], "it is '', but it must be a text of length at"),
        (0, [{"type": "number", "exclusiveMinimum": 0, "maximum": 9}], "above 0 and at most 9."),
        (2, [{"enum": [1, 3]}, {"type": "null"}], "it is 2, but it must be one of 1, 3."),
        ("stil", [{"enum": ["go", "still"]}], "be one of go, still. Did you mean 'still'?"),
    ],
)
def test_a_value_that_fits_no_schema_is_told_what_would_fit(value, schemas, wanted):
    assert wanted in wrong_value("it", value, schemas)


def test_a_record_built_with_a_wrong_value_is_refused():
    with pytest.raises(InvalidInputError, match="ddp_iterations is -3"):
        check_settings(SearchSettings(ddp_iterations=-3))


def test_every_setting_says_what_it_does():
    for s in settings_of(SearchSettings()):
        assert len(s.description) > 5
        s.check(s.default)
