#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Measures which lines and branches the tests reach, in processes that they start too, and fails below the
# limits of QUALITY_DECLARATION.md. Without arguments: all tests, all limits. With names of packages, such as
# safety: the tests of these folders alone, and the limit of each.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$root"
# shellcheck source=env.bash
source env.bash

each=95 whole=85
export COVERAGE_RCFILE=$root/pyproject.toml
rm -rf log/coverage
mkdir -p log/coverage
folders=("${@/#/tests/}")
status=0
python -m coverage run -m pytest -q --timeout 1200 "${folders[@]:-tests}" || status=$?
python -m coverage combine -q

report() { python -m coverage report --skip-covered --show-missing --fail-under="$@"; }
if [[ $# -eq 0 ]]; then
  report "$whole" || status=$?
  set -- core search safety storage policies bags
fi
for package in "$@"; do
  report "$each" --include="vgps_ros/$package/*" || status=$?
done
exit "$status"
