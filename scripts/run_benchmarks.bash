#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Runs the benchmarks that are named, or all of them; OUTPUT names the folder for the result.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
# shellcheck source=env.bash
source env.bash
unset PYTHONDONTWRITEBYTECODE # else each start compiles the libraries' source again

# install PYTHON NAME SIZE: installs what requirements/NAME.txt lists.
install() {
  printf 'bench: installing the peers (requirements/%s.txt, about %s) ...\n' "$2" "$3"
  mkdir -p log/setup
  "$1" -m pip install --progress-bar off --no-input -r "requirements/$2.txt" >"log/setup/$2.log" 2>&1 ||
    { tail -n 30 "log/setup/$2.log" >&2; exit 1; }
}

if ! python -c 'import crocoddyl, stable_baselines3' 2>/dev/null; then
  install python peers '250 MB'
fi
# Judo needs an older MuJoCo, and has an environment of its own.
judo=.venv/judo
if ! "$judo/bin/python" -c 'import judo' 2>/dev/null; then
  python -m venv "$judo"
  install "$judo/bin/python" judo '790 MB'
fi
exec python -m benchmarks "$@" --output "${OUTPUT:-recordings/benchmarks}"
