#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Pins all that `make setup` installs, the indirect packages too, with hashes; writes a bill of materials of
# what is installed here; and, with --audit, asks for known vulnerabilities. requirements/README.md says more.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

locked=requirements/locked/setup.txt tools=.venv/lock
if [[ ! -x $tools/bin/uv ]]; then python3 -m venv "$tools"; fi
"$tools/bin/pip" install --quiet --progress-bar off -r requirements/lock.txt
if [[ ${1:-} == --audit ]]; then
  exec "$tools/bin/pip-audit" --require-hashes --disable-pip -r "$locked"
fi

mkdir -p "$(dirname "$locked")" build
"$tools/bin/uv" pip compile --quiet --universal --generate-hashes --python-version 3.10 --no-header --no-annotate \
  requirements/{runtime,dev,build_tools,ros_wheels}.txt -o "$locked"
"$tools/bin/cyclonedx-py" environment .venv --output-reproducible -o build/sbom.json
printf 'lock: %d packages in %s; bill of materials in build/sbom.json\n' "$(grep -c '==' "$locked")" "$locked"
