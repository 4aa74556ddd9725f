# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# shellcheck shell=bash
# Finds the tools that the set-up needs on this machine. It runs each one, because a name on the path
# may belong to a shim that starts nothing. setup.bash sources this file, which uses its fail().

check_compilers() {
  cmake --version >/dev/null 2>&1 ||
    fail "CMake is missing: install it, on Debian or Ubuntu with 'sudo apt-get install cmake'."
  local compiler
  for compiler in ${CXX:-c++ g++ clang++}; do
    if "$compiler" --version >/dev/null 2>&1; then return; fi
  done
  fail "a C++ compiler is missing: install one, on Debian or Ubuntu with 'sudo apt-get install g++'."
}

# A program that prints "ok", or the first thing that is missing from the Python that runs it.
python_probe='
import os, sys, sysconfig

def finding(ros):
    if not (3, 10) <= sys.version_info[:2] <= (3, 14):
        return "version"
    if ros == "system":
        try:
            import rclpy
        except ImportError:
            return "rclpy"
    try:
        import ensurepip, venv
    except ImportError:
        return "venv"
    if not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
        return "dev"
    return "ok"

print(finding(sys.argv[1]))
'

# find_python ROS VENV: sets $python to a Python 3.10 to 3.14 outside VENV that has everything, which
# includes rclpy if ROS is "system". $PYTHON may name the Python to use.
find_python() {
  local name candidate finding lack='' lacking=''
  for name in ${PYTHON:-python3 python3.14 python3.13 python3.12 python3.11 python3.10}; do
    while read -r candidate; do
      # The environment is about to be replaced, so its own Python cannot make it.
      if [[ $candidate == "$2"/* ]]; then continue; fi
      finding=$("$candidate" -c "$python_probe" "$1" 2>/dev/null) || continue
      case $finding in
        ok)
          python=$candidate
          return
          ;;
        venv | dev | rclpy)
          if [[ -z $lack ]]; then lack=$finding lacking=$candidate; fi
          ;;
      esac
    done < <(type -aP "$name")
  done
  case $lack in
    rclpy) fail "ROS_VERSION is set, but $lacking cannot import rclpy: source the installation's setup.bash, or unset ROS_VERSION to use wheels." ;;
    venv) fail "$lacking has no venv module: install it, on Debian or Ubuntu with 'sudo apt-get install python3-venv'." ;;
    dev) fail "$lacking has no C headers: install them, on Debian or Ubuntu with 'sudo apt-get install python3-dev'." ;;
  esac
  # shellcheck disable=SC2016
  fail "no Python 3.10 to 3.14 ${PYTHON:+by the name of '$PYTHON' }starts here: install one, on Debian or Ubuntu with 'sudo apt-get install python3 python3-venv python3-dev', or name one with 'make setup PYTHON=/path/to/python3'."
}

# Prints the setup.bash of the ROS installation that $python takes rclpy from.
find_ros_setup() {
  "$python" - <<'PY'
from pathlib import Path

import rclpy

# rclpy is in <prefix>/lib/python3.12/site-packages. An installation that was built from source may
# have a prefix for each package; its setup.bash is then one folder up.
prefix = Path(rclpy.__file__).parents[4]
print(next((p for p in (prefix / "setup.bash", prefix.parent / "setup.bash") if p.exists()), ""))
PY
}
