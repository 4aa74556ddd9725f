#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Runs the tests, and fails if they left a process, a piece of shared memory or a temporary file. It looks
# only at what the tests themselves made, so other ROS programs may run beside them. Arguments, such as
# the path of a test, are handed to pytest.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$root"
# shellcheck source=env.bash
source env.bash

marker=VGPS_TEST_RUN=$$.$(date +%s%N)

# Each process keeps the environment with which it was started, so the marker finds all descendants,
# including those that left their process group.
processes() { grep -lsz "^$marker\$" /proc/[0-9]*/environ | grep -o '[0-9]\+' || true; }

# Prints the shared memory that processes of this run have mapped.
mapped_memory() {
  local pid
  for pid in $(processes); do grep -oh '/dev/shm/[^ ]*' "/proc/$pid/maps" 2>/dev/null || true; done
}
is_mapped() { grep -qsF "$1" /proc/[0-9]*/maps; }

scratch=$root/log/tests
rm -rf "$scratch"
mkdir -p "$scratch"/{home,ros,tmp}
: >"$scratch/again"
find /dev/shm -mindepth 1 | sort >"$scratch/before"

# The segments that the tests make have random names, so they are noted while their processes live.
while sleep 0.5; do mapped_memory; done >"$scratch/shared_memory" &
watch=$!
trap 'kill "$watch" 2>/dev/null || true' EXIT

run_pytest() {
  env "$marker" HOME="$scratch/home" TMPDIR="$scratch/tmp" ROS_HOME="$scratch/ros" ROS_LOG_DIR="$scratch/ros/log" \
    XDG_CACHE_HOME="$scratch/home/.cache" XDG_CONFIG_HOME="$scratch/home/.config" MPLCONFIGDIR="$scratch/home/matplotlib" \
    python -m pytest "$@" -q
}

# Tests of real processes can fail because a shared machine stands still for seconds. So a few failed
# tests are run once more, and the output shows both outcomes. More failures are not an accident.
few=3
run_group() {
  local name=$1 status=0 failed=$scratch/$1/v/cache/lastfailed
  shift
  run_pytest -o cache_dir="$scratch/$name" "$@" || status=$?
  if [[ $status -eq 1 && -f $failed && $(grep -c '": true' "$failed") -le $few ]]; then
    printf 'run_tests: these failed, and are run once more:\n' >&2
    grep -o '^ *"[^"]*' "$failed" | tr -d ' "' | tee -a "$scratch/again" >&2
    status=0
    run_pytest -o cache_dir="$scratch/$name" --last-failed "$@" || status=$?
  fi
  return "$status"
}

# The tests of these folders mostly wait. The others run beside them, with lower priority.
status=0
waiting=(tests/nodes tests/bags)
if [[ $# -gt 0 ]]; then
  run_group chosen "$@" || status=$?
else
  (
    renice -n 19 "$BASHPID" >/dev/null
    run_group computing tests "${waiting[@]/#/--ignore=}"
  ) >"$scratch/computing.log" 2>&1 &
  computing=$!
  printf 'run_tests: real processes; what computes runs beside, log in %s\n' "$scratch/computing.log"
  run_group waiting "${waiting[@]}" || status=$?
  printf 'run_tests: what computes\n'
  wait "$computing" || status=$?
  cat "$scratch/computing.log"
fi

left=$(processes)
if [[ -n $left ]]; then
  sleep 2 # a node that just got a signal may need a moment
  left=$(processes)
fi
if [[ -n $left ]]; then
  printf 'run_tests: these processes are left, and are killed now:\n' >&2
  # shellcheck disable=SC2086
  ps -o pid=,args= -p $left >&2 || true
  # shellcheck disable=SC2086
  kill -KILL $left 2>/dev/null || true
  status=1
fi

# LTTng, which the tracepoints of ROS use, keeps two segments for all processes of a user. What other
# programs left before is not the tests' own.
sort -u "$scratch/shared_memory" | sed '/lttng-ust-wait-/d' |
  comm -23 - "$scratch/before" | while read -r file; do
  if [[ -e $file ]] && ! is_mapped "$file"; then printf '%s\n' "$file"; fi
done >"$scratch/left"
# Where libraries put what they should have removed. Folders of pytest itself stay for three runs.
find "$scratch/tmp" -mindepth 1 -maxdepth 1 ! -name 'pytest-of-*' >>"$scratch/left"
if [[ -s $scratch/left ]]; then
  printf 'run_tests: the tests left these:\n' >&2
  cat "$scratch/left" >&2
  status=1
fi
if [[ -s $scratch/again ]]; then
  printf 'run_tests: %d tests failed at first, and were run once more:\n' "$(wc -l <"$scratch/again")"
  cat "$scratch/again"
fi
exit "$status"
