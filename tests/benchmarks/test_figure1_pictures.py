# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Figure 1 as a picture and as a recording."""

import subprocess

import numpy as np
import pytest

from benchmarks.figure1.curves import CURVES
from benchmarks.figure1.pictures import (
    ComparisonPanel,
    Curve,
    comparison,
    profiles,
    record_comparison,
    styles,
)
from benchmarks.figure1.statistics import CEILING, Band
from vgps_ros.core.errors import InvalidInputError


def level(*middle):
    values = np.array(middle)
    return Band(values, 0.9 * values, np.minimum(1.1 * values, CEILING))


@pytest.fixture
def panels():
    falling = Curve(level(*4 * [CEILING]), level(*4 * [CEILING]))
    learning = Curve(level(8.0, 5.0, 4.0, 3.0), level(5.0, 2.0, 1.2, 1.1))
    return [
        ComparisonPanel("walker, 5 hidden units", {"vgps": learning, "dagger": falling}),
        ComparisonPanel("swimmer, 5 hidden units", {"vgps": learning}),
    ]


def test_a_row_for_each_kind_of_policy_and_what_falls_stands_at_the_ceiling(panels):
    without, _, noisy, _ = comparison(panels, []).subfigs[0].axes
    for axes, expected in ((without, [5.0, 2.0, 1.2, 1.1]), (noisy, [8.0, 5.0, 4.0, 3.0])):
        learning, falling = axes.get_lines()[:2]
        np.testing.assert_allclose(learning.get_ydata(), expected)
        np.testing.assert_allclose(falling.get_ydata(), CEILING)
        low, high = axes.get_ylim()
        assert low < 1.0 < CEILING < high
    assert "without noise" in without.get_ylabel()
    assert "with noise" in noisy.get_ylabel()


def test_a_method_has_one_style_in_all_panels_and_the_legend(panels):
    figure = comparison(panels, [])
    first, second = (axes.get_lines()[0] for axes in figure.subfigs[0].axes[:2])
    assert first.get_color() == second.get_color()
    assert first.get_marker() == second.get_marker()
    (legend,) = figure.subfigs[0].legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["vgps", "dagger", "initial DDP solution"]
    for axes, panel in zip(figure.subfigs[0].axes, panels, strict=False):
        assert axes.get_title() == panel.title


def test_no_two_of_the_nine_curves_look_alike_in_grey():
    found = styles(CURVES)
    assert len({(each["linestyle"], each["marker"]) for each in found.values()}) == len(CURVES) == 9


def test_profiles_have_a_line_for_each_method(panels):
    levels = np.array([1.0, 2.0, 4.0])
    shares = {"vgps": level(0.0, 0.5, 0.9), "gps": level(0.1, 0.2, 0.3)}
    figure = profiles(levels, {"deterministic": shares, "stochastic": shares})
    for axes in figure.axes:
        np.testing.assert_allclose(axes.get_lines()[1].get_ydata(), [0.1, 0.2, 0.3])


def test_the_recording_is_whole_and_never_overwritten(panels, tmp_path):
    path = tmp_path / "figure1.rrd"
    record_comparison(panels, [], path)
    subprocess.run(["rerun", "rrd", "verify", path], check=True, capture_output=True)
    before = path.read_bytes()
    with pytest.raises(InvalidInputError, match="exists already"):
        record_comparison(panels, [], path)
    assert path.read_bytes() == before
