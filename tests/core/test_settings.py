# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Settings know their range, their help and their names."""

import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Setting, check_settings, settings_of, with_values
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
        ("iterations", 2.5, "iterations is 2.5 of type float, but it must be of type int"),
        ("iterations", True, "of type bool"),
        ("gps.redraw", 1, "of type int, but it must be of type bool"),
        ("hidden_units", (), "hidden_units is empty, but it must have at least one value"),
        ("hidden_units", (5, 0), "hidden_units is 0"),
        ("hidden_units", (2.5,), "hidden_units is 2.5"),
        ("hidden_units", ("five",), "hidden_units is 'five'"),
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
        ({}, ""),
        ({"minimum": 0.5}, "at least 0.5"),
        ({"maximum": 2.0}, "at most 2"),
        ({"minimum": 0.0, "maximum": 2.0}, "from 0 to 2"),
        ({"choices": ("a", "b")}, "one of a, b"),
    ],
)
def test_a_range_is_told_in_words(limits, words):
    assert Setting("name", 1.0, "what it does", **limits).range() == words


def test_a_record_built_with_a_wrong_value_is_refused():
    with pytest.raises(InvalidInputError, match="ddp_iterations is -3"):
        check_settings(SearchSettings(ddp_iterations=-3))


def test_every_setting_says_what_it_does():
    for s in settings_of(SearchSettings()):
        assert len(s.description) > 5
        s.check(s.default)
