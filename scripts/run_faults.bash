#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Injects faults into a graph at work; arguments go to `python -m tests.faults`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
# shellcheck source=env.bash
source env.bash
exec python -m tests.faults "$@"
