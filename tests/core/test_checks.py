# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A refusal is a sentence that names the value and what would be right."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from vgps_ros.core.checks import (
    arrays_of,
    check_covariances,
    check_record,
    find_name,
    finite_array,
    first_steps,
    from_arrays,
    list_names,
    matching_names,
    nearest,
    one_of,
    positive,
    quote,
)
from vgps_ros.core.errors import InvalidInputError, VgpsError
from vgps_ros.core.records import TrajectoryDistribution


def test_flat_values_take_the_wanted_shape():
    """Messages carry arrays row-major and flat."""
    assert_array_equal(finite_array("gains", range(6), (2, 3)), [[0, 1, 2], [3, 4, 5]])


def test_array_is_a_copy():
    values = np.zeros(2)
    finite_array("state", values, (2,))[0] = 1.0
    assert_array_equal(values, 0.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([1.0, 2.0], r"state has 2 values, but shape \(3,\) needs 3\."),
        ([1.0, np.inf, np.nan], r"state is inf at index 1; every value must be finite\."),
    ],
)
def test_bad_array_is_named_with_its_value(values, message):
    with pytest.raises(InvalidInputError, match=message):
        finite_array("state", values, (3,))


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_number_that_is_not_positive_is_named_with_its_value(value):
    with pytest.raises(InvalidInputError, match=rf"alpha is {value}, but it must be .*above 0\."):
        positive("alpha", value)
    assert positive("alpha", 2) == 2.0


def test_unknown_name_is_refused_with_the_valid_ones():
    assert one_of("form", "b", ("b", "a")) == "b"
    with pytest.raises(InvalidInputError, match=r"form is 'c', but it must be one of a, b\."):
        one_of("form", "c", ("b", "a"))


@pytest.mark.parametrize(
    ("name", "change", "sentence"),
    [
        ("mean.controls", lambda a: a[:, :1], r"q\.mean\.controls has shape \(6, 1\), but it must"),
        ("gains", lambda a: a * np.nan, r"q\.gains is nan at index"),
        ("state_covariances", lambda a: a + np.eye(4, k=1), "is not symmetric at step 0, as a cov"),
        ("control_covariances", lambda a: a - 9 * np.eye(2), "is not positive semidefinite at ste"),
    ],
)
def test_a_record_is_checked_as_its_arrays_are_declared(
    random_distribution, name, change, sentence
):
    q = random_distribution()
    sizes = {"T": 6, "n_x": 4, "n_dx": 4, "n_u": 2, "n_z": 0}
    check_record("q", q, **sizes)
    arrays = arrays_of(q)
    bad = from_arrays(type(q), {**arrays, name: change(arrays[name])})
    with pytest.raises(InvalidInputError, match=sentence):
        check_record("q", bad, **sizes)


@pytest.mark.parametrize(
    ("small", "what"),
    [([[1.0, 0.01], [0.0, 1.0]], "symmetric"), (np.diag([1.0, -0.01]), "positive semidefinite")],
)
def test_each_covariance_is_judged_by_its_own_size(small, what):
    large = 1e6 * np.array([[1.0, 1e-6], [0.0, 1.0]])  # it differs from symmetry by rounding alone
    check_covariances("S", np.stack([large, 1e-6 * np.eye(2), np.zeros((2, 2))]))
    with pytest.raises(InvalidInputError, match=f"S is not {what} at step 1, as a covariance"):
        check_covariances("S", np.stack([large, 1e-6 * np.array(small)]))


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("hüfte", "'hüfte'"),
        ("two\nlines", r"'two\nlines'"),
        ([1.5, None], "[1.5, None]"),
        ("a" * 100, f"'{'a' * 27}...{'a' * 28}'"),
        ("\n" * 100, "'" + 13 * r"\n" + "\\..." + 14 * r"\n" + "'"),
    ],
)
def test_a_value_is_quoted_on_one_line_and_not_too_long(value, shown):
    assert quote(value) == shown


def test_the_nearest_name_alone_is_asked_for():
    assert nearest("swimer", ["swimmer", "swimmers", "walker"]) == " Did you mean 'swimmer'?"
    assert nearest("rotor", ["swimmer", "walker"]) == ""


def test_refusals_are_both_ours_and_pythons():
    assert issubclass(InvalidInputError, VgpsError)
    assert issubclass(InvalidInputError, ValueError)


def test_a_record_is_read_back_from_its_arrays(random_distribution):
    q = random_distribution()
    arrays = arrays_of(q)
    assert arrays["linear_dynamics.f_u"] is q.linear_dynamics.f_u
    again = arrays_of(from_arrays(TrajectoryDistribution, arrays))
    assert again.keys() == arrays.keys()
    assert all(np.array_equal(again[name], values) for name, values in arrays.items())


def test_the_first_steps_keep_one_state_more_than_controls(random_distribution):
    q = random_distribution(horizon=6)
    cut = q.first(2)
    assert all(
        np.array_equal(values, arrays_of(first_steps(q, 2))[name])
        for name, values in arrays_of(cut).items()
    )
    assert_array_equal(q.mean.first(3).controls, q.mean.controls[:3])
    assert_array_equal(cut.mean.states, q.mean.states[:3])
    assert_array_equal(cut.state_covariances, q.state_covariances[:3])
    assert_array_equal(cut.mean.controls, q.mean.controls[:2])
    assert_array_equal(cut.linear_dynamics.f_x, q.linear_dynamics.f_x[:2])


JOINTS = ("left_hip", "left_knee", "right_hip", "left_*")


def test_a_pattern_finds_all_that_match_in_their_order_and_a_name_itself_alone():
    assert matching_names("joint", "*_hip", JOINTS) == ["left_hip", "right_hip"]
    assert matching_names("joint", "[lr]*t_k?ee", JOINTS) == ["left_knee"]
    assert matching_names("joint", "left_*", JOINTS) == ["left_*"]
    assert matching_names("joint", "*", ()) == []


def test_what_matches_nothing_is_refused_with_the_names_and_the_nearest():
    with pytest.raises(InvalidInputError) as refusal:
        matching_names("joint", "left_nee", JOINTS)
    assert str(refusal.value) == (
        "'left_nee' matches no joint; there are left_hip, left_knee, right_hip, left_*. Did you "
        "mean 'left_knee'?"
    )
    assert find_name("joint", "left_hip", JOINTS) == "left_hip"
    with pytest.raises(InvalidInputError, match=r"there is no joint 'wheel'; there are left_hip"):
        find_name("joint", "wheel", JOINTS)


def test_many_names_are_listed_in_part_and_none_as_none():
    assert list_names([f"n{i}" for i in range(14)]).endswith(", n11 and others")
    assert list_names([f"n{i}" for i in range(12)]).endswith(", n11")
    assert list_names(()) == "none"
