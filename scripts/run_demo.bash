#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Learns a policy in a graph of separate ROS 2 processes, then executes it; one that takes cmd_vel drives a figure of eight.
# TASK, METHOD, HIDDEN, SEED and ITERATIONS choose what is learned; OUTPUT where the results go.
# TASK is a name, a task file or its folder. HIDDEN and ITERATIONS that are left out are the task's own.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source env.bash

task=${TASK:-swimmer} method=${METHOD:-vgps} seed=${SEED:-0}
name=$(basename "${task%/task.yaml}")
output=${OUTPUT:-recordings/$name-$(date +%Y%m%d-%H%M%S)}
search=(--seed "$seed")
[[ -z ${ITERATIONS:-} ]] || search+=(--iterations "$ITERATIONS")
read -ra widths <<<"${HIDDEN:-}"
[[ -z ${HIDDEN:-} ]] || search+=(--hidden-units "${widths[@]}")
parameters=(--params-file config/any_task.yaml)
[[ ! -f config/$task.yaml ]] || parameters=(--params-file "config/$task.yaml")

# The command of a training in process knows all the rules, and says what is wrong.
vgps train --check --task "$task" --method "$method" "${search[@]}" --output "$output"
if [[ -e $output ]]; then
  printf "demo: OUTPUT '%s' exists already; name a folder that does not.\n" "$output" >&2
  exit 1
fi
mkdir -p "$output/log"
# A domain of its own keeps the demo apart from any graph that already runs on this machine.
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((101 + RANDOM % 132))}

declare -A pids=()
failed=0
start() {  # start NAME ARGUMENTS...: starts a node or a program in the background
  "install/vgps_ros/lib/vgps_ros/$1" "${@:2}" </dev/null &
  pids[$1]=$!
}
start_node() {  # start_node NODE [ROS ARGUMENTS...]: its output goes to a log
  start "$1" --ros-args "${parameters[@]}" "${@:2}" >"$output/log/$1.log" 2>&1
}
run() {  # run PROGRAM ARGUMENTS...: waits for its end, but for a signal to this script no longer
  local code=0
  start "$@"
  wait "${pids[$1]}" || code=$?
  unset "pids[$1]"
  return "$code"
}
stop_all() {  # interrupts all processes; kills those that have not ended after 30 seconds, as on a busy machine
  local name pid code
  trap '' INT TERM
  for name in "${!pids[@]}"; do kill -INT "${pids[$name]}" 2>/dev/null || true; done
  for _ in {1..150}; do
    [[ -n $(jobs -pr) ]] || break
    sleep 0.2
  done
  for pid in $(jobs -pr); do kill -KILL "$pid" 2>/dev/null || true; done
  for name in "${!pids[@]}"; do
    code=0
    wait "${pids[$name]}" || code=$?
    if ((code)); then
      printf 'demo: %s ended with code %s:\n' "$name" "$code" >&2
      tail -n 5 "$output/log/$name.log" >&2 2>/dev/null || true
      failed=1
    fi
  done
  pids=()
}
trap stop_all EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

# The recorder and the visualizer first, so that they miss nothing.
start_node recorder -p output:="$output/bag"
start_node visualizer -p output:="$output/run.rrd"
start_node simulation -p task:="$task"
start_node trajectory_optimizer -p task:="$task"
start_node policy_executor -p task:="$task"
start_node policy_learner -p task:="$task" -p method:="$method" -p checkpoint_folder:="$output/checkpoints"

printf 'Learning: task %s, method %s, seed %s; logs in %s.\n' "$task" "$method" "$seed" "$output/log"
patience=(--timeout 120) # on a busy machine six processes begin slowly
run train_through_graph "${search[@]}" --output "$output" "${patience[@]}"
printf 'Executing: the learned policy drives the simulation in lock-step.\n'
run execute_policy --task "$task" --json "$output/execution.json" \
  --course figure_of_eight --picture "$output/driven.png" \
  --result "$output/result.json" "${patience[@]}"

stop_all
show() {  # show WHAT PATH: names a result that is there
  [[ ! -e $2 ]] || printf '%-15s %s\n' "$1:" "$2"
}
printf '\n'
show Bag "$output/bag"
show Recording "$output/run.rrd"
show 'Learning curve' "$output/learning_curve.png"
show 'Path driven' "$output/driven.png"
printf 'More pictures:  vgps plot %s\n' "$output"
exit "$failed"
