#!/usr/bin/env bash
# Injects faults into a graph at work; arguments go to `python -m tests.faults`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
# shellcheck source=env.bash
source env.bash
exec python -m tests.faults "$@"
