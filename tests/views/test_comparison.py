# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Figure 1 as a picture and as a recording."""

import subprocess

import numpy as np
import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.views.comparison import CEILING, ComparisonPanel, Curve, comparison
from vgps_ros.views.comparison_recording import record_comparison


@pytest.fixture
def panels():
    falling = Curve(np.full((2, 4), 1e6), np.full((2, 4), np.inf))
    learning = Curve(
        np.array([[90.0, 40.0, 30.0, 20.0], [70.0, 60.0, 50.0, 40.0]]),
        np.array([[50.0, 20.0, 12.0, 11.0]] * 2),
    )
    return [
        ComparisonPanel("walker, 5 hidden units", 10.0, {"vgps": learning, "dagger": falling}),
        ComparisonPanel("swimmer, 5 hidden units", 10.0, {"vgps": learning}),
    ]


def test_lines_are_medians_and_what_falls_stands_at_the_ceiling(panels):
    figure = comparison(panels, [])
    walker = figure.subfigs[0].axes[0]
    solid, dashed, falling, falling_dashed = walker.get_lines()[:4]
    np.testing.assert_allclose(solid.get_ydata(), [80.0, 50.0, 40.0, 30.0])
    assert (solid.get_linestyle(), dashed.get_linestyle()) == ("-", "--")
    np.testing.assert_allclose(dashed.get_ydata(), [50.0, 20.0, 12.0, 11.0])
    for line in (falling, falling_dashed):
        np.testing.assert_allclose(line.get_ydata(), CEILING * 10.0)
    low, high = walker.get_ylim()
    assert low < 10.0 < 50.0 < CEILING * 10.0 < high


def test_a_method_has_one_colour_in_all_panels_and_the_legend(panels):
    figure = comparison(panels, [])
    first, second = (axes.get_lines()[0].get_color() for axes in figure.subfigs[0].axes[:2])
    assert first == second
    (legend,) = figure.subfigs[0].legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels[:2] == ["vgps", "dagger"]
    assert "initial DDP solution" in labels
    for axes, panel in zip(figure.subfigs[0].axes, panels, strict=False):
        assert axes.get_title() == panel.title
        assert axes.get_xlabel() == "iteration"
        assert axes.get_ylabel() == "average cost"


def test_the_recording_is_whole_and_never_overwritten(panels, tmp_path):
    path = tmp_path / "figure1.rrd"
    record_comparison(panels, [], path)
    subprocess.run(["rerun", "rrd", "verify", path], check=True, capture_output=True)
    before = path.read_bytes()
    with pytest.raises(InvalidInputError, match="exists already"):
        record_comparison(panels, [], path)
    assert path.read_bytes() == before
