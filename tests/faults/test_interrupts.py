# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""One signal ends each program, however early it comes; `make interrupts` strikes more often."""

import pytest

from tests.faults.interrupts import KINDS, strike


@pytest.mark.parametrize(
    ("mode", "delay"), [("terminal", 0.05), ("background", 0.4), ("service", 0.8)]
)
@pytest.mark.parametrize("kind", KINDS)
def test_one_signal_ends_a_program_that_has_just_begun(tmp_path, domain_id, kind, mode, delay):
    assert strike(kind, mode, delay, tmp_path, domain_id).wrong == ""
