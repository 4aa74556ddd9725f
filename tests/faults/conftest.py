# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of real nodes."""

from tests.nodes.conftest import domain_id

__all__ = ["domain_id"]
