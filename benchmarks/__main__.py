# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs the benchmarks: `python -m benchmarks [NAME ...]`; `make bench` installs the peers first."""

from benchmarks.suite import main

if __name__ == "__main__":
    main()
