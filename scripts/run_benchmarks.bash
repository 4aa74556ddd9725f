#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Runs the benchmarks that are named, or all of them; OUTPUT names the folder for the result.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
# shellcheck source=env.bash
source env.bash

if ! python -c 'import crocoddyl, stable_baselines3' 2>/dev/null; then
  printf 'bench: installing the peers (requirements/peers.txt, about 250 MB) ...\n'
  mkdir -p log/setup
  python -m pip install --progress-bar off --no-input -r requirements/peers.txt >log/setup/peers.log 2>&1 ||
    { tail -n 30 log/setup/peers.log >&2; exit 1; }
fi
exec python -m benchmarks "$@" --output "${OUTPUT:-recordings/benchmarks}"
