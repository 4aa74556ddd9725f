#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Learns a policy in a graph of separate ROS 2 processes, then executes it.
# TASK, METHOD, HIDDEN, SEED and ITERATIONS choose what is learned; OUTPUT where the results go.
# TASK is a name, a task file or its folder. HIDDEN and ITERATIONS that are left out are the task's own.
# PARAMETERS may name a second parameter file, whose values come before those of config/TASK.yaml.
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
[[ -z ${PARAMETERS:-} ]] || parameters+=(--params-file "$PARAMETERS")
# The command of a training in process knows all the rules, and says what is wrong.
vgps train --check --task "$task" --method "$method" "${search[@]}" --output "$output" \
  ${PARAMETERS:+--params-file "$PARAMETERS"}
if [[ -e $output ]]; then
  printf "demo: OUTPUT '%s' exists already; name a folder that does not.\n" "$output" >&2
  exit 1
fi
mkdir -p "$output/log"
# A domain of its own keeps the demo apart from any graph that already runs on this machine.
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((101 + RANDOM % 132))}

declare -A pids=()
start() {  # start NODE [ROS arguments]: runs a node, its output goes to a log
  local node=$1
  shift
  vgps node "$node" --ros-args "${parameters[@]}" "$@" \
    >"$output/log/$node.log" 2>&1 &
  pids[$node]=$!
}
stop() {  # stop NODE...: interrupts nodes by their process ids and waits for their clean end
  local node
  for node in "$@"; do
    if [[ -n ${pids[$node]:-} ]]; then kill -INT "${pids[$node]}" 2>/dev/null || true; fi
  done
  for node in "$@"; do
    [[ -n ${pids[$node]:-} ]] || continue
    wait "${pids[$node]}" || { printf 'demo: %s ended with code %s:\n' "$node" $? >&2
                               tail -n 5 "$output/log/$node.log" >&2; failed=1; }
    unset "pids[$node]"
  done
}
failed=0
trap 'stop policy_learner policy_executor trajectory_optimizer simulation recorder visualizer' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

# The recorder and the visualizer first, so that they miss nothing.
start recorder -p output:="$output/bag"
start visualizer -p output:="$output/run.rrd"
start simulation -p task:="$task"
start trajectory_optimizer -p task:="$task"
start policy_executor -p task:="$task"
start policy_learner -p task:="$task" -p method:="$method" -p checkpoint_folder:="$output/checkpoints"

printf 'Learning: task %s, method %s, seed %s; logs in %s.\n' "$task" "$method" "$seed" "$output/log"
vgps train-through-graph "${search[@]}" --output "$output"
printf 'Executing: the learned policy drives the simulation in lock-step.\n'
vgps execute-policy --task "$task" --json "$output/execution.json" \
  --result "$output/result.json"

stop policy_learner policy_executor trajectory_optimizer simulation recorder visualizer
printf '\nBag:            %s\n' "$output/bag"
printf 'Recording:      %s\n' "$output/run.rrd"
printf 'Learning curve: %s\n' "$output/learning_curve.png"
printf 'More pictures:  vgps plot %s\n' "$output"
exit "$failed"
