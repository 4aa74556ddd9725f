#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Runs the tests, and fails if they left a process or a temporary file. It looks only at what the tests
# themselves made, so other ROS programs may run beside them. Arguments are handed to pytest; without the
# path of a test, or another -n, all run in three workers at once: a test waits for processes half its time.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$root"
# shellcheck source=env.bash
source env.bash
unset PYTHONDONTWRITEBYTECODE # else each node that a test starts compiles the package's source again

scratch=$root/log/tests
rm -rf "$scratch"
mkdir -p "$scratch"/{home,ros,tmp}
if [[ " $* " != *" tests/"* ]]; then set -- -n 3 --dist worksteal "$@"; fi

# Each process keeps the environment with which it was started, so the marker finds all descendants,
# including those that left their process group.
marker=VGPS_TEST_RUN=$$.$(date +%s%N)
processes() { grep -lsz "^$marker\$" /proc/[0-9]*/environ | grep -o '[0-9]\+' || true; }

run() {
  env "$marker" HOME="$scratch/home" TMPDIR="$scratch/tmp" ROS_HOME="$scratch/ros" ROS_LOG_DIR="$scratch/ros/log" \
    XDG_CACHE_HOME="$scratch/home/.cache" XDG_CONFIG_HOME="$scratch/home/.config" MPLCONFIGDIR="$scratch/home/matplotlib" \
    TORCHINDUCTOR_CACHE_DIR="$scratch/home/inductor" \
    python -m pytest -q -o cache_dir="$scratch/cache" "$@"
}

# A shared machine can stand still for seconds, which a test of real processes may not survive. So a few
# failed tests are run once more, one after another, and the output shows both outcomes.
few=5 failed=$scratch/cache/v/cache/lastfailed status=0
run "$@" || status=$?
if [[ $status -eq 1 && -f $failed && $(grep -c '": true' "$failed") -le $few ]]; then
  printf 'run_tests: these failed, and are run once more:\n' >&2
  grep -o '^ *"[^"]*' "$failed" | tr -d ' "' >&2
  # shellcheck disable=SC2046
  kill -KILL $(processes) 2>/dev/null || true # what a failed test left
  status=0
  run "$@" --last-failed -n 0 || status=$?
fi

# A node that just got a signal may need a moment, and one that still imports some more.
for ((tenths = 0; tenths < 100; tenths++)); do
  left=$(processes)
  [[ -n $left ]] || break
  sleep 0.1
done
if [[ -n $left ]]; then
  printf 'run_tests: these processes are left, and are killed now:\n' >&2
  # shellcheck disable=SC2086
  ps -o pid=,args= -p $left >&2 || true
  # shellcheck disable=SC2086
  kill -KILL $left 2>/dev/null || true
  status=1
fi

# Folders of pytest itself stay for three runs.
files=$(find "$scratch/tmp" -mindepth 1 -maxdepth 1 ! -name 'pytest-of-*')
if [[ -n $files ]]; then
  printf 'run_tests: the tests left these:\n%s\n' "$files" >&2
  status=1
fi
exit "$status"
