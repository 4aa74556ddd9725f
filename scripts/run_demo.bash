#!/usr/bin/env -S --default-signal=INT,TERM --block-signal=INT,TERM bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Learns a policy in a graph of separate ROS 2 processes, then executes it.
# TASK, METHOD, HIDDEN, SEED and ITERATIONS choose what is learned; OUTPUT where the results go.
# TASK is a name, a task file or its folder. HIDDEN and ITERATIONS that are left out are the task's own.
# PARAMETERS may name a second parameter file, whose values come before those of config/TASK.yaml.
# INT and TERM end it at any time, also in the background of a script, which ignores INT.
set -euo pipefail

# INT and TERM wait while the programs of env.bash run, which would print a traceback or be left behind,
# and during which bash may lose one. Only another program can let them through: it starts this script once more.
if [[ -z ${_VGPS_DEMO_BEGUN:-} ]]; then
  cd "$(dirname "${BASH_SOURCE[0]}")/.."
  source env.bash
  _VGPS_DEMO_BEGUN=1 exec python -c 'import os, signal, sys
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))
os.execvp("bash", ["bash", *sys.argv[1:]])' scripts/run_demo.bash
fi
unset _VGPS_DEMO_BEGUN

# Each process gets its signals from this script alone: in a process group of its own it neither hears
# Ctrl-C a second time nor ignores INT, as background jobs of scripts do otherwise.
nodes=(policy_learner policy_executor trajectory_optimizer simulation recorder visualizer)
declare -A pids=()
failed=0
launch() {  # launch NAME ARGUMENTS...: starts an executable
  set -m
  "install/vgps_ros/lib/vgps_ros/$1" "${@:2}" </dev/null &
  pids[$1]=$!
  set +m
}
run() {  # run NAME ARGUMENTS...: waits for a program's end, but for a signal no longer
  local code=0
  launch "$@"
  wait "${pids[$1]}" || code=$?
  unset "pids[$1]"
  return "$code"
}
start() {  # start NODE [ROS arguments]: runs a node, its output goes to a log
  launch "$1" --ros-args "${parameters[@]}" "${@:2}" >"$output/log/$1.log" 2>&1
}
interrupt() {  # interrupt PID...: sends INT, to one that this shell has just forked once it is itself
  local pid
  for pid in "$@"; do
    while [[ /proc/$pid/exe -ef /proc/$$/exe ]]; do sleep 0.01; done
    kill -INT "$pid" 2>/dev/null || true
  done
}
stop() {  # stop NODE...: interrupts nodes and waits for their clean end
  local node
  for node in "$@"; do [[ -z ${pids[$node]:-} ]] || interrupt "${pids[$node]}"; done
  for node in "$@"; do
    [[ -n ${pids[$node]:-} ]] || continue
    wait "${pids[$node]}" || { printf 'demo: %s ended with code %s:\n' "$node" $? >&2
                               tail -n 5 "$output/log/$node.log" >&2; failed=1; }
    unset "pids[$node]"
  done
}
stop_all() {  # ends the program that runs, then the nodes, which it needed, then what has no name yet
  local pid program
  trap '' INT TERM # once is enough
  for program in train train_through_graph execute_policy; do
    if [[ -n ${pids[$program]:-} ]]; then
      interrupt "${pids[$program]}"
      wait "${pids[$program]}" || true
    fi
  done
  stop "${nodes[@]}"
  for pid in $(jobs -pr); do
    interrupt "$pid"
    wait "$pid" || true
  done
}
trap stop_all EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

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
run train --check --task "$task" --method "$method" "${search[@]}" --output "$output" \
  ${PARAMETERS:+--params-file "$PARAMETERS"}
if [[ -e $output ]]; then
  printf "demo: OUTPUT '%s' exists already; name a folder that does not.\n" "$output" >&2
  exit 1
fi
mkdir -p "$output/log"
# A domain of its own keeps the demo apart from any graph that already runs on this machine.
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((101 + RANDOM % 132))}

# The recorder and the visualizer first, so that they miss nothing.
start recorder -p output:="$output/bag"
start visualizer -p output:="$output/run.rrd"
start simulation -p task:="$task"
start trajectory_optimizer -p task:="$task"
start policy_executor -p task:="$task"
start policy_learner -p task:="$task" -p method:="$method" -p checkpoint_folder:="$output/checkpoints"

printf 'Learning: task %s, method %s, seed %s; logs in %s.\n' "$task" "$method" "$seed" "$output/log"
patience=(--timeout 120) # on a busy machine six processes begin slowly
run train_through_graph "${search[@]}" --output "$output" "${patience[@]}"
printf 'Executing: the learned policy drives the simulation in lock-step.\n'
run execute_policy --task "$task" --json "$output/execution.json" \
  --result "$output/result.json" "${patience[@]}"

stop "${nodes[@]}"
printf '\nBag:            %s\n' "$output/bag"
printf 'Recording:      %s\n' "$output/run.rrd"
printf 'Learning curve: %s\n' "$output/learning_curve.png"
printf 'More pictures:  vgps plot %s\n' "$output"
exit "$failed"
