# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Puts vgps_ros, and the ROS 2 it was set up with, on this shell's path: source env.bash
#
# Set before sourcing, these are kept: OMP_NUM_THREADS, OPENBLAS_NUM_THREADS and
# FASTRTPS_DEFAULT_PROFILES_FILE. The default profile keeps all traffic on the loopback interface;
# to reach other machines, name one of your own, or set it to nothing for all networks of this machine.

_vgps_env() {
  local root venv nounset=''
  root=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd -P)
  venv=$root/.venv
  if [[ ! -f $venv/.complete || ! -f $root/install/.complete ]]; then
    printf "env.bash: this checkout is not set up yet: run 'make setup' in %s.\n" "$root" >&2
    return 1
  fi

  # The scripts of ROS and colcon read variables that may be unset.
  if [[ $- == *u* ]]; then nounset=1; fi
  set +u
  if [[ -f $venv/ros_setup ]]; then
    # shellcheck disable=SC1090
    if [[ -z $ROS_VERSION ]]; then source "$(<"$venv/ros_setup")"; fi
  elif [[ -n $ROS_VERSION ]]; then # which installations set, and this file does not
    printf "env.bash: this checkout was set up without the ROS 2 '%s' sourced here: run 'make setup' again, or use a shell without it.\n" "$ROS_DISTRO" >&2
    if [[ -n $nounset ]]; then set -u; fi
    return 1
  else
    # Packages of other workspaces must not shadow the wheels.
    unset PYTHONPATH COLCON_PREFIX_PATH
    export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv ROS_DISTRO=jazzy
  fi
  # shellcheck disable=SC1091
  source "$root/install/setup.bash"
  if [[ -n $nounset ]]; then set -u; fi

  if [[ :$PATH: != *:$venv/bin:* ]]; then PATH=$venv/bin:$PATH; fi
  # The stand-in for ros2 comes last: a real one on the path wins.
  if [[ :$PATH: != *:$root/scripts/bin:* ]]; then PATH=$PATH:$root/scripts/bin; fi
  export PATH VIRTUAL_ENV=$venv
  if [[ -z ${FASTDDS_DEFAULT_PROFILES_FILE:-} ]]; then
    export FASTRTPS_DEFAULT_PROFILES_FILE=${FASTRTPS_DEFAULT_PROFILES_FILE-$root/config/fastdds_loopback.xml}
    export RMW_FASTRTPS_USE_QOS_FROM_XML=${RMW_FASTRTPS_USE_QOS_FROM_XML-1} # how queues keep memory
  fi
  # Where no profile says otherwise: in shared memory a process that is stopped can hold up the others.
  export FASTDDS_BUILTIN_TRANSPORTS=${FASTDDS_BUILTIN_TRANSPORTS-UDPv4}
  # onnxruntime tells its maker about networks otherwise, also where it is used without vgps_ros.
  export ORT_DISABLE_TELEMETRY=${ORT_DISABLE_TELEMETRY-1}
  # One thread a process: the matrices are small, the processes are many, and sums that are
  # split over threads depend on the number of cores. Where OMP_NUM_THREADS gives torch more, BLAS
  # keeps one: its threads would take the cores from torch's (an M-step took ten times as long).
  export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1} OPENBLAS_NUM_THREADS=${OPENBLAS_NUM_THREADS:-1}
}

if _vgps_env; then
  unset -f _vgps_env
else
  unset -f _vgps_env
  return 1
fi
