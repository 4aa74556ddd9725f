# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""One INT ends each program, however early it comes; `make interrupts` strikes more often."""

import pytest

from tests.faults.interrupts import KINDS, MODES, strike


@pytest.mark.parametrize("delay", [0.05, 0.4])
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("kind", KINDS)
def test_one_interrupt_ends_a_program_that_has_just_begun(tmp_path, domain_id, kind, mode, delay):
    assert strike(kind, mode, delay, tmp_path, domain_id).wrong == ""
