#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Builds the documentation site into build/site, with a page on which one drives the quadruped; fails at
# a broken link or a missing reference.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$root"
# shellcheck source=env.bash
source env.bash

log=$root/log/setup/site.log
mkdir -p "${log%/*}"
if ! python -m pip install --progress-bar off --no-input -r requirements/docs.txt >"$log" 2>&1; then
  printf 'site: the packages of requirements/docs.txt cannot be installed; the end of %s:\n' "$log" >&2
  tail -n 30 "$log" >&2
  exit 1
fi
NO_MKDOCS_2_WARNING=1 python -m mkdocs build --strict --quiet
# Where npm's registry cannot be reached, all else of the site is still worth having.
if scripts/build_web_parts.bash; then
  vgps export vgps_ros/tasks/quadruped/policy.json --overwrite --web build/site/drive
else
  printf 'site: it has no page on which one drives, since the parts of that cannot be fetched\n' >&2
fi
printf 'site: open %s\n' "$root/build/site/index.html"
printf 'site: its search needs a server: python3 -m http.server --bind 127.0.0.1 --directory %s\n' "$root/build/site"
