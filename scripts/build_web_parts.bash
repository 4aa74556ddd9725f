#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Fetches what the page of `vgps export --web` is made of, as package-lock.json pins it, and writes each
# part into vgps_ros/views/web/parts, compressed and as base64. Does nothing where the parts stand.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
web=$root/vgps_ros/views/web
stamp=$(cat "$web/package-lock.json" "${BASH_SOURCE[0]}" "$root/LICENSE" | sha256sum)
if [[ -f $web/parts/stamp && $(<"$web/parts/stamp") == "$stamp" ]]; then exit; fi

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
log=$root/log/setup/web.log
mkdir -p "${log%/*}" "$scratch/parts"
: >"$log"
fail() {
  printf 'web: %s; the end of %s:\n' "$1" "$log" >&2
  tail -n 20 "$log" >&2
  exit 1
}

if ! npm --version >/dev/null 2>&1; then
  printf 'web: there is no npm; taking that of requirements/web.txt\n'
  python3 -m pip install --quiet --no-input --target "$scratch/node" \
    -r "$root/requirements/web.txt" >>"$log" 2>&1 ||
    fail 'the packages of requirements/web.txt cannot be installed'
  npm() { PYTHONPATH=$scratch/node PATH=$scratch/node/bin:$PATH "$scratch/node/bin/npm" "$@"; }
fi
printf 'web: fetching MuJoCo, ONNX Runtime and three.js for browsers (40 MB)\n'
cp "$web/package.json" "$web/package-lock.json" "$scratch"
(cd "$scratch" && npm ci --ignore-scripts --no-audit --no-fund --loglevel=error) >>"$log" 2>&1 ||
  fail 'the packages of package-lock.json cannot be fetched'

modules=$scratch/node_modules
{
  printf 'This page holds MuJoCo, ONNX Runtime Web and three.js, as their authors publish them.\n\n'
  printf 'ONNX Runtime Web: The MIT License, Copyright (c) Microsoft Corporation\n'
  printf 'three.js: '
  cat "$modules/three/LICENSE"
  printf '\nMuJoCo (DeepMind Technologies Limited) and vgps_ros (its maintainers):\n'
  cat "$root/LICENSE"
} >"$scratch/licences.txt"
for file in \
  "$modules"/@mujoco/mujoco/mujoco.{js,wasm} \
  "$modules"/onnxruntime-web/dist/ort.wasm.bundle.min.mjs \
  "$modules"/onnxruntime-web/dist/ort-wasm-simd-threaded.wasm \
  "$modules"/three/build/three.{core,module}.js \
  "$modules"/three/examples/jsm/controls/OrbitControls.js \
  "$scratch/licences.txt"; do
  gzip -9 --no-name <"$file" | base64 --wrap=0 >"$scratch/parts/${file##*/}"
done
printf '%s\n' "$stamp" >"$scratch/parts/stamp"
rm -rf "$web/parts"
mv "$scratch/parts" "$web/parts"
printf 'web: wrote %s (%s)\n' "${web#"$root"/}/parts" "$(du -sh "$web/parts" | cut -f1)"
