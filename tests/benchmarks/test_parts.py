# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The variants of vgps whose parts are compared differ in what they name."""

import numpy as np

from benchmarks.parts import MEMORY, VARIANTS, WHOLE, task_of
from vgps_ros.core.settings import settings_of
from vgps_ros.search.settings import search_settings
from vgps_ros.tasks import make_task


def test_with_memory_the_quadruped_also_reads_two_former_steps_and_its_last_action(tmp_path):
    usual, own = (make_task(task_of(name, tmp_path)) for name in (WHOLE, MEMORY))
    assert usual.observation.past is None
    assert own.observation.past.history == 2
    assert len(own.observation.past.actions) == own.dynamics.control_dim
    assert search_settings(own) == search_settings(usual)
    np.testing.assert_array_equal(own.initial_state, usual.initial_state)


def test_each_word_of_a_variant_is_a_setting_that_the_task_has_otherwise(tmp_path):
    usual = {
        each.name: each.default for each in settings_of(search_settings(make_task("quadruped")))
    }
    flags = {"--" + name.replace(".", "-").replace("_", "-"): name for name in usual}
    for text in VARIANTS.values():
        words = text.split()
        for flag, value in zip(words[::2], words[1::2], strict=True):
            assert float(value) != usual[flags[flag]], flag
