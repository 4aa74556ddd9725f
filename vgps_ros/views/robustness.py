# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Draws how many rollouts survive disturbances of several sizes, for one policy or for several."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from vgps_ros.core.records import Array
from vgps_ros.search.robustness import ENOUGH, KINDS

_Z = 1.96  # standard deviations of an interval of 95 %
# Lines of several policies differ in shape too, so that they can be told apart in grey.
_LINES = ("-", "--", ":", "-.", (0, (6, 1, 1, 1, 1, 1)))
_MARKERS = ("o", "s", "^", "D", "v")
_COLOURS = ("#1f5fbf", "black", "tab:orange", "tab:green", "tab:red")


def survival_curves(found: Mapping[str, Mapping[str, Any]], rollouts: int) -> Figure:
    """Draws a panel for each kind of disturbance.

    Args:
        found: the result of `robustness` for each policy, by its label.
        rollouts: number of rollouts for each value, from which the bars of 95 % follow (Wilson).
    """
    kinds = [kind for kind in KINDS if any(kind in result for result in found.values())]
    figure = Figure(figsize=(1.2 + 3.6 * len(kinds), 3.4), layout="constrained")
    panels = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
    for axes, kind in zip(panels, kinds, strict=True):
        for i, (label, result) in enumerate(found.items()):
            if kind not in result:
                continue
            values, shares = (np.array(result[kind][key]) for key in ("values", "survival"))
            axes.errorbar(
                values,
                100.0 * shares,
                yerr=100.0 * _bars(shares, rollouts),
                label=label,
                color=_COLOURS[i % len(_COLOURS)],
                linestyle=_LINES[i % len(_LINES)],
                marker=_MARKERS[i % len(_MARKERS)],
                markersize=5,
                capsize=3,
                elinewidth=0.8,
            )
        axes.axhline(100.0 * ENOUGH, color="grey", linewidth=0.8)
        axes.set_xlabel(KINDS[kind])
    panels[0].set_ylim(-3, 103)
    panels[0].set_ylabel(f"survive, of {rollouts} [%]")
    handles, labels = panels[0].get_legend_handles_labels()
    if len(found) > 1:
        figure.legend(
            handles, labels, frameon=False, ncols=len(_COLOURS), loc="outside upper center"
        )
    return figure


def _bars(shares: Array, count: int) -> Array:
    """Returns how far Wilson's interval of 95 % reaches below and above each share, (2, m)."""
    scale = 1.0 + _Z**2 / count
    middle = (shares + _Z**2 / (2 * count)) / scale
    half = _Z * np.sqrt(shares * (1 - shares) / count + _Z**2 / (4 * count**2)) / scale
    bars = np.stack([shares - (middle - half), (middle + half) - shares])
    return np.maximum(bars, 0.0)
