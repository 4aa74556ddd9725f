#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Runs the tests, and fails if they left a process, a shared-memory segment or a file outside this
# checkout. Arguments, such as the path of a test, are handed to pytest.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$root"
# shellcheck source=env.bash
source env.bash

marker=VGPS_TEST_RUN=$$.$(date +%s%N)

# Each process keeps the environment with which it was started, so the marker finds all descendants,
# including those that left their process group.
leftover_processes() { grep -lsz "^$marker\$" /proc/[0-9]*/environ | grep -o '[0-9]\+' || true; }

# A segment that a running process maps belongs to another ROS graph on this machine.
shared_memory() { find /dev/shm -mindepth 1 -user "$(id -u)" 2>/dev/null | sort; }
in_use() { grep -qsF "$1" /proc/[0-9]*/maps; }

# Lists the files that libraries would write if they ignored the variables of run_pytest below.
outside_files() {
  find "$HOME" -mindepth 1 -maxdepth 2 \( -path "$root" -o -path '*/.local' \) -prune -o -print 2>/dev/null
  find "$HOME/.ros" "$HOME/.cache/numba" "$HOME/.cache/matplotlib" "$HOME/.config/rerun" 2>/dev/null
  find /tmp -mindepth 1 -maxdepth 1 -user "$(id -u)" \( -name 'pytest-*' -o -name 'pymp-*' -o -name 'torch*' \
    -o -name '*rerun*' -o -name '*ros*' -o -name '*vgps*' \) 2>/dev/null
}
# Files may vanish while find runs, so its errors are ignored.
snapshot() { { outside_files || true; } | sort -u; }

scratch=$root/log/tests
rm -rf "$scratch"
mkdir -p "$scratch"/{home,ros,tmp}
snapshot >"$scratch/files_before"
shared_memory >"$scratch/shared_memory_before"

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
    grep -o '^ *"[^"]*' "$failed" | tr -d ' "' >&2
    status=0
    run_pytest -o cache_dir="$scratch/$name" --last-failed "$@" || status=$?
  fi
  return "$status"
}

# The tests of these folders mostly wait. The others run beside them, with lower priority.
status=0
waiting=(tests/nodes tests/faults tests/bags)
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

left=$(leftover_processes)
if [[ -n $left ]]; then
  sleep 2 # a node that just got a signal may need a moment
  left=$(leftover_processes)
fi
if [[ -n $left ]]; then
  printf 'run_tests: these processes are left, and are killed now:\n' >&2
  # shellcheck disable=SC2086
  ps -o pid=,args= -p $left >&2 || true
  # shellcheck disable=SC2086
  kill -KILL $left 2>/dev/null || true
  status=1
fi

comm -13 "$scratch/shared_memory_before" <(shared_memory) | while read -r segment; do
  if in_use "$segment"; then continue; fi
  case $segment in
    # LTTng, which the tracepoints of ROS use, leaves these two segments for the next process.
    */lttng-ust-wait-*) rm -f "$segment" ;;
    *) printf '%s\n' "$segment" ;;
  esac
done >"$scratch/left"
comm -13 "$scratch/files_before" <(snapshot) >>"$scratch/left"
if [[ -s $scratch/left ]]; then
  printf 'run_tests: these are left outside the checkout:\n' >&2
  cat "$scratch/left" >&2
  status=1
fi
exit "$status"
