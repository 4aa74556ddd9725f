# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Courses, and the paths that they ask for."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks.course import asked_path, course_of, figure_of_eight


def path_of(course, time_step=0.01):
    """The path from (1, 2) on, at first along y."""
    times = time_step * np.arange(round(course.duration / time_step))
    velocities = np.array([course.at(time)[[0, 1, 5]] for time in times])
    return asked_path(velocities, time_step, (1.0, 2.0, 0.5 * np.pi))


def test_a_figure_of_eight_is_a_circle_on_each_side_and_ends_where_it_began():
    path = path_of(figure_of_eight(speed=0.6, turn=0.5))
    assert_allclose(path[-1], path[0], atol=0.02)
    assert_allclose(path[:, :2].min(axis=0), [1.0 - 2.4, 2.0 - 1.2], atol=0.02)
    assert_allclose(path[:, :2].max(axis=0), [1.0 + 2.4, 2.0 + 1.2], atol=0.02)
    assert path[400, 0] < 1.0  # left first, which is where x is smaller
    assert_allclose(path[:100], np.tile(path[0], (100, 1)))


def test_a_file_has_legs_and_what_they_leave_out_is_zero(tmp_path):
    file = tmp_path / "course.yaml"
    file.write_text(
        "- {duration: 2, linear: {x: 0.5}}\n- {duration: 0.5}\n"
        "- {duration: 1.5, linear: {y: -1.0}, angular: {z: 0.25}}\n"
    )
    course = course_of(str(file))
    assert course.duration == 4.0
    assert_allclose(course.at(0.0), [0.5, 0, 0, 0, 0, 0])
    assert_allclose(course.at(2.0), np.zeros(6))
    assert_allclose(course.at(3.9), [0, -1.0, 0, 0, 0, 0.25])
    assert_allclose(course.at(4.0), np.zeros(6))
    assert_allclose(path_of(course)[250], [1.0, 3.0, 0.5 * np.pi], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "holds no course"),
        ("duration: 2", "holds no course"),
        ("[]", "holds no course"),
        ("- {linear: {x: 1}}", "needs a duration"),
        ("- 7", "needs a duration"),
        ("- {duration: 0}", "must be finite and above 0"),
        ("- {duration: .nan}", "every value must be finite"),
        ("- {duration: 1, linear: {x: .inf}}", "every value must be finite"),
        ("- {duration: 1}\n- {duration: 1, linear: {w: 1}}", "Leg 2 of .* has 'linear/w'"),
        ("- {duration: 1, speed: 1}", "has 'speed', but a leg has a duration"),
        ("- {duration: 1, linear: 1}", "has 'linear'"),
        ("- {duration: 1, linear: {x: fast}}", "must hold numbers only"),
        ("- {duration: 90000}", "at most 86400 s"),
        ("- [", "is no YAML"),
    ],
)
def test_a_file_that_holds_no_course_is_refused_with_a_sentence(tmp_path, text, sentence):
    (tmp_path / "course.yaml").write_text(text)
    with pytest.raises(InvalidInputError, match=sentence):
        course_of(str(tmp_path / "course.yaml"))


def test_a_course_that_is_not_there_is_refused():
    with pytest.raises(InvalidInputError, match="'figure_of_nine' cannot be read"):
        course_of("figure_of_nine")
